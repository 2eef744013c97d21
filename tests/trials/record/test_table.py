"""The table of a campaign and the rates made from it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import HUMAN_KEYS
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.verdict.run_statistics import ErrorStatistics, RunStatistics
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import failure_rate, rate
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS, RunRow
from taxinet_ros.trials.record.table import read_table, table, write_tables

SPECS = ('phi_eventually', 'phi_always')


def run(index: int, outcome: Outcome, *, left: bool = False) -> RunRow:
    request = RunRequest(
        run_id=f'run-{index}', index=index, program='s_falsif', seed=5,
        scenario=Scenario(cross_track_m=1.25, heading_rad=0.1), judging=Judging(specs=SPECS),
        participants=(),
    )
    rho = dict(zip(SPECS, (0.5, -2.5), strict=True)) if outcome.judged else {}
    statistics = RunStatistics(
        max_cross_track_m=30.0 if left else 3.5, settle_time_s=math.nan if left else 4.2,
        cte_error=ErrorStatistics(mean=-0.1, mean_abs=0.2, max_abs=0.3),
        he_error=ErrorStatistics(mean=math.radians(-1), mean_abs=math.radians(2),
                                 max_abs=math.radians(3)),
        unusable_estimates=7,
    )
    result = RunResult(outcome=outcome, robustness=exact_intervals(rho), last_seq=300, wall_s=1.5,
                       statistics=statistics if rho else None, kind='' if rho else 'timeout')
    return RunRow.of_run(request, result, perception='truth', sim_s=30.0, bag=f'run-{index}')


def rejected(index: int) -> RunRow:
    return RunRow(run_id=f'run-{index}', index=index, program='s_falsif', seed=5,
                  perception='truth', outcome=Outcome.REJECTED, detail='no, "never"')


def mixed() -> list[RunRow]:
    return [rejected(2), run(0, Outcome.PASS), run(1, Outcome.INFRA_ERROR),
            run(3, Outcome.FAIL, left=True)]


def write(rows: Sequence[RunRow], folder: Path) -> Path:
    write_tables(rows, folder, {'specs': dict.fromkeys(SPECS, '')})
    return folder


def test_given_rows_when_written_then_both_files_say_the_same(tmp_path: Path) -> None:
    frame = read_table(write(mixed(), tmp_path))
    pd.testing.assert_frame_equal(frame, table(mixed(), SPECS))
    assert list(frame['index']) == [0, 1, 2, 3]
    assert list(frame['outcome']) == ['PASS', 'INFRA_ERROR', 'REJECTED', 'FAIL']
    assert sorted(path.name for path in tmp_path.iterdir()) == ['runs.csv', 'runs.parquet']
    csv = pd.read_csv(tmp_path / 'runs.csv')
    assert list(csv.columns) == list(frame.columns)
    assert csv['rho'][0] == 0.5
    assert csv['detail'][2] == 'no, "never"'
    assert csv['heading_deg'][0] == pytest.approx(math.degrees(0.1))


def test_given_runs_without_verdict_when_in_a_table_then_rho_is_missing_and_not_zero() -> None:
    frame = table(mixed(), SPECS)
    assert list(frame['rho'].isna()) == [False, True, True, False]
    assert list(frame['rho_phi_always'].isna()) == [False, True, True, False]
    assert frame['rho'][0] == frame['rho_phi_eventually'][0] == 0.5
    assert list(frame['left_runway'].isna()) == [False, True, True, False]
    assert frame['left_runway'][3]
    assert math.isnan(frame['cross_track_m'][2])


def test_given_judged_runs_when_in_a_table_then_their_figures_have_units_people_read() -> None:
    frame = table(mixed(), SPECS)
    figures = ['max_cross_track_m', 'settle_time_s', 'cte_error_mean_m', 'cte_error_mean_abs_m',
               'cte_error_max_abs_m', 'he_error_mean_deg', 'he_error_mean_abs_deg',
               'he_error_max_abs_deg', 'unusable_estimates']
    whole = [3.5, 4.2, -0.1, 0.2, 0.3, -1, 2, 3, 7]
    assert frame[figures].iloc[0].tolist() == pytest.approx(whole)
    assert frame['settle_time_s'].isna().tolist() == [False, True, True, True], 'it never settled'
    assert frame[figures].iloc[1].isna().all()


def test_given_claimed_covariances_then_there_are_columns_of_them_and_else_none(tmp_path) -> None:
    rows = sorted(mixed(), key=lambda row: row.index)
    assert not [name for name in table(rows, SPECS).columns if name.startswith('sigma_')]
    sigma = {'cte_max_m': 0.5, 'cte_within_1': 0.7, 'cte_within_2': 1.0}
    frame = read_table(write([dataclasses.replace(rows[0], sigma=sigma), *rows[1:]], tmp_path))
    found = [name for name in frame.columns if name.startswith('sigma_')]
    assert found == ['sigma_cte_max_m', 'sigma_cte_within_1', 'sigma_cte_within_2']
    assert frame[found].iloc[0].tolist() == [0.5, 0.7, 1.0]
    assert frame[found].iloc[1:].isna().all(axis=None)


@pytest.mark.parametrize('rows', [[], [rejected(0)], [run(0, Outcome.INFRA_ERROR)]])
def test_given_few_or_empty_rows_when_in_a_table_then_its_types_are_the_usual(
    rows: list[RunRow], tmp_path: Path,
) -> None:
    usual = table(mixed(), SPECS).dtypes
    assert read_table(write(rows, tmp_path)).dtypes.equals(usual)
    assert table(rows, SPECS).dtypes.equals(usual)


def test_given_a_table_then_it_has_every_scenario_key_and_the_wall_clock_is_last() -> None:
    columns = list(table(mixed()).columns)
    assert set(columns) >= set(HUMAN_KEYS)
    assert tuple(columns[-2:]) == WALL_CLOCK_COLUMNS
    assert table(mixed())['real_time_factor'][0] == 20.0


def test_given_no_table_or_a_damaged_one_when_read_then_one_line_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match='no such table'):
        read_table(tmp_path)
    path = write(mixed(), tmp_path) / 'runs.parquet'
    sound = path.read_bytes()
    for length in range(0, len(sound), len(sound) // 50):
        path.write_bytes(sound[:length])
        with pytest.raises(UsageError) as caught:
            read_table(tmp_path)
        assert str(caught.value).startswith(f'{path}: ')
        assert '\n' not in str(caught.value)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('row', 'column', 'value', 'said'), [
    (0, 'rho_phi_eventually', -1.0, 'PASS, but a robustness is not above 0'),
    (0, 'rho', -1.0, 'PASS, but rho is not above 0'),
    (0, 'outcome', 'FAIL', 'FAIL, but no robustness is 0 or less'),
    (0, 'outcome', 'INFRA_ERROR', 'a robustness without a verdict'),
    (0, 'outcome', 'GREAT', 'an unknown word for outcome'),
    (0, 'run_id', '../../../etc', 'its run_id is not a plain name'),
    (0, 'index', -1, 'its index is negative'),
    (0, 'distance_m', math.inf, 'distance_m is not finite'),
    (0, 'clouds', 'purple', 'an unknown word for clouds'),
    (1, 'run_id', 'run-0', 'its run_id occurs twice'),
    (1, 'index', 0, 'its index occurs twice'),
])
def test_given_a_row_that_cannot_be_then_the_tables_row_is_named(
    tmp_path: Path, row: int, column: str, value: object, said: str
) -> None:
    above = exact_intervals({'phi_eventually': 0.5})
    frame = table([
        dataclasses.replace(run(index, Outcome.PASS), robustness=above) for index in (0, 1)
    ])
    frame.loc[row, column] = value
    if column == 'rho_phi_eventually':
        ends = [f'rho_{end}.phi_eventually' for end in ('lower', 'upper')]
        frame.loc[row, ends] = value
    frame.to_parquet(tmp_path / 'edited.parquet')
    with pytest.raises(UsageError) as caught:
        read_table(tmp_path / 'edited.parquet')
    assert f'edited.parquet: row {row + 1}: {said}' in str(caught.value)


@given(n=st.integers(1, 400), data=st.data())
def test_given_a_count_when_rated_then_the_interval_leaves_the_stated_tails(
    n: int, data: st.DataObject,
) -> None:
    k = data.draw(st.integers(0, n))
    share, low, high = rate(k, n)
    assert 0 <= low <= share <= high <= 1
    # Clopper and Pearson: at its ends the count seen is just as extreme as allowed.
    if k > 0:
        assert binom.sf(k - 1, n, low) == pytest.approx(0.025)
    if k < n:
        assert binom.cdf(k, n, high) == pytest.approx(0.025)


def test_given_published_counts_when_rated_then_the_interval_is_the_textbooks() -> None:
    # "Rule of three" with 95 % two-sided: 0 of 10 gives 0..1 - 0.025**(1/10).
    assert rate(0, 10) == pytest.approx((0, 0, 1 - 0.025**0.1))
    assert rate(10, 10) == pytest.approx((1, 0.025**0.1, 1))
    assert rate(0, 0)[1:] == (0, 1)
    assert math.isnan(rate(0, 0).rate)
    with pytest.raises(ValueError, match='no share'):
        rate(3, 2)


def test_given_a_broken_run_then_it_is_in_no_rate() -> None:
    assert len(rows := [*mixed(), run(4, Outcome.PASS)]) == 5
    assert failure_rate(rows).rate == rate(1, 3)
