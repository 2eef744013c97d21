"""Request and result of a run; a result has exactly one of five outcomes.

Only the first two outcomes carry a robustness.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol, Self

from taxinet_ros.core.judging import Judging
from taxinet_ros.core.mtl import RobustnessInterval, exact_rho
from taxinet_ros.core.run_statistics import RunStatistics
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.topics import MTL_MONITOR
from taxinet_ros.errors import InfraKind


class Outcome(enum.StrEnum):
    """Outcome of a run; separates violated specifications from failures of the test bench."""

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
    """Result of judging a run: a :class:`.judge.Judgement`, or its message."""

    @property
    def complete(self) -> bool:
        """Whether the run reached its horizon and could be judged."""

    @property
    def stopped_early(self) -> bool:
        """Whether it was stopped before its horizon because its verdict was decided."""

    @property
    def satisfied(self) -> bool:
        """Whether every formula has robustness > 0."""


def outcome_of(judgement: Judged) -> Outcome:
    """PASS or FAIL; INFRA_ERROR where there was no whole, finite sequence of samples to judge."""
    if not (judgement.complete or judgement.stopped_early):
        return Outcome.INFRA_ERROR
    return Outcome.PASS if judgement.satisfied else Outcome.FAIL


NOT_JUDGED: Mapping[str, str] = MappingProxyType({
    'kind': InfraKind.INVALID_RUN, 'who': MTL_MONITOR,
    'detail': 'the monitor had no whole, finite sequence of samples to judge',
})
"""Detail of a run that reached its end but could not be judged."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RunRequest:
    """Request of one run.

    Attributes:
        run_id: unique name: letters, digits, ``_``, ``-`` and ``.``.
        index: number within the campaign, from 0.
        program: Scenic program that the scenario was drawn from, or ''.
        seed: seed of the campaign.
        scenario: initial condition and environment.
        judging: what decides its verdict.
        participants: node names that take part in the lockstep.
    """

    run_id: str
    index: int
    program: str
    seed: int
    scenario: Scenario
    judging: Judging
    participants: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class RunResult:
    """How one run ended.

    Attributes:
        outcome: one of the five.
        kind, who: of an infrastructure error, else ''; a :class:`~taxinet_ros.errors.InfraKind`.
        detail: one line for people.
        last_seq: last control step reached, -1 before the first.
        robustness: of each formula, by name, the headline first; where judged.
        stopped_early: whether it was, see :mod:`.judging`.
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
