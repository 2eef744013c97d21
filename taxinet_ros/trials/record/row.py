"""One run as a table row: request and result, in display units; names and types of the columns.

Every column has the same type in every table, even if all its values are missing, so tables of
several campaigns can be concatenated.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from taxinet_ros.bag.layout import is_bag_name, is_run_name
from taxinet_ros.core.mtl import RobustnessInterval, exact_rho
from taxinet_ros.core.mtl.interval import lower_column, upper_column
from taxinet_ros.core.mtl.specs import MOST_UNUSABLE_SHARE
from taxinet_ros.core.pacing.timing import parse_timing
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CATALOGUES,
    CONTROL_RATE,
    SCENARIO_FIELDS,
    is_point,
)
from taxinet_ros.core.signals import checked_signals
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.verdict.examined import decisive
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import UsageError

POINT = 'u_'
"""Prefix of the column of a dimension of the search space."""
PREFIXES = {'point': POINT, 'free': 'free_', 'sigma': 'sigma_', 'signals': ''}
"""Prefixes of the columns of a row's mappings; a table has those that some row has."""

RHO = 'rho'
"""Column that repeats the headline's robustness."""

_RHO = 'rho_'

REAL_TIME_FACTOR = 'real_time_factor'
WALL_CLOCK_COLUMNS = ('wall_s', REAL_TIME_FACTOR)
"""The last columns; all others are equal if the campaign is repeated."""

_BEFORE_POINT = {
    'run_id': 'string', 'index': 'int64', 'program': 'string', 'seed': 'int64',
    'sampler': 'string', 'refused': 'Int64', 'weight': 'float64', 'drawn': 'boolean',
}
_BEFORE_RHO = {
    'perception': 'string', 'perception_fingerprint': 'string', 'timing': 'string',
    **{field.key: field.column_type for field in SCENARIO_FIELDS},
    'outcome': 'string', 'kind': 'string', 'who': 'string', 'detail': 'string',
}
_AFTER_RHO = {
    'stopped_early': 'boolean', 'stopped_s': 'float64',
    'left_runway': 'boolean', 'max_cross_track_m': 'float64', 'settle_time_s': 'float64',
    'cte_error_mean_m': 'float64', 'cte_error_mean_abs_m': 'float64',
    'cte_error_max_abs_m': 'float64', 'he_error_mean_deg': 'float64',
    'he_error_mean_abs_deg': 'float64', 'he_error_max_abs_deg': 'float64',
    'unusable_estimates': 'Int64', 'steps': 'int64', 'sim_s': 'float64',
    'retries': 'int64', 'bag': 'string', 'stack': 'string', 'wall_s': 'float64',
    REAL_TIME_FACTOR: 'float64',
}

PLAIN_COLUMNS = {**_BEFORE_POINT, **_BEFORE_RHO, **_AFTER_RHO}
"""Type of each column that has one value of a row, without robustness, point and free figures."""

LONGER = {'fingerprint': 'perception_fingerprint'}
"""Columns with a longer name than a row's attribute."""

ATTRIBUTES = {column: name for name, column in LONGER.items()}
"""Names of row attributes that are shorter than their column."""


def rho_column(spec: str) -> str:
    """Column of a formula's robustness; empty if a run was stopped before it was known."""
    return _RHO + spec


def specs_of(columns: Iterable[object]) -> list[str]:
    """Names of the formulas that a table has a robustness of, headline first."""
    # Formula names have no dot, which distinguishes them from interval ends.
    return [
        str(name).removeprefix(_RHO) for name in columns
        if str(name).startswith(_RHO) and '.' not in str(name)
    ]


def column_types(
    specs: Sequence[str], columns: Iterable[str]
) -> dict[str, str]:
    """Type of each column of a table, in its order.

    Args:
        specs: names of the formulas, headline first.
        columns: names of the table's columns; of these, those with one of :data:`PREFIXES` and
            those of control points count.
    """
    point, *figures = (
        {name: 'float64' for name in columns if name.startswith(start)}
        for start in PREFIXES.values() if start
    )
    figures.insert(0, {name: BY_KEY[name].column_type for name in columns if is_point(name)})
    return {
        **_BEFORE_POINT, **point,
        **_BEFORE_RHO, RHO: 'float64',
        **{
            column(name): 'float64'
            for column in (rho_column, lower_column, upper_column) for name in specs
        },
        **{name: kind for one in figures for name, kind in one.items()}, **_AFTER_RHO,
    }


SIMPLY_DRAWN = ('', 'random')
"""Samplers whose runs are all independent draws from the program; '' means no sampler."""


