"""``taxinet compare``: two networks on the same scenes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from taxinet_ros.cli.options import (
    BoundOption,
    ControllerOption,
    JsonOption,
    LatencyOption,
    ProcessesCountOption,
    RateOption,
    SetOption,
    WorldCameraOption,
    WorldOption,
    given_among,
)
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.analysis.campaign.compared import Compared
    from taxinet_ros.analysis.runs.campaign import CampaignRuns
    from taxinet_ros.trials.options import CampaignOptions
    from taxinet_ros.trials.past_runs.shared_scenes import SceneSet

JSON_NAME, PAGE_NAME, CSV_NAME = 'compare.json', 'compare.html', 'changed.csv'
BEFORE, AFTER = 'before.parquet', 'after.parquet'
_OURS = {JSON_NAME, PAGE_NAME, CSV_NAME, BEFORE, AFTER, 'compared.png', 'bisect.json'}
_OF_PROGRAM = (
    'seed', 'spec', 'settings', 'controller', 'world', 'camera', 'latency', 'bound', 'rate',
)
"""Options that only the scenes of a program have."""


def compare(
    context: typer.Context,
    before: Annotated[
        str, typer.Argument(metavar='A', help='campaign or table, or a network: word or file')
    ],
    after: Annotated[str, typer.Argument(metavar='B', help='the same, to be compared with A')],
    scenes: Annotated[
        str | None,
        typer.Argument(
            metavar='[SCENES]',
            help='of two networks: a program, or a campaign, table or run whose scenes both drive',
        ),
    ] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help='number of scenes (default: 100 of a program, else '
        'all of them); fewer are spread evenly')
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help='seed of the scenes of a program (default 0)')
    ] = None,
    spec: Annotated[
        list[str] | None,
        typer.Option('--spec', metavar='FORMULA', help='requirement for the scenes of a program '
        '(default phi_eventually)'),
    ] = None,
    settings: SetOption = None,
    controller: ControllerOption = 'steering',
    world: WorldOption = 'kmwh',
    camera: WorldCameraOption = None,
    latency: LatencyOption = None,
    bound: BoundOption = None,
    rate: RateOption = None,
    workers: ProcessesCountOption = 2,
    out: Annotated[
        Path | None,
        typer.Option(help='folder for page and tables; finished runs in it are kept'),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Compare two networks on the same scenes: what got better, what got worse, and why.

    Takes two campaigns or tables of the same scenes, or two networks and the scenes, which both
    then drive in the closed loop without ROS; those of a program with the settings that run takes.
    Gives the paired difference with its interval and McNemar's exact test, the scenes that changed,
    and what they have in common. After an interrupt, the same command continues.
    """
    from taxinet_ros.analysis.campaign.compared import compared, compared_json, compared_report
    from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs
    from taxinet_ros.core.perception.perception import check_perception
    from taxinet_ros.core.world import world_word
    from taxinet_ros.trials.options import LOOP, make_options, make_out

    console = line_console(stderr=as_json)
    networks = before, after
    named = [_is_campaign(word) for word in networks]
    of_program = given_among(context, _OF_PROGRAM)
    if all(named) and scenes is None:
        if given := ['--runs'] * (runs is not None) + of_program:
            raise UsageError(f'{given[0]}: the scenes are those of the campaigns; leave it out')
        out = _folder(out, networks)
        first = read_runs(Path(before))
        found = compared(*distinct_labels((first, read_runs(Path(after), first.spec))))
        make_out(out)
    else:
        if any(named):
            raise UsageError(
                'compare: name two campaigns, or two networks and the scenes: a program, a '
                'campaign, a table or a run'
            )
        if scenes is None:
            raise UsageError(
                f'compare {before} {after}: two networks need scenes: a program, '
                'a campaign, a table or a run'
            )
        for network in networks:
            check_perception(network)
        out = _folder(out, networks)
        if not (Path(scenes).is_dir() or scenes.endswith('.parquet')):
            shared = _scenes_of_program(make_options(
                program=scenes, runs=100 if runs is None else runs, seed=seed or 0,
                perception=before, settings=settings or (), specs=spec or (), bounds=bound or (),
                rates=rate or (), controller=controller, latency=latency or (),
                world=world_word(world, camera), out=out, processes=False, resume=True,
                engine=LOOP,
            ))
        else:
            shared = _scenes_of_runs(scenes, runs, of_program)
        make_out(out)
        done = _driven(shared, networks, out, workers, console)
        if done is None:
            console.print('interrupted; the same command goes on')
            return ExitCode.INTERRUPTED
        # Nothing but the network differs between these runs.
        found = replace(compared(*distinct_labels(done)), differing=())
    _write(found, out)
    if as_json:
        print(json.dumps(compared_json(found), indent=2, allow_nan=False))
    for sentence in compared_report(found).summary:
        console.print(sentence)
    console.print(f'page: {out / PAGE_NAME}')
    return ExitCode.OK


