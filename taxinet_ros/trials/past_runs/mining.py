"""The tightest parameters of a formula that hold for a share of a program's runs.

Each run has a tightest value of a parameter (:mod:`taxinet_ros.core.mtl.mine`), and the formula
holds for a share of the runs from that quantile of these values on. Its interval has no assumption
about their distribution: a value is excluded if the binomial interval of the share of runs that
satisfy with it, of :mod:`taxinet_ros.trials.rates`, excludes the wanted one (order statistics).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.mtl.mine import Parameter, Template
from taxinet_ros.core.types import NS_PER_S, rate_of
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign, check_same_run
from taxinet_ros.trials.rates import TAIL, anytime_bounds, share_bounds, without_gaps


class Trace(NamedTuple):
    """Stamps of a run [ns], and the signals that a formula reads."""

    stamps_ns: Sequence[int]
    signals: dict[str, list[float]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Mined:
    """A parameter's tightest value that holds for a share of the runs, given the other one.

    Attributes:
        other: value of the other parameter, or None.
        value: tightest value that holds for the share of these runs; infinite if none does.
        tighter, looser: ends of its 95 % interval; infinite where the runs are too few.
    """

    other: float | None
    value: float
    tighter: float
    looser: float


def step_ns(campaign: RecordedCampaign) -> int:
    """Time of which the control period of each run is a multiple [ns]."""
    return NS_PER_S // math.lcm(*(rate_of(row.period_ns) for row in campaign.rows))


def program_traces(
    campaign: RecordedCampaign, template: Template,
    on_run: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[list[Trace], bool]:
    """Traces of the runs that the program itself drew, and whether their number was not fixed.

    Raises:
        UsageError: there are none, or one of them cannot be evaluated: leaving it out would bias
            the share.
    """
    rate = campaign.failure_rate
    if why := rate.why_not:
        raise UsageError(f'{campaign.folder}: {why}')
    outcomes = {row.index: row.outcome for row in campaign.rows}
    counted = without_gaps(outcomes, campaign.planned_runs)
    rows = [row for row in campaign.judged if row.index < counted and row.from_program]
    traces = []
    for number, row in enumerate(rows, start=1):
        place, bag = campaign.folder / row.run_id, campaign.bag(row)
        if bag is None:
            raise UsageError(
                f'{place}: has no bag, and the table has no values over time; run the campaign '
                'again, with images none if bags are too large'
            )
        try:
            recording = open_recording(bag)
            check_same_run(row, campaign.facts, recording)
            samples = recording.samples_of(template.read())
        except BagError as error:
            raise UsageError(str(error)) from None
        if samples.stopped_early:
            raise UsageError(
                f'{place}: was stopped early, so its end is not known; run the campaign again '
                'without stop_on'
            )
        if trouble := samples.trouble or '; '.join(samples.flaws.values()):
            raise UsageError(f'{place}: {trouble}')
        traces.append(Trace(samples.stamps_ns, {
            name: [sample[name] for sample in samples.samples] for name in template.read()
        }))
        on_run(number, len(rows))
    return traces, rate.anytime


def mine(
    template: Template, traces: Sequence[Trace], share: float, *, anytime: bool, points: int,
) -> Iterator[Mined]:
    """The tightest values that hold for a share of the runs.

    Of two parameters it is the front: values of the first for each value of the other, a time,
    without those that are looser in one and tighter in none.

    Args:
        template: the formula.
        traces: runs that the program itself drew.
        share: share of the runs for which the formula has to hold.
        anytime: their number was not fixed beforehand.
        points: number of values of the other parameter.

    Raises:
        UsageError: neither of two parameters is a time.
    """
    target, other = order(template)
    best = math.inf
    for value in [None] if other is None else _grid(other, traces, points):
        others = {} if other is None or value is None else {other.name: value}
        found = [
            template.tightest(target, others, trace.stamps_ns, trace.signals) for trace in traces
        ]
        one = quantile(found, share, rises=target.rises, anytime=anytime)
        loose = one.value if target.rises else -one.value
        # The values of the other one become looser: it has to gain from that.
        if other is None or loose < best:
            best = min(best, loose)
            yield replace(one, other=value)


def order(template: Template) -> tuple[Parameter, Parameter | None]:
    """The parameter whose tightest values are sought, and the one whose values are given.

    Raises:
        UsageError: neither of two parameters is a time.
    """
    first, *more = sorted(template.parameters, key=lambda one: one.mark_ns > 0)
    if more and not more[0].mark_ns:
        raise UsageError(
            f'mine: {first.name} and {more[0].name} are both numbers; one of two parameters has to '
            'be an end of a window, which has a range: write a number for one of them'
        )
    return first, more[0] if more else None


def _grid(other: Parameter, traces: Iterable[Trace], points: int) -> list[float]:
    """Evenly spread times from the tightest to the loosest."""
    times_s = other.times_s(min(int(trace.stamps_ns[-1]) for trace in traces))
    chosen = {round(at * (len(times_s) - 1) / max(points - 1, 1)) for at in range(points)}
    return [times_s[at] for at in sorted(chosen)]


def quantile(
    values: Sequence[float], share: float, *, rises: bool, anytime: bool
) -> Mined:
    """Value from which on a share of the runs satisfy, with its 95 % interval.

    Args:
        values: the tightest value of each run.
        share: the share.
        rises: whether a greater value is looser.
        anytime: the number of runs was not fixed beforehand.
    """
    sign, n = 1.0 if rises else -1.0, len(values)
    loose = sorted(sign * value for value in values)
    ends = anytime_bounds if anytime else share_bounds
    bounds = [ends(hits, n - hits, TAIL) for hits in range(n + 1)]
    # With the k-th value, k runs satisfy.
    enough = next((k for k in range(n + 1) if bounds[k][0] >= share), None)
    too_few = max((k for k in range(n) if bounds[k][1] < share), default=None)
    return Mined(
        other=None, value=sign * loose[math.ceil(share * n - 1e-9) - 1],
        tighter=-sign * math.inf if too_few is None else sign * loose[too_few],
        looser=sign * math.inf if enough is None else sign * loose[enough - 1],
    )
