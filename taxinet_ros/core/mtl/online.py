"""Online monitor: the robust satisfaction interval of a run, from its first sample to its end."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.assumptions import Envelope
from taxinet_ros.core.mtl.interval import RobustnessInterval, Verdict
from taxinet_ros.core.mtl.lower_bounds.builder import Builder, Root
from taxinet_ros.core.mtl.lower_bounds.nodes import AtomBound, BoundRequest
from taxinet_ros.core.mtl.margin import Margins
from taxinet_ros.core.mtl.normal_form import CoreAtom
from taxinet_ros.core.mtl.sliding import INF
from taxinet_ros.core.mtl.specs import SIGNALS, Spec
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError


class Reading(NamedTuple):
    """State of a monitor after a sample (a tuple for speed: one is made per sample).

    Attributes:
        lower, upper: interval that contains the robustness of every possible completion of the
            run. The robustness itself is known only for a complete and valid run.
        verdict: verdict of the interval; stays UNKNOWN once the run is invalid.
        final: the run reached its horizon, is valid, and ``lower == upper`` is its robustness.
        valid: no sample was rejected so far, and no gap was too long.
        samples: number of samples used for the interval.
        rejected: number of rejected samples.
        trusted: no sample has violated the assumed bounds and rates. After the first violation the
            interval is computed without them.
    """

    lower: float
    upper: float
    verdict: Verdict
    final: bool
    valid: bool
    samples: int
    rejected: int
    trusted: bool = True

    @property
    def interval(self) -> RobustnessInterval:
        """Lower and upper bound as an interval."""
        return RobustnessInterval(self.lower, self.upper)


class Monitor:
    """Online monitor of one requirement on one run. Create a new one for each run.

    The run consists of the samples with stamps in [0, horizon]. It is complete when a sample
    arrives at the horizon or after it (the latter is not part of the run). Before that, and if the
    run ends early, only the interval is known. A rejected sample or a gap freezes the interval,
    which stays valid; later samples are not used.

    Args:
        spec: the requirement.
        horizon_ns: end of the run on the run's clock [ns].
        bounds: assumed minimum and maximum of signals, by name. They narrow the interval before
            the end.
        rates: assumed maximum change of signals per second, by name.
        max_gap_ns: longest time without a sample [ns], from the start of the run to the horizon.

    Attributes:
        breach: how a sample violated the assumptions, in one line; '' if none did.

    Raises:
        UsageError: a horizon or gap that is not positive, or invalid bounds or rates.
    """

    def __init__(
        self,
        spec: Spec,
        horizon_ns: int,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        rates: Mapping[str, float] | None = None,
        max_gap_ns: int | None = None,
    ) -> None:
        if horizon_ns <= 0:
            raise UsageError(f'monitor: horizon is {horizon_ns} ns, needs to be > 0')
        if max_gap_ns is not None and max_gap_ns <= 0:
            raise UsageError(f'monitor: max_gap is {max_gap_ns} ns, needs to be > 0')
        self.spec = spec
        self.horizon_ns = horizon_ns
        self.breach = ''
        self._max_gap_ns = INF if max_gap_ns is None else max_gap_ns
        self._names = ast.signal_names(spec.formula)
        for name in [*(bounds or {}), *(rates or {})]:
            if name not in SIGNALS and name not in self._names:
                raise UsageError(f'monitor: unknown signal {name!r}; known: {", ".join(SIGNALS)}')
        self._envelope = Envelope(self._names, bounds, rates)
        self._assumes = bool(bounds or rates)
        self._stamps_ns: list[int] = []
        self._margins = Margins(spec.formula, self._names)
        self._roots: tuple[Root, Root] | None = None
        self._last_ns = -1
        self._complete = False
        self._reading = Reading(-INF, INF, Verdict.UNKNOWN, False, True, 0, 0)

    @property
    def reading(self) -> Reading:
        """The current reading."""
        return self._reading

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of the samples used for the interval [ns]."""
        return tuple(self._stamps_ns)

    def roots(self) -> tuple[Root, Root]:
        """Lower bounds of the formula and of its negation, brought up to date.

        Raises:
            UsageError: there is no sample yet.
        """
        if self._roots is None:
            raise UsageError(f'monitor: {self.spec.name} has no sample yet')
        for root in self._roots:
            root.follow(self.horizon_ns if self._complete else self._stamps_ns[-1])
        return self._roots

    def push(self, stamp_ns: int, sample: Mapping[str, float]) -> Reading:
        """Process a sample.

        Args:
            stamp_ns: time of the sample since the start of the run [ns].
            sample: values by signal name; signals that the formula does not read are ignored.

        Returns:
            The new reading. The sample is rejected, and the run invalid from then on, if its stamp
            is negative, repeated or decreasing, or if a signal that the formula reads or a
            predicate is not finite. A sample after the horizon completes the run; its values are
            ignored.

        Raises:
            UsageError: a signal that the formula reads is not in the sample.
        """
        stamp_ns = operator.index(stamp_ns)
        if stamp_ns > self.horizon_ns:
            return self._leave(stamp_ns)
        try:
            values = [float(sample[name]) for name in self._names]
        except KeyError as error:
            raise UsageError(
                f'monitor: {self.spec.name} reads {error}, the sample has {", ".join(sample)}'
            ) from None
        margins = self._margins.of(values)
        last_ns = self._last_ns
        # Fast test: a finite sum implies finite terms; if it overflows, test them one by one.
        if stamp_ns <= last_ns or not (
            math.isfinite(sum(margins, sum(values))) or _finite(values, margins)
        ):
            return self._invalidate(rejected=1)
        self._last_ns = stamp_ns
        if stamp_ns - (last_ns if last_ns > 0 else 0) > self._max_gap_ns or not self._reading.valid:
            return self._invalidate(rejected=0)
        self._stamps_ns.append(stamp_ns)
        self._margins.append(margins)
        if self._assumes:
            self._check(stamp_ns, values)
        return self._follow(stamp_ns)

    def _check(self, stamp_ns: int, values: list[float]) -> None:
        """Check a sample against the assumptions; drop them all at the first violation."""
        breach = self._envelope.breach(stamp_ns, values)
        if breach:
            self.breach = f'at {stamp_ns / NS_PER_S:g} s {breach}'
            self._envelope = Envelope(self._names, None, None)
            self._assumes = False
            self._roots = None
        self._envelope.accept(stamp_ns, values)

    def _leave(self, stamp_ns: int) -> Reading:
        """Complete the run: a sample arrived after the horizon."""
        if self._complete or not self._reading.valid:
            return self._reading
        if stamp_ns - max(self._last_ns, 0) > self._max_gap_ns or not self._stamps_ns:
            return self._invalidate(rejected=0)
        self._last_ns = self.horizon_ns
        return self._follow(self.horizon_ns)

    def _invalidate(self, rejected: int) -> Reading:
        old = self._reading
        self._reading = old._replace(
            verdict=Verdict.UNKNOWN, final=False, valid=False, rejected=old.rejected + rejected
        )
        return self._reading

    def _follow(self, now_ns: int) -> Reading:
        lower_root, upper_root = self._roots or self._start()
        if now_ns >= lower_root.wake_ns:
            lower_root.follow(now_ns)
        if now_ns >= upper_root.wake_ns:
            upper_root.follow(now_ns)
        lower, upper = lower_root.bound, 0.0 - upper_root.bound
        old = self._reading
        same = lower == old.lower and upper == old.upper
        self._complete = final = now_ns >= self.horizon_ns
        # tuple.__new__ for speed: the constructor of a named tuple takes 1.5 times as long as this.
        self._reading = tuple.__new__(
            Reading,
            (
                lower,
                upper,
                old.verdict if same else RobustnessInterval(lower, upper).verdict,
                final,
                True,
                len(self._stamps_ns),
                0,
                not self.breach,
            ),
        )
        return self._reading

    def _start(self) -> tuple[Root, Root]:
        """Build the nodes of the formula and of its negation, both evaluated at sample 0."""
        lower, upper = (
            Root(
                self.spec.formula, Builder(self._stamps_ns, self.horizon_ns, self._atom),
                self._stamps_ns[0], negated=negated,
            )
            for negated in (False, True)
        )
        self._roots = lower, upper
        return self._roots

    def _atom(self, core: CoreAtom, asked: BoundRequest) -> AtomBound:
        atom, negated, envelope = core.atom, core.negated, self._envelope
        return AtomBound(
            asked,
            margins=self._margins.column(atom, negated),
            floor=envelope.floor(atom, negated),
            outlook=partial(envelope.least_margin, atom, negated) if envelope.moves(atom) else None,
        )


def _finite(values: list[float], margins: list[float]) -> bool:
    return all(map(math.isfinite, values)) and all(map(math.isfinite, margins))
