"""Comparison of the arms of a confirmation experiment, run by run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from taxinet_ros.analysis.experiment.pairs import (
    PairedRates,
    PairedShift,
    paired_rates,
    paired_shift,
)
from taxinet_ros.analysis.runs.campaign import holm
from taxinet_ros.core.scenario_fields import HUMAN_KEYS
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.trials.experiment import Experiment
from taxinet_ros.trials.record.row import RunRow

Rows = Mapping[str, Sequence[RunRow]]
"""Runs of an experiment by name of their arm."""

_NUMBERS = (
    'time_of_day_h', 'distance_m', 'cross_track_m', 'heading_deg', 'rain_percent',
)
"""Candidate horizontal axes of a picture, in order of preference."""

_SIGNIFICANT = 0.05


@dataclass(frozen=True, kw_only=True)
class ArmComparison:
    """Comparison of an arm with the base arm.

    Attributes:
        base, arm: names of the arms.
        pairs: rows of scenes judged in both arms, base first.
        unpaired: number of the other scenes.
        satisfied: whether runs satisfy the formulas.
        off_runway: whether runs leave the runway, where it is known in both arms.
        rho: robustness of the headline formula [m, or the unit of its predicate].
        max_cross_track_m: greatest |cross-track error| [m].
        settle_time_s: settling time of runs that settle in both arms [s].
        settled: whether runs settle on the centreline, where it is known in both arms.
        satisfied_p, rho_p: p values of these two, adjusted for all arms that the experiment
            compares with its base (Holm); NaN without pairs. The first is the greatest that results
            of scenes without a verdict could leave.
    """

    base: str
    arm: str
    pairs: tuple[tuple[RunRow, RunRow], ...]
    unpaired: int
    satisfied: PairedRates
    off_runway: PairedRates
    rho: PairedShift
    max_cross_track_m: PairedShift
    settle_time_s: PairedShift
    settled: PairedRates
    satisfied_p: float
    rho_p: float

    @property
    def clear(self) -> bool:
        """Whether the rates of satisfied runs differ significantly."""
        return self.satisfied_p < _SIGNIFICANT

    @property
    def rho_clear(self) -> bool:
        """Whether rho differs significantly."""
        return self.rho_p < _SIGNIFICANT


@dataclass(frozen=True, kw_only=True)
class PairedArms:
    """Results of an experiment.

    Attributes:
        experiment: the experiment.
        rows: runs of every arm.
        comparisons: comparison of every other arm with the base arm.
        over: scenario key of the horizontal axis.
        alone: whether it is the only varied key, so that neighbours may be joined by a line.
    """

    experiment: Experiment
    rows: Rows
    comparisons: tuple[ArmComparison, ...]
    over: str
    alone: bool


def paired_arms(experiment: Experiment, rows: Rows) -> PairedArms:
    """Compare the arms of an experiment whose scenes are known to be paired."""
    base = rows[experiment.compare_to]
    varied = varied_keys(base)
    numbers = [key for key in _NUMBERS if key in varied]
    found = [
        compare_arms(experiment.compare_to, base, arm.name, rows[arm.name])
        for arm in experiment.others
    ]
    satisfied, rho = (
        holm([one.satisfied_p for one in found]), holm([one.rho_p for one in found])
    )
    return PairedArms(
        experiment=experiment, rows=rows,
        comparisons=tuple(
            replace(one, satisfied_p=p, rho_p=rho_p)
            for one, p, rho_p in zip(found, satisfied, rho, strict=True)
        ),
        over=experiment.over or next(iter(numbers), 'time_of_day_h'), alone=len(varied) <= 1,
    )


def compare_arms(
    base: str, base_rows: Sequence[RunRow], arm: str, rows: Sequence[RunRow]
) -> ArmComparison:
    """Compare two arms over the scenes judged in both."""
    by_index = {row.index: row for row in rows if row.outcome.judged}
    pairs = tuple(
        (row, by_index[row.index])
        for row in sorted(base_rows, key=lambda row: row.index)
        if row.outcome.judged and row.index in by_index
    )
    numbers = {row.index for row in (*base_rows, *rows)}
    rejected = {row.index for row in (*base_rows, *rows) if row.outcome is Outcome.REJECTED}
    firsts, seconds = [one for one, _ in pairs], [other for _, other in pairs]

    def shift(name: str) -> PairedShift:
        return paired_shift([_number(row, name) for row in firsts],
                            [_number(row, name) for row in seconds])

    satisfied = paired_rates([row.outcome is Outcome.PASS for row in firsts],
                             [row.outcome is Outcome.PASS for row in seconds])
    rho = shift('rho')
    return ArmComparison(
        base=base, arm=arm, pairs=pairs, unpaired=len(numbers) - len(pairs),
        satisfied=satisfied, rho=rho, rho_p=rho.p_value,
        satisfied_p=satisfied.p_at_most(len(numbers - rejected) - len(pairs)),
        off_runway=_known_rates(pairs, lambda row: row.left_runway),
        max_cross_track_m=shift('max_cross_track_m'),
        settle_time_s=shift('settle_time_s'),
        # After an early stop it is not known whether a run would have settled.
        settled=_known_rates(
            pairs, lambda row: None if row.stopped_early else row.settle_time_s is not None,
        ),
    )


def _known_rates(
    pairs: Sequence[tuple[RunRow, RunRow]], result: Callable[[RunRow], bool | None]
) -> PairedRates:
    """Rates of a result over the pairs in which it is known of both runs."""
    found = [(result(one), result(other)) for one, other in pairs]
    known = [(one, other) for one, other in found if one is not None and other is not None]
    return paired_rates([one for one, _ in known], [other for _, other in known])


def varied_keys(rows: Sequence[RunRow]) -> tuple[str, ...]:
    """Scenario keys that differ between runs."""
    drawn = [row for row in rows if row.clouds]
    keys = dict.fromkeys(key for row in drawn for key in row.scene)
    return tuple(key for key in keys if len({row.scene.get(key) for row in drawn}) > 1)


def pairs_frame(found: PairedArms) -> pd.DataFrame:
    """Table with one row per scene: its values in the base arm, and each arm's results."""
    experiment = found.experiment
    names = [experiment.compare_to, *(arm.name for arm in experiment.others)]
    by_arm = {name: {row.index: row for row in found.rows[name]} for name in names}
    indices = sorted({index for rows in by_arm.values() for index in rows})
    return pd.DataFrame([_line(index, names, by_arm) for index in indices]).convert_dtypes()


def rho_of(row: RunRow) -> float:
    """Robustness of the headline formula, NaN if a run has none."""
    return row.headline.lower if row.headline else math.nan


def _line(
    index: int, names: Sequence[str], by_arm: Mapping[str, Mapping[int, RunRow]]
) -> dict[str, object]:
    base = by_arm[names[0]].get(index)
    values: dict[str, object] = {'index': index}
    values |= base.scene if base else dict.fromkeys(HUMAN_KEYS)
    for name in names:
        row = by_arm[name].get(index)
        values |= {
            f'run_{name}': row.run_id if row else None,
            f'outcome_{name}': row.outcome.value if row else None,
            f'rho_{name}': row.headline.lower if row and row.headline else None,
            f'left_runway_{name}': row.left_runway if row else None,
            f'max_cross_track_m_{name}': row.max_cross_track_m if row else None,
            f'settle_time_s_{name}': row.settle_time_s if row else None,
        }
    return values


def _number(row: RunRow, name: str) -> float:
    if name == 'rho':
        return rho_of(row)
    value = getattr(row, name)
    return math.nan if value is None else float(value)
