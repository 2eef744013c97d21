"""``taxinet monitor``: evaluate requirements on recorded runs."""

from __future__ import annotations

import contextlib
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from taxinet_ros.bag.errors import BagError
from taxinet_ros.cli.options import BoundOption, JsonOption, RateOption, RunOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.check.judge import JudgedBag
    from taxinet_ros.bag.run.judging import SpecVerdict
    from taxinet_ros.core.motion.controller import SteeringGains
    from taxinet_ros.core.mtl import Assumptions, Spec
    from taxinet_ros.core.scenario import Scenario

_STYLES = {
    'SATISFIED': 'green', 'VIOLATED': 'red', 'MARGINAL': 'red', 'INCOMPLETE': 'yellow',
    'INVALID': 'bold magenta', 'UNCLEAR': 'yellow',
}
"""Styles of the words of a :class:`.BagVerdict`."""
_PICTURE = '.png'


def monitor(
    bags: Annotated[
        list[Path],
        typer.Argument(
            metavar='BAG...', help='folders of runs, .mcap files, or folders of campaigns'
        ),
    ],
    spec: Annotated[
        list[str] | None,
        typer.Option(
            '--spec', metavar='FORMULA',
            help='phi_eventually, phi_always, on_runway, usable, NAME=FORMULA, a formula, or a '
            "YAML file of them; repeatable; default: the run's own",
        ),
    ] = None,
    run_id: RunOption = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE.png|DIR', writable=True,
            help='PNG plot of signals, bounds and robustness over time; a folder for several bags',
        ),
    ] = None,
    bound: BoundOption = None,
    rate: RateOption = None,
    add: Annotated[
        bool, typer.Option('--add', help="add a column for each new formula to a campaign's table")
    ] = False,
    as_json: JsonOption = False,
    workers: Annotated[int, typer.Option(min=1, help='worker processes; same results')] = 2,
) -> int:
    """Judge recorded runs by their own requirements or by new ones.

    Needs neither ROS nor camera frames. A bag of several runs, as written by ros2 bag record, gets
    one verdict per run. Re-evaluating a run's own formula reproduces the recorded robustness bit
    for bit. Exit codes: 0 all satisfied, 1 some violated, 2 bad input, 3 some bag is incomplete,
    damaged or inconsistent with its recorded verdict.
    """
    from taxinet_ros.core.mtl import parse_spec
    from taxinet_ros.trials.past_runs.added_requirements import add_requirements, addable
    from taxinet_ros.trials.requirements import check_assumptions, read_specs

    chosen = [parse_spec(text) for text in read_specs(spec or ())]
    vouched = check_assumptions(bound or (), rate or (), chosen) if bound or rate else None
    found = {place: _bags(place) for place in bags}
    paths = list(dict.fromkeys(bag for group in found.values() for bag in group))
    if run_id is not None and len(paths) > 1:
        raise UsageError(f'--run {run_id}: {len(paths)} bags given; name the one with this run')
    to_add = {place: addable(place, chosen) for place in bags} if add else {}
    if add and not chosen:
        raise UsageError('--add: name the requirement to add with --spec')
    told = _RequirementNotes(chosen)
    if plot is not None:
        _check_plot(plot, paths)
    judged = _judged(
        paths, chosen, workers, vouched, as_json=as_json, named=bags, run=run_id, told=told,
    )
    if plot is not None:
        _check_one(plot, judged)
    notes = []
    for place, new in to_add.items():
        counts = add_requirements(place, new, {bag.path: bag for bag in judged if not bag.run})
        notes += [f'{place}: rho_{name} added for {count} runs' for name, count in counts.items()]
    if plot is not None:
        notes += [f'picture: {_draw(bag, vouched, plot)}' for bag in judged
                  if bag.verdicts and bag.end_s >= 0]
    if as_json:
        print(as_document(judged, told.warnings))
    else:
        lines = summary_lines(judged) if len(judged) > 1 else []
        for line in (*lines, *notes):
            line_console().print(line)
    return _exit_code(judged)


