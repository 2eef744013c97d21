"""Words and values on their way into a page."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup

from taxinet_ros.analysis.report_text import clean, cleaned, data_block, plain_number

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
