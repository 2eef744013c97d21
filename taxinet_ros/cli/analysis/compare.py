"""``taxinet compare`` and ``taxinet bisect``: networks on the same scenes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from taxinet_ros.analysis.campaign.bisection import (
    Bisection,
    bisect_scenes,
    bisection_json,
    bisection_lines,
)
from taxinet_ros.analysis.campaign.compared import (
    Compared,
    compared,
    compared_json,
    compared_report,
)
from taxinet_ros.analysis.campaign.folder import csv_text
from taxinet_ros.analysis.runs.campaign import (
    CampaignRuns,
    distinct_labels,
    read_runs,
    runs_of,
)
from taxinet_ros.cli.progress import trial_bar
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.files.sealed_table import write_table
from taxinet_ros.trials.options import DEFAULT_ROOT, LOOP, make_options, make_out
from taxinet_ros.trials.past_runs.shared_scenes import (
    SceneSet,
    SharedTrials,
    scenes_of,
    scenes_of_program,
)
from taxinet_ros.trials.record.facts import is_campaign

JSON_NAME, PAGE_NAME, CSV_NAME = 'compare.json', 'compare.html', 'changed.csv'
BISECT_NAME = 'bisect.json'
BEFORE, AFTER = 'before.parquet', 'after.parquet'
_OURS = {JSON_NAME, PAGE_NAME, CSV_NAME, BEFORE, AFTER, 'compared.png', BISECT_NAME}


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Options of ``taxinet compare``.

    Attributes:
        before, after: two campaigns or tables, or words or files of two networks.
        scenes: of two networks: program, campaign, table or run with the scenes; else None.
        runs: number of scenes; None: 100 of a program, else all.
        seed: seed of a program's scenes.
        settings: of the runs of a program's scenes, as :func:`.make_options` takes them; the first
            of ``specs`` counts.
        of_program: an option given that only scenes of a program have; ''.
        workers: processes.
        out: folder; None: one below ``bags/``.
        as_json: print ``compare.json``.
    """

    before: str
    after: str
    scenes: str | None
    runs: int | None
    seed: int | None
    settings: Mapping[str, Any]
    of_program: str
    workers: int
    out: Path | None
    as_json: bool


def run_compare(options: CompareOptions) -> int:
    """Compare, write the page and print the findings.

    Returns:
        Exit code: 0 done, 130 interrupted; the same command continues.

    Raises:
        UsageError: bad input.
    """
    console = Console(highlight=False, stderr=options.as_json)
    named = [_is_campaign(word) for word in (options.before, options.after)]
    if all(named) and options.scenes is None:
        if given := '--runs' if options.runs is not None else options.of_program:
            raise UsageError(f'{given}: the scenes are those of the campaigns; leave it out')
        out = _folder(options, options.before, options.after)
        first = read_runs(Path(options.before))
        runs = first, read_runs(Path(options.after), first.spec)
        found = compared(*distinct_labels(runs))
    else:
        if any(named):
            raise UsageError(
                'compare: name two campaigns, or two networks and the scenes: a program, a '
                'campaign, a table or a run'
            )
        if options.scenes is None:
            raise UsageError(
                f'compare {options.before} {options.after}: two networks need scenes: a program, '
                'a campaign, a table or a run'
            )
        for network in (options.before, options.after):
            check_perception(network)
        out = _folder(options, options.before, options.after)
        scenes = _scenes(options, options.scenes, out)
        done = _driven(scenes, (options.before, options.after), out, options.workers, console)
        if done is None:
            console.print('interrupted; the same command goes on', soft_wrap=True)
            return ExitCode.INTERRUPTED
        # Nothing but the network differs between these runs.
        found = replace(compared(*distinct_labels(done)), differing=())
    _write(found, out)
    if options.as_json:
        print(json.dumps(compared_json(found), indent=2, allow_nan=False))
    for sentence in compared_report(found).summary:
        console.print(sentence, soft_wrap=True, markup=False)
    console.print(f'page: {out / PAGE_NAME}', soft_wrap=True, markup=False)
    return ExitCode.OK


def _is_campaign(word: str) -> bool:
    return is_campaign(Path(word)) or word.endswith('.parquet')


def _folder(options: CompareOptions, *words: str) -> Path:
    names = '-'.join(Path(word.rstrip('/')).stem.replace(':', '-') for word in words)
    out = options.out or DEFAULT_ROOT / f'compare-{names}'
    there = {path.name for path in out.iterdir()} if out.is_dir() else set()
    # Beside a record may be its journal, its lock and a damaged one.
    if {name for name in there if RECORD_NAME not in name} - _OURS:
        raise UsageError(f'--out {out}: contains something else; choose another folder')
    make_out(out)
    return out


