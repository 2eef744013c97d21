"""What several searches have learned, put together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.campaign.learned_result import LEARNED_NAME, LearnedResult, LearnedTogether
from taxinet_ros.campaign.samplers.space import Dimension
from taxinet_ros.campaign.search_space import Choice, Piece
from taxinet_ros.core.errors import UsageError

# Half of the starts lie in the first tenth of the runway.
DISTANCE = Choice(
    dimension=Dimension(name='distance', buckets=4), feeds=frozenset({'distance'}),
    pieces=(Piece(start=0.0, end=0.5, low=0.0, high=200.0),
            Piece(start=0.5, end=1.0, low=200.0, high=2000.0)),
)
CLOUDS = Choice(
    dimension=Dimension(name='clouds', weights=(2.0, 1.0)), options=('clear', 'stratus')
)


def result(seed: int, distance: tuple[float, ...] = (0.25,) * 4, **facts: object) -> LearnedResult:
    return LearnedResult(
        facts={'program': 's_falsif', 'sampler': 'ce', 'perception': 'original', 'seed': seed,
               'runs_made': 10, **facts},
        choices=(DISTANCE, CLOUDS), probabilities={'distance': distance, 'clouds': (0.5, 0.5)},
    )


def together(*results: LearnedResult) -> LearnedTogether:
    return LearnedTogether(results, [Path(f'seed-{number}') for number in range(len(results))])


def test_given_a_result_when_written_then_it_reads_back_equal(tmp_path: Path) -> None:
    (tmp_path / LEARNED_NAME).write_text(result(3).to_json())
    assert LearnedResult.read(tmp_path) == result(3)


def test_given_several_then_each_bin_has_its_mean_and_its_extremes() -> None:
    both = together(result(1, (0.1, 0.2, 0.3, 0.4)), result(2, (0.3, 0.2, 0.1, 0.4)))
    assert [tuple(spread) for spread in both.bins(DISTANCE)] == [
        pytest.approx(values) for values in
        [(0.2, 0.1, 0.3), (0.2, 0.2, 0.2), (0.2, 0.1, 0.3), (0.4, 0.4, 0.4)]
    ]
    assert both.mean['distance'] == pytest.approx((0.2, 0.2, 0.2, 0.4))


def test_given_what_was_learned_then_an_interval_of_values_has_its_probability() -> None:
    both = together(result(1, (0, 0, 0, 1)), result(2, (1, 0, 0, 0)))
    assert tuple(both.within('distance', 0, 100)) == pytest.approx((0.5, 0, 1))
    assert tuple(both.within('distance', 1100, 2000)) == pytest.approx((0.5, 0, 1))
    assert tuple(both.within('distance', 1100, 1550)) == pytest.approx((0.25, 0, 0.5))
    assert DISTANCE.probability_within(0, 200) == pytest.approx(0.5), 'by the program itself'


@given(ends=st.tuples(st.floats(-100, 2100), st.floats(-100, 2100)).map(sorted),
       probabilities=st.lists(st.floats(0.01, 1), min_size=4, max_size=4))
def test_given_any_interval_then_its_probability_is_that_of_drawn_values(
    ends: list[float], probabilities: list[float],
) -> None:
    weights = np.array(probabilities) / sum(probabilities)
    low, high = ends
    inner = (np.arange(400) + 0.5) / 400
    share = 0.0
    for number, weight in enumerate(weights):
        values = np.array([DISTANCE.value((number + q) / 4) for q in inner], float)
        share += weight * np.mean((values >= low) & (values <= high))
    found = DISTANCE.probability_within(low, high, weights.tolist())
    assert found == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize(('other', 'said'), [
    ({'sampler': 'mab'}, 'seed-1: has another sampler than seed-0'),
    ({'perception': 'taxinet'}, 'has another perception'),
    ({'seed': 1}, 'seed 1 is there twice'),
])
def test_given_searches_that_are_not_alike_then_they_are_refused(
    other: dict[str, object], said: str,
) -> None:
    with pytest.raises(UsageError, match=said):
        together(result(1), result(**{'seed': 2, **other}))


@pytest.mark.parametrize('name', ['clouds', 'heading'])
def test_given_a_choice_without_values_or_an_unknown_one_then_its_interval_is_refused(
    name: str,
) -> None:
    with pytest.raises(UsageError, match=name):
        together(result(1)).within(name, 0, 1)


@pytest.mark.parametrize('text', [None, '', '{}', '{"facts": {}, "dimensions": [3]}'])
def test_given_no_result_or_a_damaged_one_then_one_line_says_so(
    text: str | None, tmp_path: Path,
) -> None:
    if text is not None:
        (tmp_path / LEARNED_NAME).write_text(text)
    with pytest.raises(UsageError, match=str(tmp_path)) as caught:
        LearnedResult.read(tmp_path)
    assert '\n' not in str(caught.value)
