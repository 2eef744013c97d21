"""``taxinet run``: scenes of a program, or a recorded run once more."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import typer

from taxinet_ros.cli.options import (
    AuditOption,
    BoundOption,
    ControllerOption,
    EngineOption,
    ExitZeroOption,
    FactorOption,
    FallbackOption,
    FoxgloveOption,
    FreeOption,
    FromOption,
    JsonSummaryOption,
    LatencyOption,
    MonitorOption,
    OutOption,
    PerceptionOption,
    ProcessesOption,
    QuietOption,
    RateOption,
    RunImagesOption,
    RunOption,
    RunsOption,
    SceneArgument,
    SeedOption,
    SetOption,
    SpecOption,
    StopOnOption,
    WorkersOption,
    WorldCameraOption,
    WorldOption,
    campaign_of,
    ended,
    given_options,
)
from taxinet_ros.errors import UsageError


def run(
    context: typer.Context,
    program: SceneArgument = None,
    bag: FromOption = None,
    run_id: RunOption = None,
    runs: RunsOption = 1,
    workers: WorkersOption = 1,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    controller: ControllerOption = 'steering',
    monitor: MonitorOption = None,
    fallback: FallbackOption = None,
    world: WorldOption = 'kmwh',
    settings: SetOption = None,
    camera: WorldCameraOption = None,
    specs: SpecOption = None,
    out: OutOption = None,
    processes: ProcessesOption = False,
    images: RunImagesOption = None,
    stop_on: StopOnOption = 'never',
    bounds: BoundOption = None,
    rates: RateOption = None,
    latency: LatencyOption = None,
    free: FreeOption = False,
    real_time_factor: FactorOption = None,
    foxglove: FoxgloveOption = None,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    quiet: QuietOption = False,
    as_json: JsonSummaryOption = False,
    exit_zero: ExitZeroOption = False,
) -> None:
    """Run a Scenic program's scenes through the graph.

    Every run writes its own bag and a row of the campaign's table. With --from, the run of a bag is
    rerun and compared instead: exit code 0 bit-identical, 1 different. With --from and the folder
    of `taxinet score --simulate --out`, a run starts where that recording began.
    """
    from taxinet_ros.cli.run.campaign import run_campaign, with_run_workers
    from taxinet_ros.trials.options import LOOP

    if bag is not None and foxglove is not None:
        raise UsageError('--foxglove: not with --from; use the bag_player to show a bag')
    recorded = _recorded_start(bag, settings or ())
    if bag is not None and not recorded:
        raise typer.Exit(_run_from(context, bag))
    if run_id is not None:
        raise UsageError(
            '--run: selects a run of the bag given by --from; give --from, or leave --run out'
        )
    if recorded and program is not None:
        raise UsageError('--from: the scene is that of the recording; leave the program out')
    if program is None and not recorded:
        raise UsageError('run: name a SCENARIO, or a recorded run with --from BAG')
    if foxglove is not None and engine == LOOP:
        raise UsageError(f'--foxglove: not with --engine {LOOP}, which has no topics')
    options = campaign_of(
        context, images=images or ('all' if runs == 1 else 'failures'),
        **({'program': 'nominal', 'settings': recorded} if recorded else {}),
    )
    raise ended(
        run_campaign(
            with_run_workers(options, workers, foxglove), foxglove, quiet=quiet, as_json=as_json,
        ), exit_zero,
    )


def _recorded_start(folder: Path | None, settings: Sequence[str]) -> list[str]:
    """Settings of how a scored recording began, and those given; none if it is a bag.

    Raises:
        UsageError: the score was made without --simulate.
    """
    if folder is None or not (folder / 'score.json').is_file():
        return []
    from taxinet_ros.core.scenario import Scenario
    from taxinet_ros.files.plain_values import load_json
    from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_text
    from taxinet_ros.trials.options import read_settings

    start = load_json(read_text(folder / 'score.json', MAX_TEXT_BYTES)).get('start')
    if start is None:
        raise UsageError(
            f'--from {folder}: says nothing of the start; score again with --simulate --out')
    given = read_settings(settings)
    usual = Scenario().to_human()
    return [f'{key}={value}' for key, value in {**start, **given}.items()
            if key in given or value != usual.get(key)]


def _run_from(context: typer.Context, bag: Path) -> int:
    from taxinet_ros.cli.bag.rerun import check_options, run_again
    from taxinet_ros.trials.past_runs.repeated_run import readable_run

    given = given_options(context)
    check_options(given)
    with readable_run(bag, given.get('run_id')) as whole:
        return run_again(
            whole, perception=given.get('perception'),
            controller=given.get('controller'), out=given.get('out'),
            images=given.get('images'), processes=context.params['processes'],
        )
