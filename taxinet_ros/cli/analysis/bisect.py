"""``taxinet bisect``: which of several networks broke which scenes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import JsonOption, ProcessesCountOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode, UsageError

BISECT_NAME = 'bisect.json'


def bisect(
    networks: Annotated[
        list[str],
        typer.Argument(
            metavar='GOOD ... BAD', help='networks or checkpoints in order: words or files'
        ),
    ],
    scene: Annotated[
        Path, typer.Option(metavar='BAG|TABLE|CAMPAIGN', help='the scenes')
    ],
    every: Annotated[
        bool, typer.Option('--every', help='run every network in every scene, so that a scene '
        'that breaks more than once is seen')
    ] = False,
    runs: Annotated[
        int | None, typer.Option(min=1, help='at most so many scenes, evenly spread')
    ] = None,
    workers: ProcessesCountOption = 2,
    out: Annotated[
        Path | None, typer.Option(help='folder for the results; finished runs in it are kept')
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Find which of several networks in order broke which scenes.

    For every scene that the first one satisfies and the last one violates, finds a network that
    violates it right after one that satisfies it. Exit codes: 0 done, 3 some run could not be
    judged, 130 interrupted; the same command continues.
    """
    from taxinet_ros.analysis.campaign.bisection import (
        bisect_scenes,
        bisection_json,
        bisection_text,
    )
    from taxinet_ros.cli.progress import trial_bar
    from taxinet_ros.core.perception.perception import check_perception
    from taxinet_ros.files.atomic import write_atomically
    from taxinet_ros.files.plain_values import json_text
    from taxinet_ros.trials.options import DEFAULT_ROOT
    from taxinet_ros.trials.past_runs.shared_scenes import SharedTrials, scenes_of

    console = line_console(stderr=as_json)
    if len(networks) < 2:
        raise UsageError('bisect: name two networks or more, in order, the good one first')
    prints = [check_perception(network) for network in networks]
    for place, fingerprint in enumerate(prints):
        if fingerprint in prints[:place]:
            raise UsageError(
                f'bisect: {networks[place]} has the weights of '
                f'{networks[prints.index(fingerprint)]}; leave one out'
            )
    scenes = scenes_of(scene, runs)
    out = out or DEFAULT_ROOT / f'bisect-{scene.resolve().stem}'
    total = len(networks) * len(scenes.scenes)
    with (
        SharedTrials(scenes, out) as trials,
        trial_bar(console, 'runs', total) as (count, interrupted),
    ):
        def drive(place: int, names: Sequence[str]) -> dict[str, bool | None]:
            done = trials.drive(
                networks[place], names, workers=workers, on_trial=count, interrupted=interrupted)
            headline = scenes.judging.headline
            return {name: done[name].about(headline).passed for name in names}

        names = [scene.row.run_id for scene in scenes.scenes]
        found = bisect_scenes(networks, names, drive, every=every)
    values = bisection_json(found)
    write_atomically(out / BISECT_NAME, json_text(values) + '\n')
    if as_json:
        print_json(values)
    console.print(bisection_text(found))
    console.print(f'written: {out / BISECT_NAME}')
    unclear = any(one.unclear for one in found.scenes)
    return ExitCode.INCOMPLETE if unclear else ExitCode.OK
