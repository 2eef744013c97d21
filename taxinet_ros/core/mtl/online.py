"""Online monitor: the robust satisfaction interval of a run, from its first sample to its end."""

from __future__ import annotations

import enum
import math
import operator
from collections.abc import Mapping
from typing import NamedTuple

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.build import Builder
from taxinet_ros.core.mtl.envelope import Envelope
from taxinet_ros.core.mtl.lower import LowerBound
from taxinet_ros.core.mtl.margin import compile_margin
from taxinet_ros.core.mtl.normal import normalise
from taxinet_ros.core.mtl.specs import SIGNALS, Spec
from taxinet_ros.core.mtl.window import INF


class Verdict(enum.IntEnum):
    """What an interval of robustness says. Only SATISFIED is a success."""

    UNKNOWN = 0
    SATISFIED = 1
    VIOLATED = 2
    MARGINAL = 3
    """Robustness exactly zero; tables count it as a failure, as VerifAI does."""


class Reading(NamedTuple):
    """What is known after a sample (a tuple, because one is made for every sample).

    Attributes:
        lower, upper: every possible completion of the run has its robustness in here. Without a
            complete and valid run this is all there is, and no number in it is *the* robustness.
        verdict: what the interval says; UNKNOWN for ever once the run is not valid.
        final: the run reached its horizon, is valid, and ``lower == upper`` is its robustness.
        valid: no sample was rejected, and no gap was too long, so far.
        samples: number of samples that the interval rests on.
        rejected: number of samples refused.
    """

    lower: float
    upper: float
    verdict: Verdict
    final: bool
    valid: bool
    samples: int
    rejected: int


def verdict_of(lower: float, upper: float) -> Verdict:
    """Verdict on a robustness known to lie in [lower, upper]; give the same number twice for rho.

    Raises:
        UsageError: NaN, or an empty interval.
    """
    if not lower <= upper:
        raise UsageError(f'robustness: [{lower}, {upper}] is no interval')
    if lower > 0:
        return Verdict.SATISFIED
    if upper < 0:
        return Verdict.VIOLATED
    return Verdict.MARGINAL if lower == upper else Verdict.UNKNOWN


