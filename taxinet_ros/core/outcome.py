"""How a run may end: the rule that stops it early, and its outcome, exactly one of five.

Only the first two outcomes carry a robustness. A run may end before its horizon as soon as what it
was run for is decided. Robust satisfaction intervals make that sound: once an interval leaves zero
behind, no completion of the run brings it back (Deshmukh et al., Formal Methods in System Design
51, 2017).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self

from taxinet_ros.core.mtl import Reading, RobustnessInterval, exact_rho
from taxinet_ros.core.run_statistics import RunStatistics
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError


class StopOn(enum.StrEnum):
    """What ends a run early."""

    NEVER = 'never'
    VIOLATED = 'violated'
    """The first formula, the headline, can no longer have robustness > 0: the run has failed."""
    DECIDED = 'decided'
    """Every formula is decided: robustness > 0 is certain, or out of reach."""


def parse_stop_on(word: str) -> StopOn:
    """The rule of this name; '' is never, as in recordings from before there was a choice.

    Raises:
        UsageError: there is none by that name.
    """
    try:
        return StopOn(word or StopOn.NEVER)
    except ValueError:
        raise UsageError(f'--stop-on {word}: unknown; known: {", ".join(StopOn)}') from None


def stops(stop_on: StopOn, readings: Sequence[Reading]) -> bool:
    """Whether a run ends at the sample of these readings, though its horizon is not reached.

    A run with an unusable sample is never stopped: it has no verdict, early or late.
    """
    if any(reading.final or not reading.valid or reading.interval.unclear for reading in readings):
        return False
    if stop_on is StopOn.VIOLATED:
        return readings[0].interval.failed
    if stop_on is StopOn.DECIDED:
        return all(reading.interval.decided for reading in readings)
    return False


class Outcome(enum.StrEnum):
    """The outcome taxonomy: a system that fails its specification is not a bench that broke."""

    PASS = 'PASS'
    FAIL = 'FAIL'
    REJECTED = 'REJECTED'
    INFRA_ERROR = 'INFRA_ERROR'
    INTERRUPTED = 'INTERRUPTED'

    @property
    def judged(self) -> bool:
        """Whether the run was judged: it was whole, or was stopped when that was decided."""
        return self in (Outcome.PASS, Outcome.FAIL)


class Judged(Protocol):
    """What a judge says of a run: a :class:`.judge.Judgement`, or the message made of one."""

    @property
    def complete(self) -> bool:
        """Whether the run reached its horizon and could be judged."""

    @property
    def stopped_early(self) -> bool:
        """Whether it was ended before, because its verdict was in."""

    @property
    def satisfied(self) -> bool:
        """Whether every formula has robustness > 0."""


def outcome_of(judgement: Judged) -> Outcome:
    """PASS or FAIL; INFRA_ERROR where there was no whole, finite sequence of samples to judge."""
    if not (judgement.complete or judgement.stopped_early):
        return Outcome.INFRA_ERROR
    return Outcome.PASS if judgement.satisfied else Outcome.FAIL


@dataclass(frozen=True, kw_only=True, slots=True)
class RunRequest:
    """One run that somebody asks for.

    Attributes:
        run_id: unique name: letters, digits, ``_``, ``-`` and ``.``.
        index: number within the campaign, from 0.
        program: Scenic program that the scenario was drawn from, or ''.
        seed: seed of the campaign.
        scenario: initial condition and environment.
        specs: formulas to judge by, as text.
        participants: node names that take part in the lockstep.
        stop_on: what ends the run before its end.
        bounds, rates: what is vouched for of the signals, as text (:mod:`.mtl.assumptions`).
    """

    run_id: str
    index: int
    program: str
    seed: int
    scenario: Scenario
    specs: tuple[str, ...]
    participants: tuple[str, ...]
    stop_on: StopOn = StopOn.NEVER
    bounds: tuple[str, ...] = ()
    rates: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class RunResult:
    """How one run ended.

    Attributes:
        outcome: one of the five.
        kind, who: of an infrastructure error, else ''; a :class:`~taxinet_ros.errors.InfraKind`.
        detail: one line for people.
        last_seq: last control step reached, -1 before the first.
        robustness: of each formula, by name, the headline first; where judged.
        stopped_early: whether it was, see :mod:`.stop_on`.
        statistics: the run in a few figures, where judged.
        perception, fingerprint: which perception took part, and the hash of its weights.
        timing: when its answers took effect, in the words of :mod:`.timing`.
        free: of a free run how it went, see :meth:`.free_run.FreeRunAccount.figures`.
        wall_s: wall-clock time from request to answer [s].
    """

    outcome: Outcome
    kind: str = ''
    who: str = ''
    detail: str = ''
    last_seq: int = -1
    robustness: Mapping[str, RobustnessInterval] = field(default_factory=dict)
    stopped_early: bool = False
    statistics: RunStatistics | None = None
    perception: str = ''
    fingerprint: str = ''
    timing: str = ''
    free: Mapping[str, float] = field(default_factory=dict)
    wall_s: float = 0.0

    @property
    def rho(self) -> Mapping[str, float]:
        """Robustness by formula name, where it is known: not all is, of a run stopped early."""
        return exact_rho(self.robustness)

    @classmethod
    def infra_error(cls, kind: str, who: str, detail: str, last_seq: int) -> Self:
        """The result of a run that a part of the bench broke."""
        return cls(
            outcome=Outcome.INFRA_ERROR, kind=str(kind), who=who, detail=detail, last_seq=last_seq
        )
