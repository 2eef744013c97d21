"""Dimensions, their bins, and the checks of a space."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.space import IDLE, Branch, Dimension, make_space

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


KIND = Dimension(name='kind', weights=(2, 0, 1))
RAIN = Dimension(name='rain', when=(Branch('kind', (2,)),))
SNOW = Dimension(name='snow', weights=(1, 1), when=(Branch('kind', (0, 2)), ))
DEEP = Dimension(name='deep', when=(Branch('snow', (1,)), Branch('kind', (0,))))


def test_s9_given_options_not_taken_when_a_point_is_made_then_their_choices_have_no_coordinate(
) -> None:
    space = make_space((KIND, RAIN, SNOW, DEEP))
    assert space.point((0.5, 0.1, 0.2, 0.3)) == (0.5, None, 0.2, 0.3)
    assert space.point((0.9, 0.1, 0.2, 0.3)) == (0.9, 0.1, 0.2, None)
    assert space.point((0.9, 0.1, 0.7, 1.0)) == (0.9, 0.1, 0.7, math.nextafter(1, 0))
    assert space.bins((0.9, 0.15, 0.2, None)) == (2, 1, 0, IDLE)
    space.check((0.9, 0.1, 0.2, None))
    for point, message in (
        ((0.9, 0.1, 0.2), '3 quantiles for 4 dimensions'),
        ((0.9, 0.1, 0.2, 0.5), 'deep is idle there'),
        ((0.9, None, 0.2, None), 'rain has no quantile there'),
        ((None, None, None, None), 'kind has no quantile there'),
        ((0.9, 1.0, 0.2, None), 'within'),
    ):
        with pytest.raises(ValueError, match=message):
            space.check(point)


@pytest.mark.parametrize('when', [
    Branch('weather', (0,)), Branch('kind', (3,)), Branch('kind', ()), Branch('kind', (-1,)),
    Branch('along', (0,)), Branch('rain', (0,)),
])
def test_s9_given_a_branch_of_no_choice_before_when_made_a_space_then_it_is_refused(
    when: Branch,
) -> None:
    with pytest.raises(UsageError, match=f'rain: {when.parent} has no categories'):
        make_space((Dimension(name='along'), KIND, Dimension(name='rain', when=(when,))))
