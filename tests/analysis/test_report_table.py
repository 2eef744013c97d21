"""Tables as a page shows them."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from report_examples import RUNS, run_table

from taxinet_ros.analysis.report_parts import Cell, Column, Table
from taxinet_ros.analysis.report_table import ROWS_AT_ONCE, run_link, view_table


def table_of(*cells: Cell, decimals: int | None = None) -> Table:
    """A table of one column."""
    column = Column(name='a', title='A', decimals=decimals)
    return Table(name='one', title='One', caption='', columns=(column,),
                 rows=tuple((cell,) for cell in cells))


def test_given_a_long_table_when_viewed_then_the_first_rows_are_html_and_all_are_data() -> None:
    view = view_table(run_table(60), RUNS)
    data = json.loads(view.data)
    assert len(view.rows) == data['rowsAtOnce'] == ROWS_AT_ONCE
    assert len(data['rows']) == view.count == 60
    assert (view.long, view.state) == (True, '1–25 of 60 rows')
    assert data['rows'][1] == ['taxinet-midday', '-∞', False, 'dry']
    assert data['rows'][0][1] is None


def test_given_a_short_table_when_viewed_then_it_has_one_page() -> None:
    view = view_table(run_table(3), RUNS)
    assert (view.long, view.state, len(view.rows)) == (False, '3 rows', 3)
    assert view_table(table_of(1), ()).state == '1 row'


def test_given_run_ids_when_viewed_then_only_runs_with_viewers_are_links() -> None:
    view = view_table(run_table(60), RUNS[:1])
    links = [row[0].link for row in view.rows]
    assert links[0] == '#run=truth-nominal'
    assert not any(links[1:])


@pytest.mark.parametrize(
    ('cell', 'decimals', 'words'),
    [
        (1.005, 1, '1.0'), (2, 2, '2.00'), (2, None, '2'), (0.1 + 0.2, None, '0.3'), (None, 2, '–'),
        (math.nan, 2, '–'), (-math.inf, 2, '-∞'), (True, None, 'yes'), (False, None, 'no'),
        (-0.001, 2, '0.00'), ('words', 2, 'words'), (2**60, None, str(2**60)),
        ('a\0', None, 'a\ufffd'),
    ],
)
def test_given_a_cell_when_viewed_then_it_reads_as_people_write_it(
    cell: Cell, decimals: int | None, words: str,
) -> None:
    assert view_table(table_of(cell, decimals=decimals), ()).rows[0][0].text == words


def test_given_numbers_of_numpy_when_viewed_then_they_are_numbers() -> None:
    # Not what a cell is declared to be, but what a data frame hands over.
    cells = (np.float32(0.5), np.int64(3), None)
    view = view_table(table_of(*cells, decimals=1), ())  # type: ignore[arg-type]
    assert json.loads(view.data)['rows'] == [[0.5], [3], [None]]
    assert view.columns == (('A', True),)


@pytest.mark.parametrize(
    ('cells', 'numeric'),
    [((1, 2.5, None), True), ((1, 'a'), False), ((True, False), False), ((None,), False),
     ((math.inf, 1.0), True)],
)
def test_given_cells_when_viewed_then_a_column_of_numbers_is_known(
    cells: tuple[Cell, ...], numeric: bool,
) -> None:
    assert view_table(table_of(*cells), ()).columns[0][1] is numeric


def test_given_long_words_when_viewed_then_they_may_take_several_lines() -> None:
    view = view_table(table_of('a' * 41, 'a' * 40), ())
    assert [row[0].kind for row in view.rows] == ['long', '']


def test_given_a_table_that_contradicts_itself_when_viewed_then_it_is_refused() -> None:
    with pytest.raises(ValueError, match='2 cells for 1 columns'):
        view_table(replace(table_of(), rows=((1, 2),)), ())
    with pytest.raises(ValueError, match="no column 'b'"):
        view_table(replace(table_of(), run_id_column='b'), ())


def test_given_any_run_id_when_linked_then_the_address_stays_within_the_page() -> None:
    assert run_link('a b"<\ud800') == '#run=a%20b%22%3C%EF%BF%BD'
