"""Requirements looked at before a run: how they are understood, and what they cannot say of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS, TAXI_SPEED_MPS
from taxinet_ros.core.mtl import SIGNALS, Spec
from taxinet_ros.core.mtl.lint import Setting, check_windows, understood, warnings
from taxinet_ros.core.scenario import RANGES
from taxinet_ros.core.steering import SteeringGains
from taxinet_ros.core.types import NS_PER_S

_OVERSHOOT = 1.5
"""No run is faster than so many times the speed that is held, or that it starts with."""

Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class SpecCheck:
    """What is said of requirements before the first run.

    Attributes:
        lines: how each is understood.
        warnings: what they may say other than was meant, a line each.
    """

    lines: tuple[str, ...]
    warnings: tuple[str, ...]


def check_specs(
    specs: Sequence[Spec], duration_s: float, gains: SteeringGains | None = None
) -> SpecCheck:
    """Look at requirements on a run of the simulator.

    Args:
        specs: the requirements.
        duration_s: length of the run [s].
        gains: of the shipped controller; None where another may steer, of which nothing is known.

    Raises:
        UsageError: a window that can hold no sample of such a run.
    """
    for spec in specs:
        check_windows(spec, round(duration_s * NS_PER_S), CONTROL_PERIOD_NS)
    return describe_specs(specs, duration_s, gains)


def describe_specs(
    specs: Sequence[Spec], duration_s: float, gains: SteeringGains | None = None
) -> SpecCheck:
    """The same for runs that are over: what no sample of them can judge is not refused here."""
    setting = Setting(
        units=SIGNALS, ranges=signal_ranges(duration_s, gains),
        horizon_ns=round(duration_s * NS_PER_S), period_ns=CONTROL_PERIOD_NS,
    )
    return SpecCheck(
        lines=tuple(understood(spec, setting) for spec in specs),
        warnings=tuple(line for spec in specs for line in warnings(spec, setting)),
    )


def signal_ranges(duration_s: float, gains: SteeringGains | None = None) -> Mapping[str, Range]:
    """Where the signals of a run can be at all, by name; never too narrow.

    Args:
        duration_s: length of the run [s].
        gains: of the shipped controller; None where another may steer.
    """
    ranges: dict[str, Range] = {
        'he': (-math.pi, math.pi), 'estimate_gap': (0.0, duration_s + CONTROL_PERIOD_NS / NS_PER_S),
        'unusable_share': (0.0, 1.0),
    }
    if gains is None:
        return ranges
    fastest_mps = _OVERSHOOT * max(TAXI_SPEED_MPS, gains.speed_mps)
    way_m = fastest_mps * duration_s
    for name, key in (('cte', 'cross_track_m'), ('x', 'distance_m')):
        low, high, _ = RANGES[key]
        ranges[name] = low - way_m, high + way_m
    ranges['speed'] = -fastest_mps, fastest_mps
    ranges['steering'] = -gains.max_steering_rad, gains.max_steering_rad
    return ranges