def _scenes(options: CompareOptions, word: str, out: Path) -> SceneSet:
    """The scenes of a campaign, table or run, or else of a program."""
    path = Path(word)
    if path.is_dir() or word.endswith('.parquet'):
        if options.of_program:
            raise UsageError(f'{options.of_program}: the scenes are those of {word}; leave it out')
        return scenes_of(path, options.runs)
    asked = make_options(
        program=word, runs=100 if options.runs is None else options.runs, seed=options.seed or 0,
        perception=options.before, out=out, processes=False, resume=True, engine=LOOP,
        **options.settings,
    )
    scenes = scenes_of_program(
        word, runs=asked.runs, seed=asked.seed, judging=asked.judging, overrides=asked.overrides)
    return replace(scenes, system=replace(
        scenes.system, gains=asked.gains, controller=asked.controller, timing=asked.timing,
        world=asked.world, world_sha256=find_world(asked.world).fingerprint,
    ))


def _driven(
    scenes: SceneSet, networks: Sequence[str], out: Path, workers: int, console: Console
) -> list[CampaignRuns] | None:
    """Drive the networks through the scenes, and write their tables; None if interrupted."""
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
            write_table(out / name, frame)
            tables.append(runs_of(frame, out / name))
    return tables


def _write(found: Compared, out: Path) -> None:
    from taxinet_ros.analysis.report.page import write_report_page
    from taxinet_ros.analysis.report.pictures import write_pictures

    report = compared_report(found)
    write_pictures(report, out)
    for section in report.sections:
        for table in section.tables:
            write_atomically(out / CSV_NAME, csv_text(table))
    text = json.dumps(compared_json(found), indent=2, allow_nan=False)
    write_atomically(out / JSON_NAME, text + '\n')
    write_report_page(report, out / PAGE_NAME)


@dataclass(frozen=True, kw_only=True)
class BisectOptions:
    """Options of ``taxinet bisect``.

    Attributes:
        networks: words or files in order, the good one first.
        scene: campaign, table or run.
        every: whether all networks are run in all scenes.
        runs: at most so many scenes; None: all.
        workers: processes.
        out: folder; None: one below ``bags/``.
        as_json: print ``bisect.json``.
    """

    networks: tuple[str, ...]
    scene: Path
    every: bool
    runs: int | None
    workers: int
    out: Path | None
    as_json: bool


def run_bisect(options: BisectOptions) -> int:
    """Find which network broke which scenes, and print it.

    Returns:
        Exit code: 0 done, 3 some run could not be judged, 130 interrupted.

    Raises:
        UsageError: bad input.
    """
    console = Console(highlight=False, stderr=options.as_json)
    if len(options.networks) < 2:
        raise UsageError('bisect: name two networks or more, in order, the good one first')
    prints = [check_perception(network) for network in options.networks]
    for place, fingerprint in enumerate(prints):
        if fingerprint in prints[:place]:
            raise UsageError(
                f'bisect: {options.networks[place]} has the weights of '
                f'{options.networks[prints.index(fingerprint)]}; leave one out'
            )
    scenes = scenes_of(options.scene, options.runs)
    out = options.out or DEFAULT_ROOT / f'bisect-{options.scene.resolve().stem}'
    total = len(options.networks) * len(scenes.scenes)
    with (
        SharedTrials(scenes, out) as trials,
        trial_bar(console, 'runs', total) as (count, interrupted),
    ):
        def drive(place: int, names: Sequence[str]) -> dict[str, bool | None]:
            done = trials.drive(
                options.networks[place], names, workers=options.workers, on_trial=count,
                interrupted=interrupted,
            )
            if interrupted():
                raise KeyboardInterrupt
            return {name: done[name].passed for name in names}

        names = [scene.row.run_id for scene in scenes.scenes]
        try:
            found = bisect_scenes(options.networks, names, drive, every=options.every)
        except KeyboardInterrupt:
            console.print('interrupted; the same command goes on', soft_wrap=True)
            return ExitCode.INTERRUPTED
    values = bisection_json(found)
    write_atomically(out / BISECT_NAME, json.dumps(values, indent=2, allow_nan=False) + '\n')
    if options.as_json:
        print(json.dumps(values, indent=2, allow_nan=False))
    for line in bisection_lines(found):
        console.print(line, soft_wrap=True, markup=False)
    console.print(f'written: {out / BISECT_NAME}', soft_wrap=True, markup=False)
    return ExitCode.INCOMPLETE if _unclear(found) else ExitCode.OK


def _unclear(found: Bisection) -> bool:
    return any(scene.unclear for scene in found.scenes)
