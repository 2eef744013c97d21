"""Parts of a report: text that cannot become markup, tables, pictures."""

import io
import json
import math
from dataclasses import replace
from itertools import product
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image
from report_examples import RUNS, picture, run_table

from taxinet_ros.analysis.report.parts import Cell, Column, Table, Theme
from taxinet_ros.analysis.report.pictures import DARK, DOTS_PER_INCH, LIGHT, png_bytes, write_png
from taxinet_ros.analysis.report.table import ROWS_AT_ONCE, run_link, view_table
from taxinet_ros.analysis.report.values import clean, cleaned, data_block, plain_number

ANY_TEXT = st.text(st.characters(codec=None, exclude_categories=()))
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | ANY_TEXT | st.floats(allow_nan=False,
                                                                    allow_infinity=False),
    lambda inner: st.lists(inner) | st.dictionaries(ANY_TEXT.map(clean), inner),
    max_leaves=10,
)


@given(ANY_TEXT)
def test_given_any_text_when_cleaned_then_html_can_hold_it_and_fit_characters_stay(
    text: str,
) -> None:
    tidy = clean(text)
    assert len(tidy) == len(text)
    tidy.encode('utf-8')
    assert '\0' not in tidy
    assert all(new in (old, '\ufffd') for old, new in zip(text, tidy, strict=True))
    assert clean(tidy) == tidy


@given(st.text(st.characters(min_codepoint=32, max_codepoint=126)))
def test_given_plain_words_when_cleaned_then_they_are_as_they_were(text: str) -> None:
    assert clean(text) == text


@given(VALUES)
def test_given_any_value_when_put_in_a_block_then_no_sign_can_end_it_and_it_reads_back(
    value: object,
) -> None:
    block = data_block(value)
    assert not set('<>&\u2028\u2029') & set(block)
    assert block.isascii()
    assert data_block(json.loads(block)) == block


def test_given_an_attack_when_put_in_a_block_then_it_reads_back_word_for_word() -> None:
    assert json.loads(data_block({'a': ['</script>', '<!--', '&amp;']})) == {
        'a': ['</script>', '<!--', '&amp;'],
    }


def test_given_a_number_that_json_lacks_when_put_in_a_block_then_it_is_refused() -> None:
    with pytest.raises(ValueError, match='JSON'):
        data_block([math.nan])


@given(st.floats(allow_nan=False, allow_infinity=False, width=32), st.integers(0, 6))
def test_given_a_finite_number_when_made_plain_then_it_is_rounded(
    value: float, decimals: int,
) -> None:
    plain = plain_number(value, decimals)
    assert plain == round(value, decimals)
    assert str(plain) != '-0.0'


@pytest.mark.parametrize(
    ('value', 'plain'),
    [(math.nan, None), (math.inf, '∞'), (-math.inf, '-∞'), (2.0, 2), (-0.0001, 0)],
)
def test_given_a_number_when_made_plain_then_json_has_it(value: float, plain: object) -> None:
    assert plain_number(value, 3) == plain
    assert type(plain_number(value, 3)) is type(plain)


def test_given_markup_or_numbers_when_shown_then_only_words_are_cleaned() -> None:
    assert cleaned('a\0') == 'a\ufffd'
    assert cleaned(3) == 3
    assert isinstance(cleaned(Markup('<b>')), Markup)


def table_of(*cells: Cell, decimals: int | None = None) -> Table:
    """A table of one column."""
    column = Column(name='a', title='A', decimals=decimals)
    return Table(name='one', title='One', caption='', columns=(column,),
                 rows=tuple((cell,) for cell in cells))


def test_given_a_long_table_when_viewed_then_the_first_rows_are_html_and_all_are_data() -> None:
    view = view_table(run_table(60), RUNS)
    data = json.loads(view['data'])
    assert len(view['rows']) == data['rowsAtOnce'] == ROWS_AT_ONCE
    assert len(data['rows']) == view['count'] == 60
    assert (view['long'], view['state']) == (True, '1–25 of 60 rows')
    assert data['rows'][1] == ['taxinet-midday', '-∞', False, 'dry']
    assert data['rows'][0][1] is None


def test_given_a_short_table_when_viewed_then_it_has_one_page() -> None:
    view = view_table(run_table(3), RUNS)
    assert (view['long'], view['state'], len(view['rows'])) == (False, '3 rows', 3)
    assert view_table(table_of(1), ())['state'] == '1 row'


def test_given_run_ids_when_viewed_then_only_runs_with_viewers_are_links() -> None:
    view = view_table(run_table(60), RUNS[:1])
    links = [row[0][2] for row in view['rows']]
    assert links[0] == '#run=truth-nominal'
    assert not any(links[1:])


