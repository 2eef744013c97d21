"""The online monitors of the shipped formulas: one sample of a run."""

from __future__ import annotations

import math

from taxinet_ros.bench.measure import Subject
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.loop import MAX_GAP_NS, signals
from taxinet_ros.core.mtl import Monitor, Spec
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.types import TaxiCommand, TrackingError

_LAST = 300


def subjects() -> list[Subject]:
    """One sample of a 30 s run, for every shipped formula."""
    run = [(step * CONTROL_PERIOD_NS, _sample(step)) for step in range(_LAST + 1)]
    return [_follow(spec, run) for spec in SHIPPED.values()]


def _sample(step: int) -> dict[str, float]:
    """Truth that swings into the centreline."""
    cte_m = 6.0 * math.exp(-step / 40) * math.cos(step / 15)
    return signals(
        cte_m=cte_m, he_rad=0.0, x_m=400.0 + 0.5 * step, speed_mps=5.0,
        estimate=TrackingError(cte_m=cte_m, he_rad=0.0),
        command=TaxiCommand(steering_rad=0.0, speed_mps=5.0),
    )  # fmt: skip


def _follow(spec: Spec, run: list[tuple[int, dict[str, float]]]) -> Subject:
    def follow() -> None:
        monitor = Monitor(spec, run[-1][0], max_gap_ns=MAX_GAP_NS)
        for stamp_ns, sample in run:
            monitor.push(stamp_ns, sample)

    return Subject(name=f'monitor/{spec.name} sample', run=follow, calls=len(run))
