"""The monitors of the shipped formulas: a sample online, a whole run offline, and how both grow."""

from __future__ import annotations

import math
from collections.abc import Sequence

from taxinet_ros.bench.measure import Subject
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.loop import MAX_GAP_NS, signals
from taxinet_ros.core.mtl import Monitor, Spec, parse_spec, robustness
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.types import TaxiCommand, TrackingError

LAST = 300
LENGTHS = {'1k': 1_000, '10k': 10_000, '100k': 100_000}
"""Samples of the longer runs, by the word that names them."""

WINDOWS_S = (10, 100, 1_000)
_GROWING = ('phi_always', 'phi_eventually')
_NESTED = {
    'G F': 'always(eventually[0:5](cte < 0))',
    'G or F': 'always(cte < 1 or eventually[0:5](cte < 0))',
    'F G F': 'eventually[0:5](always(eventually[0:2](cte < 0)))',
    '12 until': '(' * 12 + 'cte < 0' + ') until[0:0.5] (cte < 1)' * 12,
}
"""Where a window stands in another, by the word that names it."""

_OFFLINE_CALLS = 20

Run = Sequence[tuple[int, dict[str, float]]]


def subjects() -> list[Subject]:
    """One sample and the whole of a 30 s run; samples of longer runs and under wider windows."""
    run = swinging_run(LAST)
    found: list[Subject] = []
    for name, spec in SHIPPED.items():
        found += [_online(f'{name} sample', spec, run), _offline(f'{name} offline', spec, run)]
    for word, last in LENGTHS.items():
        longer = swinging_run(last)
        for name in _GROWING:
            found.append(_online(f'{name} sample of {word}', SHIPPED[name], longer))
    for word, last in LENGTHS.items():
        longer = swinging_run(last)
        for name in _GROWING:
            found.append(_offline(f'{name} offline of {word}', SHIPPED[name], longer))
    longer = swinging_run(LENGTHS['10k'])
    for window_s in WINDOWS_S:
        text = f'eventually[0:{window_s}](always(abs(cte) <= 1.5))'
        found.append(_online(f'window of {window_s} s sample of 10k', parse_spec(text), longer))
    for word in ('1k', '10k'):
        longer = swinging_run(LENGTHS[word])
        for name, text in _NESTED.items():
            found.append(_online(f'{name} sample of {word}', parse_spec(text), longer))
    return found


def swinging_run(last: int) -> Run:
    """Truth that swings into the centreline, with stamps [ns]; ``last + 1`` samples."""
    return [(step * CONTROL_PERIOD_NS, _sample(step)) for step in range(last + 1)]


def _sample(step: int) -> dict[str, float]:
    cte_m = 6.0 * math.exp(-step / 40) * math.cos(step / 15)
    return signals(
        cte_m=cte_m, he_rad=0.0, x_m=400.0 + 0.5 * step, speed_mps=5.0,
        estimate=TrackingError(cte_m=cte_m, he_rad=0.0),
        command=TaxiCommand(steering_rad=0.0, speed_mps=5.0),
    )  # fmt: skip


def _online(name: str, spec: Spec, run: Run) -> Subject:
    def follow() -> None:
        monitor = Monitor(spec, run[-1][0], max_gap_ns=MAX_GAP_NS)
        for stamp_ns, sample in run:
            monitor.push(stamp_ns, sample)

    long = len(run) > LENGTHS['1k'] + 1
    return Subject(
        name=f'monitor/{name}',
        run=follow,
        calls=len(run),
        warm_ups=0 if long else 2,
        most=3 if long else None,
    )


def _offline(name: str, spec: Spec, run: Run) -> Subject:
    stamps_ns = [stamp_ns for stamp_ns, _ in run]
    columns = {'cte': [sample['cte'] for _, sample in run]}
    calls = _OFFLINE_CALLS if len(run) <= LENGTHS['1k'] + 1 else 1

    def evaluate() -> None:
        for _ in range(calls):
            robustness(spec.formula, stamps_ns, columns)

    return Subject(name=f'monitor/{name}', run=evaluate, calls=calls, most=20)
