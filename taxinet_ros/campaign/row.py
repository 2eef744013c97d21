"""One run as one row: what was asked, how it ended, in the units people read."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.run_statistics import RunStatistics


@dataclass(frozen=True, kw_only=True, slots=True)
class RunRow:
    """One run of a campaign. Values that a run does not have are None, or '' for words.

    Attributes:
        run_id, index: unique name, and number within the campaign from 0.
        program, seed: what the scenario was drawn from.
        sampler: word of the sampler that chose the scene, or '' where it was simply drawn.
        point: the quantile that it chose for each dimension, by name.
        weight: density of the program's distribution over that of the sampler's, if known.
        perception, perception_fingerprint: the swap word, and the hash of the weights.
        cross_track, distance, heading, clouds, rain, time_of_day, date, shadows, aircraft,
            duration: the scenario in human units (m left, m, degrees nose left, word, percent, h,
            ISO date, switch, word, s); None if no scene could be drawn.
        outcome, kind, who, detail: how it ended; the next three explain an unjudged run.
        rho: robustness by the formula's name, the headline first; judged runs only.
        left_runway, max_cross_track_m, settle_time_s: of the true path, see
            :class:`~taxinet_ros.core.run_statistics.RunStatistics`; judged runs only.
        cte_error_mean_m, cte_error_mean_abs_m, cte_error_max_abs_m, he_error_mean_deg,
            he_error_mean_abs_deg, he_error_max_abs_deg: estimate minus truth; judged runs only.
        unusable_estimates: frames without an estimate; judged runs only.
        steps: control steps that were run.
        sim_s: simulated time that passed [s].
        retries: how often the run was begun anew because the bench broke.
        bag: the run's bag, relative to the campaign's folder, or ''.
        wall_s: wall-clock time that the run took [s].
    """

    run_id: str
    index: int
    program: str
    seed: int
    perception: str
    outcome: Outcome
    sampler: str = ''
    point: Mapping[str, float] = field(default_factory=dict)
    weight: float | None = None
    perception_fingerprint: str = ''
    cross_track: float | None = None
    distance: float | None = None
    heading: float | None = None
    clouds: str = ''
    rain: float | None = None
    time_of_day: float | None = None
    date: str = ''
    shadows: bool | None = None
    aircraft: str = ''
    duration: float | None = None
    kind: str = ''
    who: str = ''
    detail: str = ''
    rho: Mapping[str, float] = field(default_factory=dict)
    left_runway: bool | None = None
    max_cross_track_m: float | None = None
    settle_time_s: float | None = None
    cte_error_mean_m: float | None = None
    cte_error_mean_abs_m: float | None = None
    cte_error_max_abs_m: float | None = None
    he_error_mean_deg: float | None = None
    he_error_mean_abs_deg: float | None = None
    he_error_max_abs_deg: float | None = None
    unusable_estimates: int | None = None
    steps: int = 0
    sim_s: float = 0.0
    retries: int = 0
    bag: str = ''
    wall_s: float = 0.0

    def __post_init__(self) -> None:
        if bool(self.rho) != self.outcome.judged:
            raise ValueError(f'run {self.run_id}: {self.outcome} with rho {dict(self.rho)}')

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per second of wall clock; NaN where none was spent."""
        return self.sim_s / self.wall_s if self.wall_s > 0 else math.nan

    @classmethod
    def of_run(
        cls, request: RunRequest, result: RunResult, *, perception: str, sim_s: float, bag: str = ''
    ) -> Self:
        """The row of a run that had a scenario.

        Args:
            request: what was asked.
            result: how it ended.
            perception: the word that was asked for; the result has none if the bench broke.
            sim_s: simulated time that passed [s].
            bag: path of the bag relative to the campaign's folder, or ''.
        """
        return cls(
            run_id=request.run_id, index=request.index, program=request.program, seed=request.seed,
            perception=perception, perception_fingerprint=result.fingerprint,
            **request.scenario.to_human(),
            outcome=result.outcome, kind=result.kind, who=result.who, detail=result.detail,
            rho=dict(result.rho), **_figures(result.statistics),
            steps=result.last_seq + 1, sim_s=sim_s, bag=bag, wall_s=result.wall_s,
        )

    def chosen(
        self, *, sampler: str, point: Mapping[str, float], weight: float | None, retries: int
    ) -> Self:
        """The row with how its scene was chosen, and how often it was begun anew."""
        return dataclasses.replace(
            self, sampler=sampler, point=point, weight=weight, retries=retries
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values for one line of the ledger; the inverse of :meth:`from_json`."""
        return {**dataclasses.asdict(self), 'outcome': self.outcome.value}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Read back what :meth:`to_json` gave.

        Raises:
            UsageError: a column is missing or unknown, or the outcome is none of the five.
        """
        try:
            return cls(**{**values, 'outcome': Outcome(values['outcome'])})
        except (KeyError, TypeError, ValueError) as error:
            raise UsageError(f'not a row of this version: {error}') from error


def _figures(statistics: RunStatistics | None) -> dict[str, Any]:
    """The columns made of a judged run's figures; what it does not have is None, never NaN."""
    if statistics is None:
        return {}
    cte, he = statistics.cte_error, statistics.he_error
    return {
        'left_runway': statistics.left_runway,
        'max_cross_track_m': statistics.max_cross_track_m,
        'settle_time_s': _known(statistics.settle_time_s),
        'cte_error_mean_m': _known(cte.mean),
        'cte_error_mean_abs_m': _known(cte.mean_abs),
        'cte_error_max_abs_m': _known(cte.max_abs),
        'he_error_mean_deg': _known(math.degrees(he.mean)),
        'he_error_mean_abs_deg': _known(math.degrees(he.mean_abs)),
        'he_error_max_abs_deg': _known(math.degrees(he.max_abs)),
        'unusable_estimates': statistics.unusable_estimates,
    }


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