def _is_campaign(word: str) -> bool:
    from taxinet_ros.trials.record.facts import is_campaign

    return is_campaign(Path(word)) or word.endswith('.parquet')


def _folder(out: Path | None, words: Sequence[str]) -> Path:
    from taxinet_ros.files.record import RECORD_NAME
    from taxinet_ros.trials.options import DEFAULT_ROOT

    names = '-'.join(Path(word.rstrip('/')).stem.replace(':', '-') for word in words)
    out = out or DEFAULT_ROOT / f'compare-{names}'
    there = {path.name for path in out.iterdir()} if out.is_dir() else set()
    # Beside a record may be its journal, its lock and a damaged one.
    if {name for name in there if RECORD_NAME not in name} - _OURS:
        raise UsageError(f'--out {out}: contains something else; choose another folder')
    return out


def _scenes_of_runs(word: str, runs: int | None, of_program: Sequence[str]) -> SceneSet:
    from taxinet_ros.trials.past_runs.shared_scenes import scenes_of

    if of_program:
        raise UsageError(f'{of_program[0]}: the scenes are those of {word}; leave it out')
    return scenes_of(Path(word), runs)


def _scenes_of_program(asked: CampaignOptions) -> SceneSet:
    from taxinet_ros.core.world import find_world
    from taxinet_ros.trials.past_runs.shared_scenes import scenes_of_program

    scenes = scenes_of_program(
        asked.program, runs=asked.runs, seed=asked.seed, judging=asked.judging,
        overrides=asked.overrides,
    )
    return replace(scenes, system=replace(
        scenes.system, gains=asked.gains, controller=asked.controller, timing=asked.timing,
        world=asked.world, world_sha256=find_world(asked.world).fingerprint,
    ))


def _driven(
    scenes: SceneSet, networks: Sequence[str], out: Path, workers: int, console: Console
) -> list[CampaignRuns] | None:
    """Drive the networks through the scenes, and write their tables; None if interrupted."""
    from taxinet_ros.analysis.runs.campaign import runs_of
    from taxinet_ros.cli.progress import trial_bar
    from taxinet_ros.files.atomic import write_parquet
    from taxinet_ros.trials.past_runs.shared_scenes import SharedTrials

    tables: list[CampaignRuns] = []
    total = len(networks) * len(scenes.scenes)
    with (
        SharedTrials(scenes, out) as trials,
        trial_bar(console, 'runs', total) as (count, interrupted),
    ):
        for network, name in zip(networks, (BEFORE, AFTER), strict=True):
            found = trials.drive(
                network, workers=workers, on_trial=count, interrupted=interrupted)
            if len(found) < len(scenes.scenes):
                return None
            frame = trials.table(network)
            write_parquet(out / name, frame)
            tables.append(runs_of(frame, out / name))
    return tables


def _write(found: Compared, out: Path) -> None:
    from taxinet_ros.analysis.campaign.compared import compared_json, compared_report
    from taxinet_ros.analysis.campaign.folder import csv_text
    from taxinet_ros.analysis.report.page import write_report_page
    from taxinet_ros.analysis.report.pictures import write_pictures
    from taxinet_ros.files.atomic import write_atomically

    report = compared_report(found)
    write_pictures(report, out)
    for section in report.sections:
        for table in section.tables:
            write_atomically(out / CSV_NAME, csv_text(table))
    text = json.dumps(compared_json(found), indent=2, allow_nan=False)
    write_atomically(out / JSON_NAME, text + '\n')
    write_report_page(report, out / PAGE_NAME)