def bag_lines(bag: JudgedBag) -> Iterator[Text]:
    """One line per requirement, and one for each problem with the bag."""
    from taxinet_ros.bag.run.judging import BagVerdict

    name = bag.name
    width = max((len(one.spec.name) for one in bag.verdicts), default=0)
    for one in bag.verdicts:
        line = Text(f'{name}  {one.spec.name:<{width}}  ')
        line.append(f'{one.verdict:<10}', style=_STYLES[one.verdict])
        line.append(f'  {_rho(one)}  {_time_words(one)}  ')
        line.append(_recorded(one), style='red' if one.same is False else 'dim')
        line.append(f'  {bag.timing}' if bag.timing else '', style='cyan')
        yield line
        if one.breach_s is not None:
            text = f'assumption violated at {one.breach_s:g} s'
            yield Text(f'{name}  {one.spec.name:<{width}}  {text}', style='yellow')
        if one.verdict is BagVerdict.UNCLEAR:
            yield Text(f'{name}  {one.why}', style='yellow')
    if bag.blind:
        text = f'{bag.blind} of {bag.frames} frames without a usable estimate'
        yield Text(f'{name}  warning: {text}', style='yellow')
    if bag.stopped_early:
        yield Text(f'{name}  stopped early, at {bag.end_s:g} of {bag.duration_s:g} s', style='dim')
    elif 0 <= bag.end_s < bag.duration_s:
        yield Text(f'{name}  ends at {bag.end_s:g} of {bag.duration_s:g} s', style='yellow')
    for words in filter(None, (bag.trouble, bag.note)):
        yield Text(f'{name}  {words}', style='yellow')


def summary_lines(bags: Sequence[JudgedBag]) -> list[str]:
    """Count verdicts per requirement, and those that reproduce the recorded verdict.

    Runs with different timing are counted separately.
    """
    from taxinet_ros.bag.run.judging import BagVerdict
    from taxinet_ros.core.pacing.timing import timing_words

    lines = []
    unit = 'runs' if any(bag.run for bag in bags) else 'bags'
    groups = dict.fromkeys((one.spec.name, bag.timing) for bag in bags for one in bag.verdicts)
    mixed = len({timing for _, timing in groups}) > 1
    for name, timing in groups:
        own = [
            one for bag in bags for one in bag.verdicts
            if (one.spec.name, bag.timing) == (name, timing)
        ]
        counts = Counter(one.verdict for one in own)
        words = ', '.join(f'{counts[each]} {each}' for each in BagVerdict if counts[each])
        recorded = [one for one in own if one.same is not None]
        same = sum(bool(one.same) for one in recorded)
        again = f'; {same} of {len(recorded)} as recorded, to the bit' if recorded else ''
        when = f' ({timing_words(timing)})' if mixed or timing else ''
        lines.append(f'{name}{when}: {words} of {len(own)} {unit}{again}')
    unread = sum(not bag.verdicts for bag in bags)
    return lines + ([f'{unread} bags without a run'] if unread else [])


def as_document(bags: Iterable[JudgedBag], warnings: Sequence[str] = ()) -> str:
    """JSON document; an unknown interval bound is null."""
    values = {'warnings': list(warnings), 'bags': [_bag_document(bag) for bag in bags]}
    return json.dumps(values, indent=2, allow_nan=False)


def _rho(one: SpecVerdict) -> str:
    return one.interval.words(width=9)


def _time_words(one: SpecVerdict) -> str:
    return 'not decided' if one.decided_s is None else f'decided at {one.decided_s:4.1f} s'


def _recorded(one: SpecVerdict) -> str:
    if one.recorded is None:
        return 'not recorded'
    if one.same:
        return 'as recorded'
    lower, upper = one.recorded
    ends = f'{lower:+.17g}' if lower == upper else f'[{lower:+.17g}, {upper:+.17g}]'
    return f'{"DIFFERS from the " if one.same is False else ""}recorded {ends}'


