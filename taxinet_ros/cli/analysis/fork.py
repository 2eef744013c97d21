"""``taxinet fork``: repeat a recorded run up to a moment, and go on in a changed world."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from taxinet_ros.cli.completion import complete_setting
from taxinet_ros.cli.options import JsonOption, RunOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.api.fork import Past
    from taxinet_ros.api.run import Run
    from taxinet_ros.bag.run.recording import Recording
    from taxinet_ros.core.mtl.interval import RobustnessInterval

_GAIN = 'steering.'
_MOST_POINTS = 1000
_SHORT_MOVES = {'cte': 'cte_m', 'heading': 'heading_deg', 'distance': 'distance_m',
                'speed': 'speed_mps'}
_WORDS = {'PASS': 'satisfied', 'FAIL': 'violated'}


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
    from taxinet_ros.api.fork import fork_past, read_past
    from taxinet_ros.cli.bag.input import readable_run
    from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, new_folder

    if images not in ('all', 'none'):
        raise UsageError(f'--images {images}: unknown; known: all, none')
    if find == (at is not None):
        raise UsageError('fork: give a moment by --at, or let --find search for it; one of them')
    if find and sweep:
        raise UsageError('fork: --sweep and --find do not go together; leave one out')
    console = line_console(stderr=as_json)
    with readable_run(bag, run_id) as recording:
        past = read_past(recording)
        saved_by = 'truth' if find and not (settings or state or controller) else None
        change = _change(
            recording, settings or (), state or (), perception or saved_by, controller)
        out = out or new_folder(DEFAULT_ROOT / f'fork-{recording.run_id}')
        check_new(out)
        if at is None:
            return _find(past, change, out, console, images=images == 'all', as_json=as_json)
        if sweep:
            return _sweep(past, change, at, sweep, out, console, as_json=as_json)
        done = fork_past(past, at_s=at, **change)
        told = _written(past, done, change, out, images=images == 'all')
    if as_json:
        print(json.dumps(told, indent=2, allow_nan=False))
    _say(console, told)
    return ExitCode.VIOLATED if done.outcome == 'FAIL' else ExitCode.OK


def _change(
    recording: Recording, texts: Sequence[str], moves: Sequence[str], perception: str | None,
    controller: str | None,
) -> dict[str, Any]:
    """The change as arguments of :func:`fork_past`."""
    from taxinet_ros.api.fork import MOVES
    from taxinet_ros.cli.bag.input import controller_of, perception_of
    from taxinet_ros.core.motion.controller import typed_gain
    from taxinet_ros.trials.options import read_settings

    run = recording.run
    settings: dict[str, Any] = dict(read_settings(texts))
    for name, value in settings.items():
        if name.startswith(_GAIN):
            try:
                settings[name] = typed_gain(name.removeprefix(_GAIN), value)
            except UsageError as error:
                raise UsageError(f'--set {error}') from None
    moved: dict[str, float] = {}
    for one in moves:
        name, _, value = one.partition('=')
        key = _SHORT_MOVES.get(name, name)
        if key not in MOVES or key in moved:
            raise UsageError(
                f'--state {one}: expected an offset once, of {", ".join(MOVES)}, as in cte_m=+0.5'
            )
        moved[key] = _number(f'--state {name}', value)
    word, _ = perception_of(run, perception)
    return {
        'settings': settings, 'moved': moved, 'perception': perception and word,
        'controller': controller and controller_of(run, controller),
    }


def _number(what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f'{what}={text}: expected a number')
    return value


def _find(
    past: Past, change: dict[str, Any], out: Path, console: Console, *, images: bool,
    as_json: bool,
) -> int:
    from taxinet_ros.api.fork import find_rescue
    from taxinet_ros.cli.progress import stage_bars

    with stage_bars(console) as show:
        done = 0

        def count(run: Run) -> None:
            nonlocal done
            done += 1
            show('forks', done, max(done, 18))

        found = find_rescue(past, **change, on_fork=count)
    told: dict[str, Any] = {
        'run_id': past.recording.run_id, 'change': _change_words(past, found.saved, change),
        'last_saved_s': found.saved and found.saved.fork_of and found.saved.fork_of.at_s,
        'first_lost_s': found.lost_s, 'saved_later_s': list(found.later_s), 'forks': found.tried,
    }
    if found.saved is not None:
        told |= _written(past, found.saved, change, out, images=images)
    if as_json:
        print(json.dumps(told, indent=2, allow_nan=False))
    if found.saved is None:
        console.print(
            f'{told["run_id"]}: not saved by {told["change"]}, not even from the start '
            f'({found.tried} forks)',
        )
        return ExitCode.VIOLATED
    saved_s = told['last_saved_s']
    if found.lost_s is None:
        line = f'saved by {told["change"]} up to its end, {saved_s:g} s'
    else:
        line = (
            f'point of no return {found.lost_s:g} s: saved by {told["change"]} at {saved_s:g} s, '
            f'not at {found.lost_s:g} s'
        )
    console.print(f'{told["run_id"]}: {line} ({found.tried} forks)')
    if found.later_s:
        moments = ', '.join(f'{at_s:g}' for at_s in found.later_s)
        console.print(f'but also saved at {moments} s: whether it can be saved comes and goes')
    _say_files(console, told)
    return ExitCode.OK


def _sweep(
    past: Past, change: dict[str, Any], at_s: float, sweep: str, out: Path, console: Console, *,
    as_json: bool,
) -> int:
    import pandas as pd

    from taxinet_ros.analysis.one_run.fork_picture import sweep_picture
    from taxinet_ros.analysis.report.pictures import LIGHT, write_png
    from taxinet_ros.api.fork import fork_past
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.core.mtl.interval import LOWER
    from taxinet_ros.files.atomic import write_atomically

    key, values = sweep_values(sweep)
    if key in change['settings']:
        raise UsageError(f'--sweep {key}: is given by --set too; leave one out')
    recorded = _value_before(past, key)
    rows: list[dict[str, Any]] = []
    intervals: list[RobustnessInterval] = []
    with stage_bars(console) as show:
        for number, value in enumerate(values):
            settings = dict(change['settings'])
            if value != recorded:  # as recorded is no change, but is a point of the curve
                settings[key] = value
            done = fork_past(past, at_s=at_s, **{**change, 'settings': settings})
            headline = next(iter(done.rho))
            intervals.append(done.rho[headline])
            rows.append({key: value, 'outcome': str(done.outcome), **intervals[-1].by_end()})
            show('forks', number + 1, len(values))
    out.mkdir(parents=True)
    table = pd.DataFrame(rows)
    write_atomically(out / 'sweep.csv', table.to_csv(index=False))
    before = past.recording.facts
    rho_before = math.nan
    if before is not None and headline in before.judged:
        rho_before = before.judged[headline].interval.lower
    picture = write_png(
        sweep_picture(
            list(values), intervals, label=_label(key), headline=headline,
            before=(recorded, rho_before),
            title=f'{past.recording.run_id}, changed at {at_s:g} s',
        ), out, LIGHT,
    )
    if as_json:
        print(json.dumps({'key': key, 'headline': headline, 'points': rows}, indent=2))
    for row in rows:
        console.print(
            f'{key}={row[key]:g}: {_outcome_words(row["outcome"])}, '
            f'{headline} {row[LOWER]:+.3f}',
        )
    console.print(f'table: {out / "sweep.csv"}; picture: {picture}')
    return ExitCode.OK


def sweep_values(text: str) -> tuple[str, tuple[float, ...]]:
    """Key and values of ``KEY=LOW:HIGH:STEP``, ends included.

    Raises:
        UsageError: it has another form, the key is no number, or there are too many values.
    """
    from taxinet_ros.core.scenario_fields import BY_KEY, by_key

    name, _, span = text.partition('=')
    key = next(iter(by_key({name: None})))
    if key not in BY_KEY and not key.startswith(_GAIN):
        raise UsageError(f'--sweep {text}: unknown key {name!r}')
    parts = span.split(':')
    if len(parts) != 3:
        raise UsageError(f'--sweep {text}: expected KEY=LOW:HIGH:STEP, as in rain=0:100:5')
    low, high, step = (_number(f'--sweep {name}', part) for part in parts)
    count = math.floor((high - low) / step + 1e-9) + 1 if step > 0 and high >= low else 0
    if not 2 <= count <= _MOST_POINTS:
        raise UsageError(
            f'--sweep {text}: expected LOW < HIGH and a positive STEP that gives 2 to '
            f'{_MOST_POINTS} values'
        )
    return key, tuple(round(low + number * step, 9) for number in range(count))


def _value_before(past: Past, key: str) -> float | None:
    from taxinet_ros.core.motion.controller import SteeringGains

    run = past.recording.run
    if key.startswith(_GAIN):
        usual = dataclasses.asdict(SteeringGains())
        return {**usual, **run.gains}.get(key.removeprefix(_GAIN))
    value = run.request.scenario.to_human()[key]
    return float(value) if isinstance(value, int | float) else None


def _label(key: str) -> str:
    from taxinet_ros.core.scenario_fields import BY_KEY

    if key in BY_KEY:
        field = BY_KEY[key]
        return f'{field.title} [{field.unit}]' if field.unit else field.title
    return key


def _change_words(past: Past, done: Run | None, change: dict[str, Any]) -> str:
    """What changes at the fork, for people."""
    from taxinet_ros.core.scenario_fields import BY_KEY

    words = []
    before = past.recording.run.request.scenario.to_human()
    for name, value in change['settings'].items():
        if name in BY_KEY:
            field = BY_KEY[name]
            now = field.to_human(field.from_human(value))
            words.append(
                f'{field.label} {field.value_words(before[name])} -> {field.value_words(now)}'
            )
        else:
            words.append(f'{name}={value:g}')
    words += [f'{name} {value:+g}' for name, value in change['moved'].items()]
    words += [
        f'{role} {change[role]}' for role in ('perception', 'controller') if change[role]
    ]
    fork = None if done is None else done.fork_of
    if fork is not None and fork.placed and not change['moved']:
        words.append('placed anew, rolling straight, as the model of windy air is another')
    return ', '.join(words) or 'nothing'


def _written(
    past: Past, done: Run, change: dict[str, Any], out: Path, *, images: bool
) -> dict[str, Any]:
    """Write bag and picture; what was done, as plain values."""
    from taxinet_ros.analysis.one_run.fork_picture import Shown, fork_picture, shown_steps
    from taxinet_ros.analysis.report.pictures import LIGHT, write_png
    from taxinet_ros.bag.run.recording import open_recording

    fork, words = done.fork_of, _change_words(past, done, change)
    assert fork is not None
    out.mkdir(parents=True, exist_ok=True)
    bag = done.save_bag(out / f'{fork.run_id}-at-{fork.at_s:g}s', images=images)
    headline = next(iter(done.rho))
    facts = past.recording.facts
    recorded = facts.judged.get(headline) if facts is not None else None
    outcomes = facts.outcome if facts else '', str(done.outcome)
    runs = past.recording, open_recording(bag)
    steps = shown_steps(fork.step, max(len(run.columns['t_ns']) for run in runs) - 1)
    shown = [
        Shown(
            words=f'{when}: {_outcome_words(outcome)}', columns=run.columns,
            frames={frame.seq: frame.image for frame in run.frames(steps.__contains__)},
        )
        for when, outcome, run in zip(('before', 'after'), outcomes, runs, strict=True)
    ]
    picture = write_png(
        fork_picture(
            *shown, at_s=fork.at_s, headline=headline,
            half_width_m=done.scenario.line.half_width_m,
            title=f'{fork.run_id}, forked at {fork.at_s:g} s: {words}',
        ), out, LIGHT,
    )
    return {
        'run_id': fork.run_id, 'at_s': fork.at_s, 'steps_repeated': fork.step, 'change': words,
        'before': {
            'outcome': outcomes[0],
            'rho': None if recorded is None else _ends(recorded.interval),
        },
        'after': {'outcome': outcomes[1], 'rho': _ends(done.rho[headline])},
        'headline': headline, 'bag': str(bag), 'picture': str(picture),
    }


def _ends(interval: Any) -> list[float | None]:
    return [end if math.isfinite(end) else None for end in (interval.lower, interval.upper)]


def _outcome_words(outcome: str) -> str:
    return _WORDS.get(outcome, outcome) if outcome else 'not judged'


def _say(console: Console, told: dict[str, Any]) -> None:
    console.print(
        f'{told["run_id"]}: {told["steps_repeated"]} steps repeated to the bit, forked at '
        f'{told["at_s"]:g} s: {told["change"]}',
    )
    for when in ('before', 'after'):
        rho = told[when]['rho']
        tells = '' if not rho or None in rho else f', {told["headline"]} {rho[0]:+.3f}'
        console.print(f'  {when}: {_outcome_words(told[when]["outcome"])}{tells}')
    _say_files(console, told)


def _say_files(console: Console, told: dict[str, Any]) -> None:
    console.print(f'bag: {told["bag"]}; picture: {told["picture"]}')
