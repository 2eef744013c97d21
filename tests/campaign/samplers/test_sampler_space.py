"""Dimensions, their bins, and the checks of a space."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.campaign.samplers.space import Dimension, make_space
from taxinet_ros.core.errors import UsageError

DIMENSIONS = st.one_of(
    st.builds(Dimension, name=st.just('d'), buckets=st.integers(1, 30)),
    st.builds(
        Dimension, name=st.just('d'),
        weights=st.lists(st.floats(0, 100), min_size=1, max_size=8)
        .filter(lambda weights: sum(weights) > 1e-6).map(tuple),
    ),
)  # fmt: skip
QUANTILES = st.floats(0, 1, exclude_max=True)


@given(dimension=DIMENSIONS, quantile=QUANTILES)
def test_given_a_quantile_when_binned_then_its_bin_has_it_and_is_possible(
    dimension: Dimension, quantile: float
) -> None:
    number = dimension.bin(quantile)
    assert dimension.edges[number] <= quantile < dimension.edges[number + 1]
    assert dimension.prior[number] > 0


@given(dimension=DIMENSIONS)
def test_given_a_dimension_when_asked_for_its_prior_then_it_adds_up_to_one(
    dimension: Dimension,
) -> None:
    assert math.fsum(dimension.prior) == pytest.approx(1)
    assert min(dimension.prior) >= 0
    assert len(dimension.prior) == (len(dimension.weights) or dimension.buckets)


def test_given_weights_when_asked_for_edges_then_each_category_owns_its_share() -> None:
    weather = Dimension(name='weather', weights=(2, 0, 1, 1))
    assert weather.edges == (0, 0.5, 0.5, 0.75, 1)
    assert weather.prior == (0.5, 0, 0.25, 0.25)
    assert [weather.bin(quantile) for quantile in (0, 0.49, 0.5, 0.75)] == [0, 0, 2, 3]
    assert weather.discrete
    assert not Dimension(name='x').discrete


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'weights': (1.0, -1.0)}, 'need to be finite, 0 or more'),
        ({'weights': (1.0, math.inf)}, 'need to be finite, 0 or more'),
        ({'weights': (0.0, 0.0)}, 'one has to be above 0'),
        ({'buckets': 0}, '0 buckets, needs to be 1 or more'),
    ],
)
def test_given_an_impossible_dimension_when_made_then_it_is_refused_by_name(
    changes, message: str
) -> None:
    with pytest.raises(UsageError, match=f'^weather: .*{message}'):
        Dimension(name='weather', **changes)


def test_given_no_dimension_or_one_twice_when_made_a_space_then_it_is_refused() -> None:
    with pytest.raises(UsageError, match='no random choice'):
        make_space([])
    with pytest.raises(UsageError, match='two dimensions have the name x'):
        make_space([Dimension(name='x'), Dimension(name='y'), Dimension(name='x')])
