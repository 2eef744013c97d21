"""Request and result of a run; a result has exactly one of five outcomes.

Only the first two outcomes carry a robustness.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Protocol, Self

from taxinet_ros.core.mtl import RobustnessInterval, exact_rho
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.topics import MTL_MONITOR
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.run_statistics import RunStatistics
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
        """Whether the run has a verdict: it was complete, or stopped once that was decided."""
        return self in (Outcome.PASS, Outcome.FAIL)


OPEN = Outcome.INFRA_ERROR, Outcome.INTERRUPTED
"""Outcomes of runs whose scene is valid and of which a verdict may still come."""


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
    """PASS or FAIL; INFRA_ERROR if the sequence of samples was not complete and finite."""
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
        judging: requirements, stop rule and assumptions.
        participants: names of the nodes in the lockstep.
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
    """Result of a run.

    Attributes:
        outcome: one of the five.
        kind, who: kind (:class:`~taxinet_ros.errors.InfraKind`) and origin of an infrastructure
            error, else ''.
        detail: one-line explanation.
        last_seq: last control step reached, -1 before the first.
        robustness: by formula name, the headline first; empty unless judged.
        stopped_early: whether the run ended before its horizon, see :mod:`.judging`.
        statistics: summary statistics; None unless judged.
        perception, fingerprint: name of the perception, and hash of its weights.
        timing: when answers took effect, in the notation of :mod:`.timing`.
        free: statistics of a free run, see :meth:`.free_run.FreeRunAccount.figures`.
        seen: plain values of an observer, if the request names one.
        wall_s: wall-clock time from request to result [s].
        stack: identifier of the record (:func:`.provenance.stack_id`) of the machine that made the
            run; '' for this one.
        bags: folder in which a recorder said that it writes; '' if none did.
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
    seen: Mapping[str, Any] = field(default_factory=dict)
    wall_s: float = 0.0
    stack: str = ''
    bags: str = ''

    @property
    def rho(self) -> Mapping[str, float]:
        """Exactly known robustness by formula name; a run stopped early may lack some."""
        return exact_rho(self.robustness)

    @classmethod
    def infra_error(cls, kind: str, who: str, detail: str, last_seq: int) -> Self:
        """Result of a run that failed because of the test bench."""
        return cls(
            outcome=Outcome.INFRA_ERROR, kind=str(kind), who=who, detail=detail, last_seq=last_seq
        )
