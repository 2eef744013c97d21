"""The trace of a run: one row per control step, in columns with units.

Steps of a loop and messages of a bag give the same columns, on which formulas can be evaluated
again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taxinet_ros.core.mtl.interval import lower_column, upper_column
from taxinet_ros.core.types import NS_PER_S, UNKNOWN_COVARIANCE, TrackingError
from taxinet_ros.core.verdict.run_statistics import EstimateWatch

if TYPE_CHECKING:
    import pandas as pd

    from taxinet_ros.core.loop import Step

Column = NDArray[np.generic]

STEP_UNITS: Mapping[str, str] = MappingProxyType({
    'x_m': 'm', 'y_m': 'm', 'distance_m': 'm', 'speed_mps': 'm/s', 'cte_m': 'm', 'he_rad': 'rad',
    'est_cte_m': 'm', 'est_he_rad': 'rad', 'steering_rad': 'rad', 'speed_cmd_mps': 'm/s',
})
"""Columns of a control step with units. The position is in ``map``, ``distance_m`` is that along
the track; ``cte_m`` and ``he_rad`` are the truth, ``est_`` the perception's estimate,
``steering_rad`` and ``speed_cmd_mps`` the command. Signs are defined in
:mod:`taxinet_ros.core.types`."""

SIGMA_COLUMNS: Mapping[str, Callable[[TrackingError], float]] = MappingProxyType({
    'est_cte_sigma_m': lambda estimate: estimate.cte_sigma_m,
    'est_he_sigma_rad': lambda estimate: estimate.he_sigma_rad,
})
"""Standard deviations that an estimate claims [m, rad], where some do."""

CLEARANCE_COLUMN = 'clearance_m'
"""Distance to others on the ground, where there are any."""
HOLD_COLUMN = 'hold_distance_m'
"""Way to the nearest hold line that is not cleared, where there are any lines."""

COLUMN_UNITS: Mapping[str, str] = MappingProxyType({
    't_s': 's', 't_ns': 'ns', **STEP_UNITS, CLEARANCE_COLUMN: 'm', HOLD_COLUMN: 'm',
    'est_cte_sigma_m': 'm', 'est_he_sigma_rad': 'rad',
})
"""Unit of every column that has one."""

SIGNAL_COLUMNS: Mapping[str, str] = MappingProxyType({
    'cte': 'cte_m', 'he': 'he_rad', 'speed': 'speed_mps', 'x': 'distance_m',
    'steering': 'steering_rad', 'cte_estimate': 'est_cte_m',
    'he_estimate': 'est_he_rad', 'cte_sigma': 'est_cte_sigma_m', 'he_sigma': 'est_he_sigma_rad',
    'clearance': CLEARANCE_COLUMN, 'hold_distance': HOLD_COLUMN,
})
"""Column of each signal of :data:`.mtl.specs.SIGNALS` that does not depend on earlier frames."""

def source_column(signal: str, columns: Container[str]) -> str:
    """Column of a trace that gives a signal of :data:`.mtl.specs.SIGNALS`, or ''."""
    column = SIGNAL_COLUMNS.get('clearance' if signal == 'collision' else signal, '')
    if signal == 'x' and column not in columns:
        column = 'x_m'  # An older version's, whose track was always the runway's centreline.
    return column if column in columns else ''


_OF_STEP: Mapping[str, Callable[[Step], float]] = {
    'x_m': lambda step: step.observation.state.x_m,
    'y_m': lambda step: step.observation.state.y_m,
    'distance_m': lambda step: step.observation.on_track.distance_m,
    'speed_mps': lambda step: step.observation.state.speed_mps,
    'cte_m': lambda step: step.observation.truth.cte_m,
    'he_rad': lambda step: step.observation.truth.he_rad,
    'est_cte_m': lambda step: step.estimate.cte_m if step.estimate.usable else math.nan,
    'est_he_rad': lambda step: step.estimate.he_rad if step.estimate.usable else math.nan,
    'steering_rad': lambda step: step.command.steering_rad,
    'speed_cmd_mps': lambda step: step.command.speed_mps,
}


def columns_of_steps(
    steps: Sequence[Step], specs: Sequence[str], *, others: bool = False, holds: bool = False
) -> dict[str, Column]:
    """Columns of a run, one row per step.

    Args:
        steps: steps of the run, in order.
        specs: names of the formulas, in the order of each step's readings.
        others: whether others are on the ground.
        holds: whether there are hold lines.

    Returns:
        ``seq`` and ``t_ns`` (simulated time) as int64, ``est_valid`` as bool (whether the
        estimate was usable, as in formulas), the columns of :data:`STEP_UNITS` as float64 (NaN
        where it was not), with others :data:`CLEARANCE_COLUMN`, with hold lines
        :data:`HOLD_COLUMN`, with a covariance :data:`SIGMA_COLUMNS`, and for each formula
        ``rho_lower.<name>`` and ``rho_upper.<name>``.
    """
    columns: dict[str, Column] = {
        'seq': np.array([step.observation.seq for step in steps], dtype=np.int64),
        't_ns': np.array([step.observation.stamp_ns for step in steps], dtype=np.int64),
        'est_valid': np.array([step.estimate.usable for step in steps], dtype=np.bool_),
    }
    for name, value in _OF_STEP.items():
        columns[name] = np.array([value(step) for step in steps], dtype=np.float64)
    if others:
        columns[CLEARANCE_COLUMN] = np.array([step.clearance_m for step in steps], np.float64)
    if holds:
        columns[HOLD_COLUMN] = np.array([step.hold_distance_m for step in steps], np.float64)
    if any(step.estimate.covariance != UNKNOWN_COVARIANCE for step in steps):
        for name, sigma in SIGMA_COLUMNS.items():
            columns[name] = np.array([sigma(step.estimate) for step in steps], np.float64)
    for number, spec in enumerate(specs):
        readings = [step.readings[number] for step in steps]
        columns[lower_column(spec)] = np.array([one.lower for one in readings], dtype=np.float64)
        columns[upper_column(spec)] = np.array([one.upper for one in readings], dtype=np.float64)
    return columns


def trace_table(columns: Mapping[str, Column]) -> pd.DataFrame:
    """Convert a trace to a table, ``t_s`` [s] first; units are in ``attrs['units']``."""
    import pandas as pd

    table = pd.DataFrame({'t_s': np.asarray(columns['t_ns'], np.int64) / NS_PER_S, **columns})
    table.attrs['units'] = {
        name: COLUMN_UNITS[name] for name in table.columns if name in COLUMN_UNITS
    }
    return table


def trace_signals(
    stamps_ns: NDArray[np.int64], columns: Mapping[str, ArrayLike]
) -> dict[str, Column]:
    """Signals of a trace, for the evaluation of formulas.

    Args:
        stamps_ns: (n,) simulated time of each row [ns].
        columns: (n,) each, by name; a missing column has no signal.

    Returns:
        (n,) float64 for each signal. With the estimates, this includes the two signals that depend
        on earlier frames (:class:`.run_statistics.EstimateWatch`), assuming that the rows are a
        whole run with a constant period.
    """
    signals: dict[str, Column] = {
        name: np.asarray(columns[column], dtype=np.float64)
        for name in SIGNAL_COLUMNS if (column := source_column(name, columns))
    }
    if 'clearance' in signals:
        clearance_m = np.asarray(signals['clearance'], np.float64)
        signals['collision'] = np.where(np.isnan(clearance_m), np.nan, clearance_m <= 0)
    if 'cte_estimate' in signals and 'he_estimate' in signals and len(stamps_ns):
        period_ns = int(stamps_ns[1] - stamps_ns[0]) if len(stamps_ns) > 1 else NS_PER_S
        watch = EstimateWatch(int(stamps_ns[-1] - stamps_ns[0]), max(period_ns, 1))
        estimates = zip(signals['cte_estimate'], signals['he_estimate'], strict=True)
        watched = [
            watch.signals(int(stamp_ns), {'cte_estimate': cte_m, 'he_estimate': he_rad})
            for stamp_ns, (cte_m, he_rad) in zip(stamps_ns, estimates, strict=True)
        ]
        for name in EstimateWatch.NAMES:
            signals[name] = np.array([sample[name] for sample in watched], dtype=np.float64)
    return signals
