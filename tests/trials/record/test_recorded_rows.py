"""Rows of a large campaign: their columns equal those of single rows, which are made when asked."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.trials.record import content as module
from taxinet_ros.trials.record.content import ROW, RecordedRows, StoredRows, run_key, values_of
from taxinet_ros.trials.record.facts import STACKS
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import (
    CSV_NAME,
    PARQUET_NAME,
    csv_text,
    table,
    write_tables,
)

FINITE = st.floats(allow_nan=False, allow_infinity=False)
MAYBE = st.none() | FINITE
POSITIVE = st.floats(min_value=0, exclude_min=True, allow_infinity=False)
WORDS = st.text(st.characters(exclude_categories=['Cs']))
NAMES = ('phi_a', 'phi_b')
DIMENSIONS = st.dictionaries(st.sampled_from(['x', 'y.z', 'index']), FINITE | st.integers(-9, 9))


@pytest.fixture(autouse=True)
def many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, '_AT_ONCE', 3)


def recorded(rows: list[RunRow], added: module.Intervals | None = None) -> RecordedRows:
    texts = {run_key(row.index): json.dumps(row.to_json()) for row in rows}
    return RecordedRows(Path('campaign.db'), texts, added or {})


@st.composite
def run_rows(draw: st.DrawFn, index: int) -> RunRow:
    row = RunRow(
        run_id=f'run-{index}', index=index, program=draw(WORDS), seed=draw(st.integers(0, 2**62)),
        perception=draw(WORDS), outcome=Outcome.REJECTED, detail=draw(WORDS), weight=draw(MAYBE),
        drawn=draw(st.none() | st.booleans()), point=draw(DIMENSIONS), free=draw(DIMENSIONS),
        refused=draw(st.integers(0, 9)), retries=draw(st.integers(0, 2)),
        sim_s=draw(FINITE), wall_s=draw(st.just(0.0) | FINITE), settle_time_s=draw(MAYBE),
    )
    if draw(st.booleans()):
        row = dataclasses.replace(row, **Scenario(cross_track_m=draw(st.floats(-9, 9))).to_human())
    if draw(st.booleans()):
        return row
    early, passed = draw(st.booleans()), draw(st.booleans())
    near = draw(POSITIVE) * (1 if passed else -1)
    far = math.copysign(math.inf, near) if early else near
    interval = RobustnessInterval(min(near, far), max(near, far))
    return dataclasses.replace(
        row, outcome=Outcome.PASS if passed else Outcome.FAIL, stopped_early=early,
        left_runway=draw(st.booleans()), unusable_estimates=draw(st.integers(0, 300)),
        sigma=draw(st.sampled_from([{}, {'cte_max_m': 0.5, 'cte_within_1': 2 / 3}])),
        robustness=dict.fromkeys(NAMES, interval),
    )


@pytest.mark.nightly
@given(data=st.data(), number=st.integers(1, 8))
def test_given_rows_then_their_columns_are_to_the_bit_those_of_single_rows(
    data: st.DataObject, number: int
) -> None:
    rows = [data.draw(run_rows(index)) for index in range(number)]
    names = ('index', 'outcome', 'retries', 'fingerprint')
    found = recorded(rows)
    assert found.some_columns(['index']) is not None
    for _ in ('read alone', 'of all'):
        assert list(values_of(found, *names)) == list(values_of(rows, *names))
        assert found.columns is not None
    # Not of the rows drawn: an entry leaves out -0.0 as the default, which is 0.0.
    one, other = table(found, NAMES), table(list(found), NAMES)
    assert list(one.columns)[:8] == list(other.columns)[:8]
    pd.testing.assert_frame_equal(one, other, check_exact=True)
    assert csv_text(one) == csv_text(other)  # also the sign of zeros
    assert list(found) == rows
    assert list(found.indices) == [row.index for row in rows]


def some(number: int) -> list[RunRow]:
    return [
        RunRow(run_id=f'run-{index}', index=index, program='p', seed=0, perception='truth',
               outcome=Outcome.PASS, robustness={'phi_a': RobustnessInterval.exactly(1.0 + index)})
        for index in range(number)
    ]


def test_given_a_formula_judged_afterwards_then_rows_have_it_where_it_is_known() -> None:
    added = {'later': {run_key(1): (-0.5, -0.5), run_key(99): (1.0, 1.0)}}
    found = recorded(some(4), added)
    assert found[1].robustness['later'] == RobustnessInterval.exactly(-0.5)
    assert 'later' not in found[2].robustness
    assert found.columns is not None
    assert all(column.num_chunks == 1 for column in found.columns.columns)  # else other bytes
    frame = table(found, ('phi_a',))
    pd.testing.assert_frame_equal(frame, table(list(found), ('phi_a',)), check_exact=True)
    assert frame['rho_later'].tolist()[1] == -0.5


def test_given_a_row_that_is_asked_for_then_only_that_one_is_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[int] = []
    from_json = RunRow.from_json
    monkeypatch.setattr(
        RunRow, 'from_json', lambda values: made.append(values['index']) or from_json(values)
    )
    found = recorded(some(9))
    assert [outcome for outcome, in values_of(found, 'outcome')] == [Outcome.PASS] * 9
    assert (found[-1].index, found[-1].index, found[2:4][0].index) == (8, 8, 2)
    assert made == [8, 2, 3]
    with pytest.raises(IndexError):
        found[9]


@pytest.mark.parametrize(('change', 'named'), [
    ({'unknown': 1}, 'unknown'), ({'run_id': None}, ''), ({'seed': 1.5}, ''),
    ({'robustness': {'phi_a': [1.0]}}, ''), ({'robustness': {'phi_a': [1.0, 1.0, 1.0]}}, ''),
    ({'detail': '\ud800'}, ''), ({'point': 3}, ''), ({'cross_track_m': 'far'}, ''),
])
def test_given_what_columns_cannot_say_then_rows_are_read_one_by_one(
    change: dict[str, object], named: str
) -> None:
    rows = some(5)
    texts = {run_key(row.index): json.dumps({**row.to_json(), **change}) for row in rows[:1]}
    texts |= {run_key(row.index): json.dumps(row.to_json()) for row in rows[1:]}
    found = RecordedRows(Path('campaign.db'), texts, {})
    assert found.columns is None
    if named:
        with pytest.raises(UsageError, match=rf'campaign\.db: not a row of this version.*{named}'):
            table(found)


@pytest.fixture
def stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[StoredRows, list[RunRow]]:
    """Rows of which some are in a record only."""
    monkeypatch.setattr(module, 'FEW', 4)
    rows = [dataclasses.replace(one, point={'x': 0.1} if one.index == 13 else {})
            for one in some(19)]
    found = StoredRows(tmp_path / RECORD_NAME, (), {})
    with Record(tmp_path / RECORD_NAME) as record:
        for row in rows:
            found.append(row)
            record.put(ROW, run_key(row.index), row.to_json())
            assert len(found.latest) <= 8
    return found, rows


def test_given_more_rows_than_are_in_memory_then_all_are_read_in_the_order_they_came(
    stored: tuple[StoredRows, list[RunRow]]
) -> None:
    found, rows = stored
    assert (list(found), len(found)) == (rows, 19)
    parts = list(found.parts())
    assert [len(part) for part in parts] == [4, 4, 4, 7]
    assert [row for part in parts for row in part] == rows


def test_given_stored_rows_then_their_table_is_that_of_all_at_once_though_written_in_parts(
    stored: tuple[StoredRows, list[RunRow]], tmp_path: Path
) -> None:
    (tmp_path / 'whole').mkdir()
    (tmp_path / 'parts').mkdir()
    facts = {STACKS: {'a': {'processor': 'one'}}, 'specs': {'phi_a': '', 'phi_b': ''}}
    for name, rows in zip(('parts', 'whole'), stored, strict=True):
        write_tables(rows, tmp_path / name, facts)
    one, other = (pd.read_parquet(tmp_path / name / PARQUET_NAME) for name in ('parts', 'whole'))
    pd.testing.assert_frame_equal(one, other, check_exact=True)
    assert one.attrs == other.attrs
    assert {*one.attrs} == {STACKS}
    assert one['u_x'].count() == 1
    one, other = ((tmp_path / name / CSV_NAME).read_text() for name in ('parts', 'whole'))
    assert one == other