class Monitor:
    """Follows one run. Make a new one for the next run.

    The run is the samples with stamps in [0, horizon]. It is complete when a sample stands at the
    horizon or one comes from beyond it (which is not part of the run); until then, and for ever if
    the run ends early, only the interval is known. A refused sample, or a gap, freezes the
    interval where it was: that is still sound, and nothing later is.

    Args:
        spec: the requirement.
        horizon_ns: end of the run on the run's clock [ns].
        bounds: least and greatest value of signals that the user vouches for, by name. They
            narrow the interval before the end.
        rates: greatest change per second of signals that the user vouches for, by name.
        max_gap_ns: longest time without a sample [ns], from the start of the run to the horizon.

    Raises:
        UsageError: a horizon or gap that is not positive, or bad bounds or rates.
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
        for name in [*(bounds or {}), *(rates or {})]:
            if name not in SIGNALS:
                raise UsageError(f'monitor: unknown signal {name!r}; known: {", ".join(SIGNALS)}')
        self.spec = spec
        self.horizon_ns = horizon_ns
        self._max_gap_ns = max_gap_ns
        self._names = ast.signal_names(spec.formula)
        self._envelope = Envelope(self._names, bounds, rates)
        self._assumes = bool(bounds or rates)
        self._stamps_ns: list[int] = []
        self._margins: dict[ast.Compare, list[float]] = {a: [] for a in ast.atoms(spec.formula)}
        self._evaluators = [
            (compile_margin(atom, self._names), column) for atom, column in self._margins.items()
        ]
        self._nodes: list[LowerBound] = []
        self._roots: tuple[LowerBound, LowerBound] | None = None
        self._last_ns = -1
        self._complete = False
        self._reading = Reading(
            lower=-INF,
            upper=INF,
            verdict=Verdict.UNKNOWN,
            final=False,
            valid=True,
            samples=0,
            rejected=0,
        )

    @property
    def reading(self) -> Reading:
        """What is known now."""
        return self._reading

    def push(self, stamp_ns: int, sample: Mapping[str, float]) -> Reading:
        """Take a sample.

        Args:
            stamp_ns: time of the sample since the start of the run [ns].
            sample: values by signal name; signals that the formula does not read are ignored.

        Returns:
            The new reading. The sample is refused, and the run not valid from then on, if its
            stamp is negative, repeated or backward, if a signal that the formula reads or a
            predicate is not finite, or if it breaks the bounds or rates. A sample from beyond the
            horizon completes the run and is not looked at.

        Raises:
            UsageError: a signal that the formula reads is not in the sample.
        """
        stamp_ns = operator.index(stamp_ns)
        if stamp_ns > self.horizon_ns:
            return self._leave(stamp_ns)
        values = self._values(sample)
        margins = [evaluate(values) for evaluate, _ in self._evaluators]
        if stamp_ns <= self._last_ns or not _finite(values, margins):
            return self._invalidate(rejected=1)
        gap = self._gap_to(stamp_ns)
        self._last_ns = stamp_ns
        if gap or not self._reading.valid:
            return self._invalidate(rejected=0)
        if self._assumes and not self._envelope.admits(stamp_ns, values):
            return self._invalidate(rejected=1)
        self._stamps_ns.append(stamp_ns)
        for (_, column), margin in zip(self._evaluators, margins, strict=True):
            column.append(margin)
        self._envelope.accept(stamp_ns, values)
        return self._follow(stamp_ns)

    def _values(self, sample: Mapping[str, float]) -> list[float]:
        try:
            return [float(sample[name]) for name in self._names]
        except KeyError as error:
            raise UsageError(
                f'monitor: {self.spec.name} reads {error}, the sample has {", ".join(sample)}'
            ) from None

    def _gap_to(self, stamp_ns: int) -> bool:
        if self._max_gap_ns is None:
            return False
        return stamp_ns - max(self._last_ns, 0) > self._max_gap_ns

    def _leave(self, stamp_ns: int) -> Reading:
        """Complete the run: its clock went beyond the horizon."""
        if self._complete or not self._reading.valid:
            return self._reading
        if self._gap_to(stamp_ns) or not self._stamps_ns:
            return self._invalidate(rejected=0)
        self._last_ns = self.horizon_ns
        return self._follow(self.horizon_ns)

    def _invalidate(self, rejected: int) -> Reading:
        old = self._reading
        self._reading = Reading(
            lower=old.lower,
            upper=old.upper,
            verdict=Verdict.UNKNOWN,
            final=False,
            valid=False,
            samples=old.samples,
            rejected=old.rejected + rejected,
        )
        return self._reading

    def _follow(self, now_ns: int) -> Reading:
        lower_root, upper_root = self._roots or self._start(now_ns)
        for node in self._nodes:
            node.step(now_ns)
        self._complete = now_ns >= self.horizon_ns
        # Adding zero turns -0.0 into 0.0, as offline.
        lower, upper = lower_root.value[0] + 0.0, 0.0 - upper_root.value[0]
        self._reading = Reading(
            lower=lower,
            upper=upper,
            verdict=verdict_of(lower, upper),
            final=self._complete,
            valid=True,
            samples=len(self._stamps_ns),
            rejected=0,
        )
        return self._reading

    def _start(self, first_ns: int) -> tuple[LowerBound, LowerBound]:
        """Build the nodes for the formula and for its negation; both are asked at sample 0."""
        builder = Builder(self._stamps_ns, self._margins, self._envelope, self.horizon_ns)
        formula = self.spec.formula
        lower = builder.build(normalise(formula), first_ns, first_ns)
        upper = builder.build(normalise(formula, negated=True), first_ns, first_ns)
        self._nodes, self._roots = builder.nodes, (lower, upper)
        return self._roots


def _finite(values: list[float], margins: list[float]) -> bool:
    return all(map(math.isfinite, values)) and all(map(math.isfinite, margins))