def _bag_document(bag: JudgedBag) -> dict[str, Any]:
    return {
        'bag': str(bag.path), 'run': bag.run or None, 'end_s': bag.end_s,
        'duration_s': _known(bag.duration_s), 'timing': bag.timing,
        'stopped_early': bag.stopped_early,
        'trouble': bag.trouble, 'note': bag.note, 'unusable_estimates': bag.blind or None,
        'verdicts': [
            {
                'spec': one.spec.name, 'formula': one.spec.text, 'verdict': one.verdict,
                **{end: _known(rho) for end, rho in one.interval.by_end().items()},
                'decided_s': one.decided_s, 'breach_s': one.breach_s,
                'recorded': None if one.recorded is None else [*map(_known, one.recorded)],
                'as_recorded': one.same, 'why_unclear': one.why,
            }
            for one in bag.verdicts
        ],
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _bags(place: Path) -> list[Path]:
    """The bags at a given path."""
    from taxinet_ros.bag.layout import STORAGE_ID
    from taxinet_ros.trials.past_runs.added_requirements import campaign_bags
    from taxinet_ros.trials.record.facts import is_campaign

    if place.is_file():
        return [place]
    if not place.is_dir():
        raise UsageError(f'{place}: no such bag; give a run folder, an .mcap file or a campaign')
    # Compressed bags and other storage formats are refused by name.
    if any(path for kind in (f'*.{STORAGE_ID}*', '*.db3') for path in place.glob(kind)):
        return [place]
    bags = campaign_bags(place)
    if not bags:
        what = 'none of its runs left a bag' if is_campaign(place) else 'holds no bag'
        raise UsageError(f'{place}: {what}')
    return bags


def _judged(
    bags: Sequence[Path], specs: Sequence[Spec], workers: int, vouched: Assumptions | None, *,
    as_json: bool, named: Sequence[Path], run: str | None, told: _RequirementNotes,
) -> list[JudgedBag]:
    """Judge all bags and print each verdict as soon as it is available."""
    from taxinet_ros.bag.check.judge import judge_bags
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.trials.past_runs.judged_run import BagPlaces

    console = line_console(stderr=as_json)
    chosen = None if run is None else open_recording(bags[0]).choose(run).name
    if vouched is not None and not specs:
        _check_own_read(vouched, bags, chosen)
    judged: list[JudgedBag] = []
    places = BagPlaces()
    with stage_bars(console) as show:
        for bag in judge_bags(bags, specs, workers, vouched):
            if bag.foreign and bag.path in named:
                raise UsageError(bag.trouble)
            if chosen is not None and bag.run not in ('', chosen):
                continue
            if bag.verdicts and not bag.run:
                places.check(bag.path, whole=not bag.trouble)
            judged.append(bag)
            news = told.of(bag)
            if not as_json:
                for line in (*news, *bag_lines(bag)):
                    console.print(line)
            if len(bags) > 1:
                show('judging', len({one.path for one in judged}), len(bags))
    if not judged:
        raise UsageError(f'--run {run}: no step of it in {bags[0]}')
    return judged


def _check_own_read(vouched: Assumptions, bags: Sequence[Path], run: str | None) -> None:
    """Check that the own requirements of some bag read the signals of the assumptions.

    Raises:
        UsageError: none does.
    """
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.bag.run.samples import run_samples
    from taxinet_ros.core.mtl import parse_spec
    from taxinet_ros.trials.requirements import check_assumptions_read

    own: dict[str, Spec] = {}
    for bag in bags:
        with contextlib.suppress(BagError):
            for samples in run_samples(open_recording(bag), ()):
                if run is None or samples.run in ('', run):
                    own |= {text: parse_spec(text) for text in samples.specs}
    if own:
        check_assumptions_read(vouched, list(own.values()))


class _RequirementNotes:
    """Prints once how each requirement is parsed, and its warnings for each kind of run.

    Attributes:
        warnings: all warnings printed.
    """

    def __init__(self, specs: Sequence[Spec]) -> None:
        self.warnings: list[str] = []
        self._specs = specs
        self._seen: set[Any] = set()

    def of(self, bag: JudgedBag) -> list[Text]:
        """Lines to print before the verdicts of a bag."""
        from taxinet_ros.core.verdict.judge import SpecCheck, describe_specs, signal_ranges
        from taxinet_ros.trials.summary import requirement_lines

        if not bag.duration_s > 0:
            return []
        recorded = bag.duration_s, *_ran_with(bag.path)
        ranges = (bag.duration_s, *signal_ranges(*recorded).items())
        if ranges in self._seen:
            return []
        found = describe_specs(self._specs, *recorded)
        new = tuple(line for line in found.warnings if line not in self.warnings)
        self.warnings += new
        lines = requirement_lines(
            SpecCheck(lines=found.lines, warnings=new), quiet=bool(self._seen)
        )
        self._seen.add(ranges)
        return lines


def _ran_with(bag: Path) -> tuple[SteeringGains, Scenario] | tuple[None, None]:
    """Controller gains and scenario of a bag; None if it does not say which controller ran."""
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.core.motion.controller import SteeringGains

    try:
        run = open_recording(bag).run
        return SteeringGains(**run.gains), run.request.scenario
    except (BagError, UsageError):
        return None, None


def _exit_code(bags: Iterable[JudgedBag]) -> int:
    judged = list(bags)
    violated = [bag for bag in judged if any(one.verdict.failed for one in bag.verdicts)]
    # A recording of several runs usually ends during the last one; the others remain valid. A
    # missing topic does not invalidate the others; damage leaves no verdict at all.
    if any(bag.run or bag.trouble for bag in violated):
        return ExitCode.VIOLATED
    if not all(bag.sound for bag in judged):
        return ExitCode.INCOMPLETE
    return ExitCode.VIOLATED if violated else ExitCode.OK


def _check_plot(plot: Path, bags: Sequence[Path]) -> None:
    if plot.suffix == _PICTURE and len(bags) > 1:
        raise UsageError(f'--plot {plot}: {len(bags)} bags given; name a folder')
    if plot.suffix not in ('', _PICTURE):
        raise UsageError(f'--plot {plot}: write NAME.png, or name a folder')
    folder = plot.parent if plot.suffix else plot
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f'--plot {plot}: cannot be written: {error.strerror}') from error


