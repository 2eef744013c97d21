"""Commands that run the graph: arguments, options and help; implementations are imported on use."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import typer

from taxinet_ros.cli.completion import complete_experiment, complete_perception
from taxinet_ros.cli.options import (
    AuditOption,
    BoundOption,
    BudgetOption,
    ClusterOption,
    ControllerCommandOption,
    ControllerOption,
    EngineOption,
    ExitZeroOption,
    FactorOption,
    FailedRunArgument,
    FallbackOption,
    FoxgloveOption,
    FreeOption,
    FromOption,
    ImagesOption,
    JsonOption,
    JsonSummaryOption,
    LagOption,
    LatencyOption,
    MonitorOption,
    MostRunsOption,
    NeededRunsOption,
    NominalOption,
    OddOption,
    OutOption,
    OwnControllerOption,
    OwnPerceptionOption,
    OwnSpecOption,
    PerceptionCommandOption,
    PerceptionOption,
    ProcessesOption,
    QuietOption,
    RateOption,
    ResumeOption,
    RunImagesOption,
    RunOption,
    RunsOption,
    SamplerOption,
    SamplerSettingOption,
    ScenarioArgument,
    SceneArgument,
    SeedOption,
    SetOption,
    SpecOption,
    StopOnOption,
    UntilOption,
    WorkersOption,
    WorldCameraOption,
    WorldOption,
    campaign_of,
    ended,
    given_options,
    word_of,
)


def run(
    context: typer.Context,
    program: SceneArgument = None,
    bag: FromOption = None,
    run_id: RunOption = None,
    runs: RunsOption = 1,
    workers: WorkersOption = 1,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    perception_cmd: PerceptionCommandOption = None,
    controller: ControllerOption = 'steering',
    controller_cmd: ControllerCommandOption = None,
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
    rerun and compared instead: exit code 0 bit-identical, 1 different.
    """
    if bag is None:
        _start_scenic()
    from taxinet_ros.cli.run.campaign import run_campaign, with_run_workers
    from taxinet_ros.errors import UsageError
    from taxinet_ros.trials.options import LOOP

    if bag is not None and foxglove is not None:
        raise UsageError('--foxglove: not with --from; use the bag_player to show a bag')
    if bag is not None:
        raise typer.Exit(_run_from(context, bag))
    if run_id is not None:
        raise UsageError(
            '--run: selects a run of the bag given by --from; give --from, or leave --run out'
        )
    if program is None:
        raise UsageError('run: name a SCENARIO, or a recorded run with --from BAG')
    if foxglove is not None and engine == LOOP:
        raise UsageError(f'--foxglove: not with --engine {LOOP}, which has no topics')
    options = campaign_of(
        context, images=images or ('all' if runs == 1 else 'failures'),
    )
    raise ended(
        run_campaign(
            with_run_workers(options, workers, foxglove), foxglove, quiet=quiet, as_json=as_json,
        ), exit_zero,
    )


def _start_scenic() -> None:
    """Have Scenic imported in its own process while this one goes on."""
    from taxinet_ros.scenes.scenic_server import start_early

    start_early()


def _run_from(context: typer.Context, bag: Path) -> int:
    from taxinet_ros.cli.bag.rerun import check_options, run_again
    from taxinet_ros.trials.past_runs.repeated_run import readable_run

    given = given_options(context)
    check_options(given)
    with readable_run(bag, given.get('run_id')) as whole:
        return run_again(
            whole, perception=_word(context, given, 'perception'),
            controller=_word(context, given, 'controller'), out=given.get('out'),
            images=given.get('images'), processes=context.params['processes'],
        )


def _word(context: typer.Context, given: dict[str, Any], role: str) -> str | None:
    return word_of(context, role) if {role, f'{role}_cmd'} & given.keys() else None


def falsify(
    context: typer.Context,
    program: ScenarioArgument,
    runs: MostRunsOption = 100,
    sampler: SamplerOption = None,
    sampler_option: SamplerSettingOption = None,
    odd: OddOption = None,
    workers: WorkersOption = 1,
    cluster: ClusterOption = None,
    lag: LagOption = 8,
    out: OutOption = None,
    resume: ResumeOption = False,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    perception_cmd: PerceptionCommandOption = None,
    controller: ControllerOption = 'steering',
    controller_cmd: ControllerCommandOption = None,
    monitor: MonitorOption = None,
    fallback: FallbackOption = None,
    world: WorldOption = 'kmwh',
    settings: SetOption = None,
    camera: WorldCameraOption = None,
    specs: SpecOption = None,
    until: UntilOption = None,
    budget: BudgetOption = None,
    images: ImagesOption = 'failures',
    stop_on: StopOnOption = 'never',
    bounds: BoundOption = None,
    rates: RateOption = None,
    latency: LatencyOption = None,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    quiet: QuietOption = False,
    as_json: JsonSummaryOption = False,
    exit_zero: ExitZeroOption = False,
) -> None:
    """Search a Scenic program for violating scenes.

    The default sampler looks for failures unlike those already found, and draws every fourth run
    from the program itself to estimate failure rates; `--sampler ce` also learns where failures are
    likely. Can be resumed after Ctrl-C or power loss.
    """
    _start_scenic()
    from taxinet_ros.cli.run.search import run_falsify
    from taxinet_ros.trials.record.facts import missing_packages_named
    from taxinet_ros.trials.search import make_search

    with missing_packages_named(out if resume else None):
        campaign = campaign_of(context)
        search = make_search(
            campaign, sampler=sampler, sampler_options=sampler_option or (), workers=workers,
            until=until, budget_min=budget, lag=lag, cluster=cluster, odd=odd,
        )
    raise ended(run_falsify(search, quiet=quiet, as_json=as_json), exit_zero)