@pytest.mark.parametrize(
    ('cell', 'decimals', 'words'),
    [
        (1.005, 1, '1.0'), (2, 2, '2.00'), (2, None, '2'), (0.1 + 0.2, None, '0.3'), (None, 2, '–'),
        (math.nan, 2, '–'), (-math.inf, 2, '−∞'), (True, None, 'yes'), (False, None, 'no'),
        (-0.001, 2, '0.00'), ('words', 2, 'words'), (2**60, None, str(2**60)),
        ('a\0', None, 'a\ufffd'),
    ],
)
def test_given_a_cell_when_viewed_then_it_reads_as_people_write_it(
    cell: Cell, decimals: int | None, words: str,
) -> None:
    assert view_table(table_of(cell, decimals=decimals), ())['rows'][0][0][0] == words


def test_given_numbers_of_numpy_when_viewed_then_they_are_numbers() -> None:
    # Not what a cell is declared to be, but what a data frame hands over.
    cells = (np.float32(0.5), np.int64(3), None)
    view = view_table(table_of(*cells, decimals=1), ())  # type: ignore[arg-type]
    assert json.loads(view['data'])['rows'] == [[0.5], [3], [None]]
    assert view['columns'] == [('A', True)]


@pytest.mark.parametrize(
    ('cells', 'numeric'),
    [((1, 2.5, None), True), ((1, 'a'), False), ((True, False), False), ((None,), False),
     ((math.inf, 1.0), True)],
)
def test_given_cells_when_viewed_then_a_column_of_numbers_is_known(
    cells: tuple[Cell, ...], numeric: bool,
) -> None:
    assert view_table(table_of(*cells), ())['columns'][0][1] is numeric


def test_given_long_words_when_viewed_then_they_may_take_several_lines() -> None:
    view = view_table(table_of('a' * 41, 'a' * 40), ())
    assert [row[0][1] for row in view['rows']] == ['long', '']


def test_given_a_table_that_contradicts_itself_when_viewed_then_it_is_refused() -> None:
    with pytest.raises(ValueError, match='shorter'):
        view_table(replace(table_of(), rows=((1, 2),)), ())
    with pytest.raises(ValueError, match="'b' is not in list"):
        view_table(replace(table_of(), run_id_column='b'), ())


def test_given_any_run_id_when_linked_then_the_address_stays_within_the_page() -> None:
    assert run_link('a b"<\ud800') == '#run=a%20b%22%3C%EF%BF%BD'


THEMES = {'light': LIGHT, 'dark': DARK}


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours (WCAG 2.2, relative luminance)."""
    low, high = sorted(_luminance(colour) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: str) -> float:
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_given_a_picture_when_drawn_twice_then_the_bytes_are_equal_whatever_the_settings() -> None:
    first = png_bytes(picture(), LIGHT)
    with mpl.rc_context({'axes.facecolor': 'red', 'font.size': 30}):
        assert png_bytes(picture(), LIGHT) == first
    assert png_bytes(picture(), DARK) != first
    with Image.open(io.BytesIO(first)) as image:
        assert image.size == (3 * DOTS_PER_INCH, 1.5 * DOTS_PER_INCH)


@pytest.mark.parametrize('theme', THEMES.values(), ids=THEMES)
def test_given_a_drawing_without_colours_when_drawn_then_it_has_those_of_the_theme(
    theme: Theme,
) -> None:
    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        axes.plot([0, 1])
        axes.set_title('█' * 8)

    with Image.open(io.BytesIO(png_bytes(replace(picture(), draw=draw), theme))) as image:
        colours = {colour for _, colour in image.convert('RGB').getcolors(1 << 20) or []}
    for wanted in (theme.ink, theme.paper, theme.passed):
        assert tuple(round(255 * channel) for channel in to_rgb(wanted)) in colours


@pytest.mark.parametrize('theme', THEMES.values(), ids=THEMES)
def test_given_a_theme_when_on_its_paper_then_words_and_curves_stand_out(theme: Theme) -> None:
    assert contrast(theme.ink, theme.paper) >= 7
    curves = (theme.passed, theme.failed, *theme.others)
    assert min(contrast(colour, paper) for colour, paper in product(curves, [theme.paper])) >= 3


def test_given_a_folder_when_written_then_the_file_is_named_after_the_picture(
    tmp_path: Path,
) -> None:
    path = write_png(picture('rates'), tmp_path, DARK)
    assert path == tmp_path / 'rates.png'
    assert path.read_bytes() == png_bytes(picture(), DARK)
    assert list(tmp_path.iterdir()) == [path]
