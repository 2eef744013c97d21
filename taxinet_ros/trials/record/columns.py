"""Names and types of the columns of a campaign's table.

Every column has the same type in every table, even if all its values are missing, so tables of
several campaigns can be concatenated.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from taxinet_ros.core.mtl.interval import lower_column, upper_column
from taxinet_ros.core.scenario_fields import BY_KEY, SCENARIO_FIELDS, is_point

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