def estimate(
    context: typer.Context,
    program: ScenarioArgument,
    down_to: Annotated[
        float,
        typer.Option(metavar='PROBABILITY', help='least probability that the runs suffice for'),
    ] = 1e-5,
    runs: MostRunsOption = 4000,
    islands: Annotated[
        int,
        typer.Option(
            min=4, max=100, help='independent populations; their mean gives the lower end'
        ),
    ] = 8,
    workers: WorkersOption = 1,
    out: OutOption = None,
    resume: ResumeOption = False,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    controller: ControllerOption = 'steering',
    world: WorldOption = 'kmwh',
    settings: SetOption = None,
    camera: WorldCameraOption = None,
    specs: SpecOption = None,
    images: ImagesOption = 'none',
    bounds: BoundOption = None,
    rates: RateOption = None,
    latency: LatencyOption = None,
    engine: EngineOption = 'loop',
    audit: AuditOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Estimate the probability of rare failures, down to one in a hundred thousand.

    Half of the runs are plain draws, for the upper end. For the lower one, the way to a failure is
    split into levels of robustness, each reached from the one before by Markov chains in the
    program's own distribution. Its headline is the first requirement, or the only one. Prints a
    95 % interval, and draws P(robustness <= r). Exit codes: 0 estimated, 3 a wide interval.
    """
    _start_scenic()
    from taxinet_ros.cli.run.estimate import run_estimate
    from taxinet_ros.trials.record.facts import missing_packages_named
    from taxinet_ros.trials.search import make_estimate

    with missing_packages_named(out if resume else None):
        campaign = campaign_of(context)
        search = make_estimate(campaign, floor=down_to, islands=islands, workers=workers)
    raise typer.Exit(run_estimate(search, quiet=quiet, as_json=as_json))


def shrink(
    run: FailedRunArgument,
    nominal: NominalOption = None,
    runs: NeededRunsOption = 100,
    workers: WorkersOption = 1,
    cluster: ClusterOption = None,
    out: OutOption = None,
    resume: ResumeOption = False,
    perception: OwnPerceptionOption = None,
    controller: OwnControllerOption = None,
    spec: OwnSpecOption = None,
    images: ImagesOption = 'none',
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    quiet: QuietOption = False,
) -> None:
    """Shrink a failed run to the nearest scenario that still fails.

    Moves its parameters to nominal taxiing one by one, and reports which of them matter.
    """
    from taxinet_ros.cli.run.search import run_shrink
    from taxinet_ros.trials.record.facts import missing_packages_named
    from taxinet_ros.trials.shrink.shrinking import make_shrinking

    with missing_packages_named(run.parent):
        shrinking = make_shrinking(
            run, perception=perception, specs=spec or (), nominal=nominal or (), runs=runs,
            workers=workers, out=out, resume=resume, images=images, controller=controller,
            engine=engine, audit=audit, cluster=cluster,
        )
    raise typer.Exit(run_shrink(shrinking, quiet=quiet))


def experiment(
    file: Annotated[
        str,
        typer.Argument(
            metavar='FILE', help='shipped experiment (shadows, shadows_afternoon, crossing, '
            'light) or a YAML file', autocompletion=complete_experiment,
        ),
    ],
    out: Annotated[Path | None, typer.Option(help='folder for the arms; must be new')] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help="number of scenes (default: the file's)")
    ] = None,
    perception: Annotated[
        str | None,
        typer.Option(
            metavar='WORD|FILE', help="network (default: the file's)",
            autocompletion=complete_perception,
        ),
    ] = None,
    workers: Annotated[int, typer.Option(help='graphs run in parallel; same results')] = 1,
    cluster: ClusterOption = None,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue an interrupted command in --out')
    ] = False,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    as_json: JsonOption = False,
) -> None:
    """Confirm a cause by running the same scenes with and without it.

    Each arm of the experiment is a separate campaign; runs of the same scene are compared in pairs.
    """
    from taxinet_ros.cli.run.search import run_experiment
    from taxinet_ros.errors import UsageError
    from taxinet_ros.trials.experiment import find_experiment, read_experiment, with_network
    from taxinet_ros.trials.options import DEFAULT_ROOT, new_folder
    from taxinet_ros.trials.record.facts import missing_packages_named

    if resume and out is None:
        raise UsageError('--resume: name the experiment to continue with --out')
    with missing_packages_named(out if resume else None):
        asked = read_experiment(find_experiment(file))
    if runs is not None:
        asked = dataclasses.replace(asked, runs=runs)
    if perception is not None:
        asked = with_network(asked, perception)
    raise typer.Exit(
        run_experiment(
            asked, out or new_folder(DEFAULT_ROOT / f'experiment-{asked.name}'),
            workers=workers, resume=resume, as_json=as_json, engine=engine, audit=audit,
            cluster=cluster,
        )
    )
