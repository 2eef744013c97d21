"""``taxinet fork``: repeat a recorded run up to a moment, and go on in a changed world."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.completion import complete_setting
from taxinet_ros.cli.options import JsonOption, RunOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode, UsageError


def fork(
    bag: Annotated[
        Path, typer.Argument(metavar='BAG', help='folder of a run, usually a counterexample')
    ],
    run_id: RunOption = None,
    at: Annotated[
        float | None, typer.Option(metavar='SECONDS', help='from when it is changed')
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set', metavar='KEY=VALUE',
            help='scenario value (rain=0, clouds=clear, wind_speed=6, …) or gain '
            '(steering.heading_gain=1.2) from then on; repeatable',
            autocompletion=complete_setting,
        ),
    ] = None,
    state: Annotated[
        list[str] | None,
        typer.Option(
            metavar='OFFSET=VALUE',
            help='place the aircraft anew, off by cte_m, heading_deg, distance_m or speed_mps: '
            'cte_m=+0.5 is half a metre left; repeatable',
        ),
    ] = None,
    perception: Annotated[
        str | None,
        typer.Option(metavar='WORD|FILE', help="from then on (default: the run's)"),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(metavar='WORD|FILE', help="from then on (default: the run's)"),
    ] = None,
    sweep: Annotated[
        str | None,
        typer.Option(
            metavar='KEY=LOW:HIGH:STEP', help='robustness over a value changed then, rain=0:100:5'
        ),
    ] = None,
    find: Annotated[
        bool,
        typer.Option(
            '--find', help='the last moment at which the change (default: --perception truth) '
            'still saves the run'
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help='output folder for bag and picture; must be new')
    ] = None,
    images: Annotated[
        str, typer.Option(help='camera frames in the new bag: all or none')
    ] = 'all',
    as_json: JsonOption = False,
) -> int:
    """Repeat a recorded run up to a moment, and go on in a changed world.

    Up to the moment the run is repeated to the bit, which is checked; then the scene, the place of
    the aircraft, the perception or the controller changes. Writes a bag, and a picture of both
    runs. Exit code 1 if the forked run violates its requirements.
    """
    from taxinet_ros.analysis.one_run.fork import (
        asked_change,
        fork_text,
        sweep_values,
        write_sweep,
    )
    from taxinet_ros.api.fork import (
        find_rescue,
        fork_past,
        read_past,
        save_fork,
        save_rescue,
        sweep_past,
    )
    from taxinet_ros.cli.progress import count_bar
    from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, new_folder
    from taxinet_ros.trials.past_runs.repeated_run import readable_run

    if images not in ('all', 'none'):
        raise UsageError(f'--images {images}: unknown; known: all, none')
    if find == (at is not None):
        raise UsageError('fork: give a moment by --at, or let --find search for it; one of them')
    if find and sweep:
        raise UsageError('fork: --sweep and --find do not go together; leave one out')
    console, keep = line_console(stderr=as_json), images == 'all'
    files: dict[str, Path] = {}
    with readable_run(bag, run_id) as recording:
        past = read_past(recording)
        saved_by = 'truth' if find and not (settings or state or controller) else None
        change = asked_change(
            recording, settings or (), state or (), perception or saved_by, controller)
        out = out or new_folder(DEFAULT_ROOT / f'fork-{recording.run_id}')
        check_new(out)
        if at is None:
            with count_bar(console, 'forks', 18) as count:
                found = find_rescue(past, **change, on_fork=lambda _: count())
            kind, violated = 'rescue', found.saved is None
            values = save_rescue(past, found, change, out, images=keep)
        elif sweep:
            key, wanted = sweep_values(sweep)
            with count_bar(console, 'forks', len(wanted)) as count:
                headline, points = sweep_past(past, change, key, wanted, at_s=at, on_fork=count)
            kind, violated = 'swept', False
            values = {'key': key, 'headline': headline, 'points': points}
            files = write_sweep(recording, at, points, headline, out)
        else:
            done = fork_past(past, at_s=at, **change)
            kind, violated = 'forked', done.outcome == 'FAIL'
            values = save_fork(past, done, change, out, images=keep)
    if as_json:
        print_json(values)
    console.print(fork_text(kind, values, **files))
    return ExitCode.VIOLATED if violated else ExitCode.OK
