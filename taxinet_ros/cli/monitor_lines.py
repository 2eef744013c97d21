"""What ``taxinet monitor`` prints: a line for each bag and requirement, counts, or JSON."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from rich.text import Text

from taxinet_ros.bag.judged_bag import BagVerdict, JudgedBag, SpecVerdict
from taxinet_ros.core.timing import timing_words

_STYLES = {
    BagVerdict.SATISFIED: 'green', BagVerdict.VIOLATED: 'red', BagVerdict.MARGINAL: 'red',
    BagVerdict.INCOMPLETE: 'yellow', BagVerdict.INVALID: 'bold magenta',
    BagVerdict.UNCLEAR: 'yellow',
}


def bag_lines(bag: JudgedBag) -> Iterator[Text]:
    """A line for each requirement, and one for what is wrong with the bag."""
    name = bag.name
    width = max((len(one.spec.name) for one in bag.verdicts), default=0)
    for one in bag.verdicts:
        line = Text(f'{name}  {one.spec.name:<{width}}  ')
        line.append(f'{one.verdict:<10}', style=_STYLES[one.verdict])
        line.append(f'  {_rho(one)}  {_when(one)}  ')
        line.append(_recorded(one), style='red' if one.same is False else 'dim')
        line.append(f'  {bag.timing}' if bag.timing else '', style='cyan')
        yield line
        if one.breach_s is not None:
            text = f'a bound or rate broken at {one.breach_s:g} s counts no more'
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
    """How many bags say what of each requirement, and how many repeat what was recorded.

    Runs whose answers took effect at different times are never counted together.
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
    return lines + ([f'{unread} bags tell of no run'] if unread else [])


def as_document(bags: Iterable[JudgedBag], warnings: Sequence[str] = ()) -> str:
    """All of it as JSON; an end of an interval that is not known is null."""
    values = {'warnings': list(warnings), 'bags': [_bag(bag) for bag in bags]}
    return json.dumps(values, indent=2, allow_nan=False)


def _rho(one: SpecVerdict) -> str:
    if one.lower == one.upper:
        return f'rho {one.lower:+9.3f}'
    return f'rho within [{one.lower:+.3f}, {one.upper:+.3f}]'


def _when(one: SpecVerdict) -> str:
    return 'not decided' if one.decided_s is None else f'decided at {one.decided_s:4.1f} s'


def _recorded(one: SpecVerdict) -> str:
    if one.recorded is None:
        return 'not recorded'
    if one.same:
        return 'as recorded'
    lower, upper = one.recorded
    ends = f'{lower:+.17g}' if lower == upper else f'[{lower:+.17g}, {upper:+.17g}]'
    return f'{"DIFFERS from the " if one.same is False else ""}recorded {ends}'


def _bag(bag: JudgedBag) -> dict[str, Any]:
    return {
        'bag': str(bag.path), 'run': bag.run or None, 'end_s': bag.end_s,
        'duration_s': _known(bag.duration_s), 'timing': bag.timing,
        'stopped_early': bag.stopped_early,
        'trouble': bag.trouble, 'note': bag.note, 'unusable_estimates': bag.blind or None,
        'verdicts': [
            {
                'spec': one.spec.name, 'formula': one.spec.text, 'verdict': one.verdict,
                'rho_lower': _known(one.lower), 'rho_upper': _known(one.upper),
                'decided_s': one.decided_s, 'breach_s': one.breach_s,
                'recorded': None if one.recorded is None else [*map(_known, one.recorded)],
                'as_recorded': one.same, 'why_unclear': one.why,
            }
            for one in bag.verdicts
        ],
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
