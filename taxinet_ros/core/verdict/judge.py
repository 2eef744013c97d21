"""Requirements of a run: checked before it, evaluated by online monitors during it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, max_gap_ns
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.mtl import (
    NO_ASSUMPTIONS,
    SIGNALS,
    Assumptions,
    Monitor,
    Reading,
    Spec,
    signal_names,
)
from taxinet_ros.core.mtl.lint import Setting, check_windows, reach_words, spec_line, warnings
from taxinet_ros.core.mtl.specs import MOST_CLEARANCE_M, MOST_HOLD_DISTANCE_M, OF_OTHERS, SHIPPED
from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M
from taxinet_ros.core.rig.aircraft_model import USUAL_SPEED_MPS
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic import HOLD_LINE, GroundObject, Traffic
from taxinet_ros.core.types import NS_PER_S, run_length_ns
from taxinet_ros.core.verdict.judging import StopOn, stops
from taxinet_ros.core.verdict.run_statistics import (
    EstimateWatch,
    RunStatistics,
    RunStatisticsCollector,
)
from taxinet_ros.errors import UsageError

_OVERSHOOT = 1.5
"""Upper bound of the speed, as a factor on the commanded or initial speed."""
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class SpecCheck:
    """Result of checking requirements before the first run.

    Attributes:
        lines: how each is parsed.
        warnings: likely mistakes, one line each.
        reaches: known ranges of the signals that each reads, and how far it looks.
        shared: scenario values, in human units, that all scenes have.
    """

    lines: tuple[str, ...]
    warnings: tuple[str, ...]
    reaches: tuple[str, ...] = ()
    shared: Mapping[str, Any] = field(default_factory=dict)


def check_specs(
    specs: Sequence[Spec], scenario: Scenario, gains: SteeringGains | None = None
) -> SpecCheck:
    """Check requirements for a run of the simulator.

    Args:
        specs: the requirements.
        scenario: of the run.
        gains: gains of the shipped controller; None for any other controller.

    Raises:
        UsageError: a window can contain no sample of such a run, or ``on_runway`` is used for a
            runway of another width.
    """
    for spec in specs:
        check_windows(spec, scenario.duration_ns, scenario.period_ns)
        check_edge(spec, scenario.line.half_width_m)
    return describe_specs(specs, scenario.duration_s, gains, scenario)


def check_edge(spec: Spec, half_width_m: float) -> None:
    """Check that ``on_runway`` is used only for runways as wide as the paper's.

    Raises:
        UsageError: the width differs.
    """
    if spec == SHIPPED['on_runway'] and half_width_m != KMWH_HALF_WIDTH_M:
        raise UsageError(
            f'{spec.name}: its edges are those of a runway {2 * KMWH_HALF_WIDTH_M:g} m wide, here '
            f'it is {2 * half_width_m:g} m; write inside=always(abs(cte) <= {half_width_m:g})'
        )


def reads_others(specs: Sequence[Spec]) -> bool:
    """Whether a formula is about others on the ground."""
    return any(name in OF_OTHERS for spec in specs for name in signal_names(spec.formula))


def read_objects(specs: Sequence[Spec], others: Traffic) -> tuple[GroundObject, ...]:
    """Those of others on the ground that formulas are about: hold lines, or what can be hit."""
    read = {name for spec in specs for name in signal_names(spec.formula)} & OF_OTHERS
    kinds = {name == 'hold_distance' for name in read}
    return tuple(
        one for one in others.objects
        if (True in kinds and one.kind == HOLD_LINE) or (False in kinds and one.solid)
    )


def check_others(specs: Sequence[Spec], *scenarios: Scenario) -> None:
    """Refuse formulas about others on the ground where nobody is: nothing could violate them.

    Args:
        specs: the formulas.
        scenarios: scenes of one program; it is enough that one has what a formula is about.

    Raises:
        UsageError: there is such a formula, and nothing that can be hit or no hold line, or the
            aircraft has no outline.
    """
    read = [(spec, name) for spec in specs for name in signal_names(spec.formula)]
    for spec, name in read if scenarios else ():
        if name not in OF_OTHERS:
            continue
        if not any(read_objects([spec], one.others) for one in scenarios):
            missing = (
                f'there is no {HOLD_LINE}; place one on the track' if name == 'hold_distance' else
                'nobody is on the ground to be near; place objects that can be hit'
            )
            raise UsageError(
                f'{spec.name}: reads {name}, and {missing} (docs/world.md), or leave the formula '
                'out'
            )
        aircraft = [one.aircraft_model for one in scenarios]
        if not any(part.shades for one in aircraft for part in one.outline):
            raise UsageError(
                f'{spec.name}: reads {name}, and the outline of aircraft {aircraft[0].name} is '
                'unknown; give it one (docs/world.md), or leave the formula out'
            )


def describe_specs(
    specs: Sequence[Spec], duration_s: float, gains: SteeringGains | None = None,
    scenario: Scenario | None = None,
) -> SpecCheck:
    """Like :func:`check_specs`, for finished runs: windows are not checked."""
    period_ns = _period_ns(scenario)
    setting = Setting(
        units=SIGNALS, ranges=signal_ranges(duration_s, gains, scenario),
        horizon_ns=run_length_ns(duration_s, period_ns), period_ns=period_ns,
    )
    return SpecCheck(
        lines=tuple(spec_line(spec, setting) for spec in specs),
        warnings=tuple(line for spec in specs for line in warnings(spec, setting)),
        reaches=tuple(reach_words(spec, setting) for spec in specs),
    )


def signal_ranges(
    duration_s: float, gains: SteeringGains | None = None, scenario: Scenario | None = None
) -> Mapping[str, Range]:
    """Conservative ranges of the signals of a run, by name.

    Args:
        duration_s: length of the run [s].
        gains: gains of the shipped controller; None for any other.
        scenario: of the run; None if unknown. Wind, slope or reduced friction move the aircraft
            to where the controller does not take it, so motion is then unbounded.
    """
    ranges: dict[str, Range] = {
        'he': (-math.pi, math.pi),
        'estimate_gap': (0.0, duration_s + _period_ns(scenario) / NS_PER_S),
        'unusable_share': (0.0, 1.0), 'cte_sigma': (0.0, math.inf), 'he_sigma': (0.0, math.inf),
        'clearance': (0.0, MOST_CLEARANCE_M), 'collision': (0.0, 1.0),
        'hold_distance': (-math.inf, MOST_HOLD_DISTANCE_M),
    }
    if gains is None or scenario is None:
        return ranges
    ranges['steering'] = -gains.max_steering_rad, gains.max_steering_rad
    if scenario.pushed:
        return ranges
    fastest_mps = _OVERSHOOT * max(USUAL_SPEED_MPS, gains.speed_mps, scenario.speed_mps)
    way_m, line = fastest_mps * duration_s, scenario.line
    side_m = line.farthest_start_m + way_m
    ranges['cte'] = -side_m, side_m
    # Inside a curve the distance grows faster than the aircraft moves.
    ahead_m = line.last_start_m if line.is_runway else line.length_m
    ranges['x'] = -way_m, ahead_m + way_m
    ranges['speed'] = -fastest_mps, fastest_mps
    return ranges


def _period_ns(scenario: Scenario | None) -> int:
    return CONTROL_PERIOD_NS if scenario is None else scenario.period_ns


@dataclass(frozen=True, kw_only=True, slots=True)
class Judgement:
    """Result of judging a run.

    Attributes:
        readings: latest reading of each formula, in the order of the specs.
        complete: the horizon was reached, every sample was usable, and every formula used at least
            one.
        stopped_early: the stop rule was met at the latest sample, before the horizon.
        satisfied: complete or stopped early, and every formula has robustness > 0.
        statistics: statistics of the samples so far.
    """

    readings: tuple[Reading, ...]
    complete: bool
    stopped_early: bool
    satisfied: bool
    statistics: RunStatistics


class Judge:
    """Judges one run, sample by sample."""

    def __init__(
        self, specs: Sequence[Spec], horizon_ns: int, period_ns: int,
        stop_on: StopOn = StopOn.NEVER, assumptions: Assumptions = NO_ASSUMPTIONS,
        half_width_m: float = KMWH_HALF_WIDTH_M,
    ) -> None:
        """Start a run.

        Args:
            specs: formulas to evaluate; the first is the headline.
            horizon_ns: last stamp of the run [ns].
            period_ns: time between samples [ns]; a longer gap (:func:`.max_gap_ns`) invalidates
                the run.
            stop_on: rule that ends the run before its horizon.
            assumptions: assumptions of the user.
            half_width_m: half the width of the runway or track [m].

        Raises:
            UsageError: a formula has a window beyond the end of the run, or ``on_runway`` is used
                for a runway of another width.
        """
        for spec in specs:
            check_windows(spec, horizon_ns)
            check_edge(spec, half_width_m)
        self._monitors = [
            Monitor(
                spec, horizon_ns, assumptions.bounds, assumptions.rates,
                max_gap_ns=max_gap_ns(period_ns),
            ) for spec in specs
        ]
        self._readings: tuple[Reading, ...] = ()
        self._stop_on = stop_on
        self._breaches: set[str] = set()
        self._collector = RunStatisticsCollector(half_width_m)
        read = {name for spec in specs for name in signal_names(spec.formula)}
        watched = not read.isdisjoint(EstimateWatch.NAMES)
        self._watch = EstimateWatch(horizon_ns, period_ns) if watched else None

    def push(self, stamp_ns: int, sample: Mapping[str, float]) -> tuple[Reading, ...]:
        """Add the signals at ``stamp_ns``; return one reading per formula.

        Args:
            stamp_ns: time since the start of the run [ns].
            sample: the signals as given by :func:`.signals`; those that depend on earlier
                frames are added here if a formula reads them.
        """
        if self._watch is not None:
            sample = {**sample, **self._watch.signals(stamp_ns, sample)}
        self._readings = tuple(monitor.push(stamp_ns, sample) for monitor in self._monitors)
        self._collector.push(stamp_ns, sample)
        return self._readings

    def new_breaches(self) -> list[str]:
        """Violations of assumptions by the latest sample, one line each."""
        told = {monitor.breach for monitor in self._monitors if monitor.breach} - self._breaches
        self._breaches |= told
        return sorted(told)

    @property
    def stopped_early(self) -> bool:
        """Whether the run ends at the latest sample, before its horizon."""
        return bool(self._readings) and stops(self._stop_on, self._readings)

    @property
    def judgement(self) -> Judgement:
        """The verdict so far; PASS or FAIL only if the run is complete or stopped early."""
        complete = bool(self._readings) and all(
            r.final and r.valid and not r.interval.unclear for r in self._readings
        )
        stopped_early = self.stopped_early
        return Judgement(
            readings=self._readings,
            complete=complete,
            stopped_early=stopped_early,
            satisfied=(complete or stopped_early)
            and all(reading.interval.satisfied for reading in self._readings),
            statistics=self._collector.statistics,
        )
