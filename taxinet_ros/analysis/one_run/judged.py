"""Verdicts of requirements on recorded runs, as lines of the terminal and as JSON."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.text import Text

from taxinet_ros.bag.check.judge import JudgedBag
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.judging import BagVerdict, SpecVerdict
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.samples import run_samples
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.mtl import Assumptions, Spec, check_read, parse_spec
from taxinet_ros.core.mtl.explain import DECIDES, Explanation
from taxinet_ros.core.pacing.timing import timing_words
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S, time_words
from taxinet_ros.core.verdict.judge import (
    SpecCheck,
    check_others,
    describe_specs,
    reads_others,
    signal_ranges,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import plain
from taxinet_ros.trials.summary import requirement_lines

_STYLES = {
    'SATISFIED': 'green', 'VIOLATED': 'red', 'MARGINAL': 'red', 'INCOMPLETE': 'yellow',
    'INVALID': 'bold magenta', 'UNCLEAR': 'yellow',
}
"""Styles of the words of a :class:`.BagVerdict`."""


def bag_lines(bag: JudgedBag) -> Iterator[Text]:
    """One line per requirement, and one for each problem with the bag."""
    name = bag.name
    width = max((len(one.spec.name) for one in bag.verdicts), default=0)
    for one in bag.verdicts:
        line = Text(f'{name}  {one.spec.name:<{width}}  ')
        line.append(f'{one.verdict:<10}', style=_STYLES[one.verdict])
        line.append(f'  {one.interval.words(width=9)}  {_time_words(one)}  ')
        line.append(_recorded(one), style='red' if one.same is False else 'dim')
        line.append(f'  {bag.timing}' if bag.timing else '', style='cyan')
        yield line
        if one.breach_s is not None:
            text = f'assumption violated at {one.breach_s:g} s'
            yield Text(f'{name}  {one.spec.name:<{width}}  {text}', style='yellow')
        if one.verdict is BagVerdict.UNCLEAR:
            yield Text(f'{name}  {one.why}', style='yellow')
        for text in () if one.explanation is None else one.explanation.lines():
            yield Text(f'    {text}', style='bold' if text.endswith(DECIDES) else '')
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


def judged_json(bags: Iterable[JudgedBag], warnings: Sequence[str] = ()) -> dict[str, Any]:
    """The same as plain values; an unknown end of an interval is null."""
    return plain({'warnings': warnings, 'bags': [
        {
            'bag': bag.path, 'run': bag.run or None, 'end_s': bag.end_s,
            'duration_s': bag.duration_s, 'timing': bag.timing,
            'stopped_early': bag.stopped_early, 'trouble': bag.trouble, 'note': bag.note,
            'unusable_estimates': bag.blind or None,
            'verdicts': [
                {
                    'spec': one.spec.name, 'formula': one.spec.text, 'verdict': one.verdict,
                    **one.interval.by_end(), 'decided_s': one.decided_s, 'breach_s': one.breach_s,
                    'recorded': one.recorded and [*one.recorded], 'as_recorded': one.same,
                    'why_unclear': one.why, **clauses_json(one.explanation),
                }
                for one in bag.verdicts
            ],
        } for bag in bags
    ]})


def clauses_json(found: Explanation | None) -> dict[str, Any]:
    """Every part of a formula at the sample that matters; nothing if it was not asked for."""
    if found is None:
        return {}
    return {'witness_s': found.witness_s, 'clauses': [
        {
            'text': one.text, 'columns': [*one.columns], 'depth': one.depth,
            'at_s': found.stamps_ns[one.row] / NS_PER_S,
            **(one.interval.by_end() if one.interval else {}), 'decides': one.decides,
        } for one in found.clauses
    ]}


def _time_words(one: SpecVerdict) -> str:
    return 'not decided' if one.decided_s is None else f'decided at {time_words(one.decided_s, 4)}'


def _recorded(one: SpecVerdict) -> str:
    if one.recorded is None:
        return 'not recorded'
    if one.same:
        return 'as recorded'
    lower, upper = one.recorded
    ends = f'{lower:+.17g}' if lower == upper else f'[{lower:+.17g}, {upper:+.17g}]'
    return f'{"DIFFERS from the " if one.same is False else ""}recorded {ends}'


def check_own_read(vouched: Assumptions, bags: Sequence[Path], run: str | None) -> None:
    """Check that the own requirements of some bag read the signals of the assumptions.

    Raises:
        UsageError: none does.
    """
    own: dict[str, Spec] = {}
    for bag in bags:
        with contextlib.suppress(BagError):
            for samples in run_samples(open_recording(bag), ()):
                if run is None or samples.run in ('', run):
                    own |= {text: parse_spec(text) for text in samples.specs}
    if own:
        check_read(vouched, (spec.formula for spec in own.values()))


def check_others_there(specs: Sequence[Spec], bags: Sequence[Path]) -> None:
    """Refuse formulas about others on the ground where no run has any, as before a run.

    Raises:
        UsageError: see :func:`.check_others`.
    """
    scenarios = []
    for bag in bags if reads_others(specs) else ():
        with contextlib.suppress(BagError):
            scenarios += [one.scenario for one in open_recording(bag)]
    check_others(specs, *scenarios)


class RequirementNotes:
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
    try:
        run = open_recording(bag).run
        return SteeringGains(**run.gains), run.request.scenario
    except (BagError, UsageError):
        return None, None