def _check_one(plot: Path, judged: Sequence[JudgedBag]) -> None:
    if plot.suffix == _PICTURE and len(judged) > 1:
        names = ', '.join(bag.run or bag.name for bag in judged)
        raise UsageError(f'--plot {plot}: the bag holds {names}; name a folder, or one with --run')


def _draw(bag: JudgedBag, vouched: Assumptions | None, plot: Path) -> Path:
    from taxinet_ros.analysis.one_run.robustness import JudgedSpec, robustness_picture
    from taxinet_ros.bag.run.judging import judge_spec, signals_of_specs
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.bag.run.samples import run_samples

    specs = [one.spec for one in bag.verdicts]
    runs = run_samples(open_recording(bag.path), signals_of_specs(specs))
    samples = next(one for one in runs if one.run == bag.run)
    judged = []
    for spec in specs:
        verdict, readings = judge_spec(samples, spec, vouched)
        # If a topic it reads is missing, nothing more is known.
        at = dict(zip(samples.seen_by(spec).stamps_ns, readings, strict=False))
        known = accumulate(
            (at.get(stamp) for stamp in samples.stamps_ns), lambda old, new: new or old,
            initial=readings[0],
        )
        judged.append(JudgedSpec(verdict=verdict, readings=[*known][1:]))
    path = plot if plot.suffix else plot / f'{_file_name(bag)}{_PICTURE}'
    try:
        robustness_picture(
            samples.stamps_ns, samples.samples, judged, path, title=_title(bag),
            end_s=bag.duration_s,
        )
    except OSError as error:
        raise UsageError(f'--plot {path}: cannot be written: {error.strerror}') from error
    return path


def _file_name(bag: JudgedBag) -> str:
    return re.sub(r'[^A-Za-z0-9_.-]+', '_', bag.name)


def _title(bag: JudgedBag) -> str:
    if bag.end_s >= bag.duration_s:
        return bag.name
    why = 'stopped early' if bag.stopped_early else 'incomplete'
    return f'{bag.name}   ({why}: {bag.end_s:g} of {bag.duration_s:g} s)'