_KINDS: Mapping[str, tuple[str, Any]] = {
    'string': ('str', ''), 'boolean': ('bool | None', None), 'float64': ('float | None', None),
}
_SceneColumns: Any = dataclasses.make_dataclass('_SceneColumns', [
    (known.key, kind, field(default=default)) for known in SCENARIO_FIELDS
    for kind, default in [_KINDS[known.column_type]]
], frozen=True, kw_only=True, slots=True)


@dataclass(frozen=True, kw_only=True, slots=True)
class RunRow(_SceneColumns):
    """One run of a campaign. Values that a run does not have are None, or '' for words.

    The scenario's values are attributes by key (:mod:`taxinet_ros.core.scenario_fields`), None or
    '' if no scene could be drawn.

    Attributes:
        run_id: unique name.
        index: number within the campaign, from 0.
        program: program from which the scenario was drawn.
        seed: with which it was drawn.
        sampler: name of the sampler that chose the scene, or '' if there was none.
        point: the quantile of each active dimension, by name.
        refused: draws or sampler points that the program's requirements rejected before this scene.
        weight: density of the program's distribution over that of the sampler's, if known.
        drawn: whether the scene was drawn from the program itself, independently of earlier
            results; rates are estimated from these. None in rows older than this column.
        perception: the swap word.
        fingerprint: hash of the weights; in tables ``perception_fingerprint``.
        timing: when answers took effect, as text of :mod:`taxinet_ros.core.pacing.timing`; '' if
            each did at once. A free run is not reproducible.
        free: figures of a free run by name, see
            :meth:`taxinet_ros.core.pacing.free_run.FreeRunAccount.figures`.
        signals: its control points by key, see :mod:`taxinet_ros.core.signals`.
        outcome: how the run ended.
        kind, who, detail: why a run was not judged: kind of error, what failed, and one line.
        robustness: robustness by name of the formula, the headline first; judged runs only. Rho is
            exact unless the run was stopped early.
        stopped_early, stopped_s: whether the run was stopped when its verdict was decided, and when
            [s]; judged runs only. Its figures then cover the time until the stop.
        left_runway, max_cross_track_m, settle_time_s: figures of the true path, see
            :class:`~taxinet_ros.core.verdict.run_statistics.RunStatistics`; judged runs only. After
            an early stop it is unknown whether the run would have left the runway or settled later.
        cte_error_mean_m, cte_error_mean_abs_m, cte_error_max_abs_m, he_error_mean_deg,
            he_error_mean_abs_deg, he_error_max_abs_deg: estimate minus truth; judged runs only.
        unusable_estimates: frames without an estimate; judged runs only.
        sigma: figures of the covariances that estimates claimed, by name: greatest standard
            deviation, and share of the errors within 1 and 2 of them; none without covariances.
        steps: number of control steps.
        sim_s: simulated time that passed [s].
        retries: number of retries after infrastructure errors.
        bag: the run's bag, relative to the campaign's folder; its path if a standing graph has
            recorded it elsewhere; or ''.
        stack: name of the machine, libraries and code of the run among the campaign's ``stacks``,
            or ''.
        wall_s: wall-clock duration of the run [s].
    """

    run_id: str
    index: int
    program: str
    seed: int
    perception: str
    outcome: Outcome
    sampler: str = ''
    point: Mapping[str, float] = field(default_factory=dict)
    refused: int = 0
    weight: float | None = None
    drawn: bool | None = None
    fingerprint: str = ''
    timing: str = ''
    free: Mapping[str, float] = field(default_factory=dict)
    signals: Mapping[str, float | str] = field(default_factory=dict)
    kind: str = ''
    who: str = ''
    detail: str = ''
    robustness: Mapping[str, RobustnessInterval] = field(default_factory=dict)
    stopped_early: bool | None = None
    stopped_s: float | None = None
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
    sigma: Mapping[str, float] = field(default_factory=dict)
    steps: int = 0
    sim_s: float = 0.0
    retries: int = 0
    bag: str = ''
    stack: str = ''
    wall_s: float = 0.0

    def __post_init__(self) -> None:
        if bool(self.robustness) != self.outcome.judged:
            raise ValueError(f'run {self.run_id}: {self.outcome} with rho {dict(self.robustness)}')
        if not self.stopped_early and len(self.rho) < len(self.robustness):
            raise ValueError(f'run {self.run_id}: has intervals {dict(self.robustness)}')

    def check(self) -> None:
        """Check that the row is consistent as the result of a run.

        Raises:
            ValueError: its robustness contradicts its outcome, its name could lead out of the
                campaign's folder, a number is not finite, or a word is unknown.
        """
        if not is_run_name(self.run_id):
            raise ValueError(f'run_id is {self.run_id!r:.80}, not a plain name')
        if self.index < 0:
            raise ValueError(f'index is {self.index}')
        if self.bag and not is_bag_name(self.bag):
            raise ValueError(f'bag is {self.bag!r:.80}, not a plain name')
        self._check_words()
        for name in _NAMES:
            value = getattr(self, name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f'{LONGER.get(name, name)} is {value}')
        try:
            parse_timing(self.timing)
        except UsageError as error:
            raise ValueError(str(error)) from error
        for figures in (self.free, self.sigma):
            if not all(map(math.isfinite, figures.values())):
                raise ValueError(f'a figure is no number: {dict(figures)}')
        self._check_robustness()

    def _check_words(self) -> None:
        for known in SCENARIO_FIELDS:
            value = getattr(self, known.key)
            if known.words and value and value not in known.words:
                raise ValueError(
                    f'{known.key} is {value!r:.40}, not one of {", ".join(known.words)}'
                )
        try:
            if self.signals:
                checked_signals(self.signals, self.duration_s or 0.0)
        except UsageError as error:
            raise ValueError(str(error)) from error
        for key, catalogue in CATALOGUES.items():
            value = getattr(self, key)
            if value and not catalogue.is_reference(value):
                raise ValueError(f'{key} is {value!r:.80}, no reference of one')

    def _check_robustness(self) -> None:
        """PASS: every formula is above zero. FAIL: at least one is not."""
        known = self.robustness.values()
        passed = all(interval.satisfied for interval in known)
        failed = any(interval.failed for interval in known)
        if (self.outcome is Outcome.PASS and not passed) or (
            self.outcome is Outcome.FAIL and not failed
        ):
            raise ValueError(
                f'run {self.run_id}: {self.outcome} with robustness {dict(self.robustness)}'
            )

    @property
    def scene(self) -> dict[str, Any]:
        """The scenario by key, in human units; None, or '' for words, if none could be drawn."""
        return {
            **{known.key: getattr(self, known.key) for known in SCENARIO_FIELDS}, **self.signals,
        }

    @property
    def period_ns(self) -> int:
        """Control period of the run [ns]; the usual one if no scene could be drawn."""
        return int(NS_PER_S // (self.control_rate_hz or CONTROL_RATE.absent))

    @property
    def unusable_share(self) -> float:
        """Share of the run's frames without a usable estimate; 0 if not counted."""
        return (self.unusable_estimates or 0) / self.steps if self.steps else 0.0

    @property
    def passed_blind(self) -> bool:
        """Whether the run passed although too many frames had no estimate, by ``usable``."""
        return self.outcome is Outcome.PASS and self.unusable_share > MOST_UNUSABLE_SHARE

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per wall-clock second; NaN if no time was spent."""
        return self.sim_s / self.wall_s if self.wall_s > 0 else math.nan

    @property
    def rho(self) -> Mapping[str, float]:
        """Known robustness values by name of the formula."""
        return exact_rho(self.robustness)

    def also_judged(self, spec: str, interval: RobustnessInterval) -> Self:
        """The row with the robustness of one more formula, evaluated after the run.

        Raises:
            ValueError: the run was not judged, or was complete but has only an interval.
        """
        if not self.outcome.judged or not (interval.exact or self.stopped_early):
            raise ValueError(f'run {self.run_id}: {self.outcome} with {spec} {interval}')
        return dataclasses.replace(self, robustness={**self.robustness, spec: interval})

    def robustness_for_sampler(self, spec: str) -> float | None:
        """Robustness of a formula for the sampler, or None if its sign is unknown.

        For a run that was stopped early it is the bound nearer to zero. Its sign is correct, which
        suffices for samplers that only distinguish failures; those that use its magnitude treat the
        run as less decisive than it was.
        """
        interval = self.robustness.get(spec)
        return interval.nearest_to_zero if interval else None

    @property
    def from_program(self) -> bool:
        """Whether the program itself drew the scene; if not recorded, inferred from the sampler.

        Points of Halton, Sobol and the grid are not independent draws.
        """
        return self.drawn if self.drawn is not None else self.sampler in SIMPLY_DRAWN

    @property
    def headline(self) -> RobustnessInterval | None:
        """The robustness of the first formula."""
        return next(iter(self.robustness.values()), None)

    @property
    def decisive(self) -> str:
        """The formula that a judged run is shown by: the headline unless only another failed."""
        return decisive(self.robustness)

    @property
    def shown(self) -> RobustnessInterval:
        """The robustness of that formula."""
        return self.robustness[self.decisive]

    def about(self, spec: str) -> Self:
        """The judged row with another of its formulas as the headline, before the others."""
        return dataclasses.replace(
            self, robustness={spec: self.robustness[spec], **self.robustness})

    @classmethod
    def of_run(
        cls, request: RunRequest, result: RunResult, *, perception: str, sim_s: float,
        bag: str = '', stack: str = '',
    ) -> Self:
        """The row of a run that had a scenario.

        Args:
            request: request of the run.
            result: result of the run.
            perception: the requested perception; the result has none after an infrastructure error.
            sim_s: simulated time that passed [s].
            bag: see :class:`RunRow`.
            stack: name of the machine record, or ''.
        """
        return cls(
            run_id=request.run_id, index=request.index, program=request.program, seed=request.seed,
            perception=perception, fingerprint=result.fingerprint,
            timing=result.timing, free=dict(result.free),
            **scene_attributes(request.scenario),
            outcome=result.outcome, kind=result.kind, who=result.who, detail=result.detail,
            robustness=dict(result.robustness), **_figures(result, sim_s),
            steps=result.last_seq + 1, sim_s=sim_s, bag=bag, stack=stack,
            wall_s=result.wall_s,
        )

    def with_choice(
        self, *, sampler: str, point: Mapping[str, float], weight: float | None, retries: int,
        refused: int = 0, drawn: bool | None = None,
    ) -> Self:
        """The row with how its scene was chosen, and its number of retries."""
        return dataclasses.replace(
            self, sampler=sampler, point=point, weight=weight, refused=refused, retries=retries,
            drawn=drawn,
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values for the record, without defaults; the inverse of :meth:`from_json`."""
        return {
            name: value for name in _NAMES
            if (value := getattr(self, name)) != DEFAULTS.get(name, _NOTHING)
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Read the output of :meth:`to_json`.

        Raises:
            KeyError, TypeError, ValueError: a value is missing, unknown or inconsistent
                (:meth:`check`).
        """
        robustness = {
            spec: RobustnessInterval(*ends) for spec, ends in values.get('robustness', {}).items()
        }
        row = cls(**{**values, 'outcome': Outcome(values['outcome']), 'robustness': robustness})
        row.check()
        return row


def scene_attributes(scenario: Scenario) -> dict[str, Any]:
    """A scenario as attributes of a row."""
    values = scenario.to_human()
    signals = {name: values.pop(name) for name in scenario.points}
    return {**values, 'signals': signals}


_NOTHING = object()
_NAMES = tuple(column.name for column in dataclasses.fields(RunRow))
DEFAULTS: dict[str, Any] = {
    column.name: {} if column.default is dataclasses.MISSING else column.default
    for column in dataclasses.fields(RunRow)
    if column.default is not dataclasses.MISSING
    or column.default_factory is not dataclasses.MISSING
}
"""What a row has of each attribute that its entry leaves out."""

NEEDED = tuple(name for name in _NAMES if name not in DEFAULTS)
"""Attributes that every entry has."""


def path_figures(result: RunResult) -> dict[str, Any]:
    """Columns of the true path, see :class:`RunRow`; none unless the run was judged."""
    statistics, stopped = result.statistics, result.stopped_early
    if statistics is None:
        return {}
    return {
        'left_runway': statistics.left_runway or (None if stopped else False),
        'max_cross_track_m': statistics.max_cross_track_m,
        'settle_time_s': None if stopped else _known(statistics.settle_time_s),
    }


def _figures(result: RunResult, sim_s: float) -> dict[str, Any]:
    """Columns from a judged run's figures; missing ones are None, never NaN."""
    statistics, stopped = result.statistics, result.stopped_early
    if statistics is None:
        return {}
    cte, he = statistics.cte_error, statistics.he_error
    return {
        'stopped_early': stopped,
        'stopped_s': sim_s if stopped else None,
        **path_figures(result),
        'cte_error_mean_m': _known(cte.mean),
        'cte_error_mean_abs_m': _known(cte.mean_abs),
        'cte_error_max_abs_m': _known(cte.max_abs),
        'he_error_mean_deg': _known(_degrees(he.mean)),
        'he_error_mean_abs_deg': _known(_degrees(he.mean_abs)),
        'he_error_max_abs_deg': _known(_degrees(he.max_abs)),
        'unusable_estimates': statistics.unusable_estimates,
        'sigma': {
            name: value for name, value in (
                ('cte_max_m', cte.sigma_max),
                ('cte_within_1', cte.within_1_sigma), ('cte_within_2', cte.within_2_sigma),
                ('he_max_deg', math.degrees(he.sigma_max)),
                ('he_within_1', he.within_1_sigma), ('he_within_2', he.within_2_sigma),
            ) if not math.isnan(value)
        },
    }


def _degrees(angle_rad: float) -> float:
    """An angle in degrees; a very large estimate may overflow."""
    most = sys.float_info.max
    return max(-most, min(math.degrees(angle_rad), most))


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
