"""Samplers that fill the space: random, Halton, Sobol and the grid."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare, kstest, qmc

from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.sampler import Exhausted
from taxinet_ros.samplers.space import Branch, Dimension, Point, make_space, prior_point
from taxinet_ros.samplers.space_filling import CellOrder, Grid

WEATHER = Dimension(name='weather', weights=(3, 1, 2, 2))
X, Y = Dimension(name='x'), Dimension(name='y')


def ask(
    name: str, space: Iterable[Dimension], runs: int, seed: int = 1, **options
) -> list[tuple[Point, float]]:
    """Points and weights."""
    sampler = make_sampler(name, space, seed, runs, **options)
    asked = []
    for _ in range(runs):
        index, point = sampler.next()
        sampler.tell(index, 1.0)
        asked.append((point, sampler.weight(index)))
    return asked


def discrepancy(asked: list[tuple[Point, float]]) -> float:
    return float(qmc.discrepancy([point for point, _ in asked]))


def test_given_the_random_sampler_when_asked_then_each_point_is_the_plain_draw_of_its_run() -> None:
    space = make_space((X, Y, WEATHER))
    asked = ask('random', space, 50, seed=9)
    assert [point for point, _ in asked] == [prior_point(space, 9, index) for index in range(50)]
    drawn = [prior_point(space, seed, index)[0] for seed in range(20) for index in range(20)]
    assert len(set(drawn)) == 400
    assert kstest(drawn, 'uniform').pvalue > 0.01


def largest_gap(asked: list[tuple[Point, float]]) -> float:
    """Distance from any place to the nearest point, at most."""
    places = np.random.default_rng(0).random((500, 1, len(asked[0][0])))
    away = np.linalg.norm(places - np.array([point for point, _ in asked]), axis=2)
    return float(away.min(axis=1).max())


@pytest.mark.parametrize(
    ('name', 'measure'), [('halton', discrepancy), ('sobol', discrepancy), ('grid', largest_gap)]
)
@pytest.mark.parametrize(('runs', 'dimensions'), [
    (64, 2), *(pytest.param(256, count, marks=pytest.mark.nightly) for count in (2, 3)),
])
def test_given_a_spread_sampler_when_compared_with_random_then_it_leaves_smaller_gaps(
    name: str, measure, runs: int, dimensions: int
) -> None:
    space = tuple(Dimension(name=str(number)) for number in range(dimensions))
    by_chance = [measure(ask('random', space, runs, seed)) for seed in range(8)]
    spread = [measure(ask(name, space, runs, seed)) for seed in range(4)]
    assert max(spread) < 0.9 * min(by_chance)


@pytest.mark.parametrize('name', ['random', 'halton', 'sobol', 'grid'])
def test_given_categories_when_asked_for_then_the_prior_is_kept(name: str) -> None:
    runs = 512
    asked = ask(name, (X, WEATHER, Y), runs)
    weight = np.array([weight for _, weight in asked])
    category = [WEATHER.bin(point[1]) for point, _ in asked]
    weighted = np.bincount(category, weights=weight, minlength=4)

    assert weighted.sum() == pytest.approx(runs, rel=0.02)
    weighted *= runs / weighted.sum()
    assert chisquare(weighted, runs * np.array(WEATHER.prior)).pvalue > 0.01
    for place in (0, 2):
        mean = np.average([point[place] for point, _ in asked], weights=weight)
        assert mean == pytest.approx(0.5, abs=0.04)
    if name != 'grid':
        assert set(weight) == {1.0}


def test_given_a_rare_category_when_on_a_grid_then_it_is_tried_as_often_as_the_others() -> None:
    rare = Dimension(name='rare', weights=(98, 0, 1, 1))
    asked = ask('grid', (X, rare), 30)
    assert Counter(rare.bin(point[1]) for point, _ in asked) == {0: 10, 2: 10, 3: 10}
    assert sum(weight for _, weight in asked) == pytest.approx(30)
    assert sum(w for point, w in asked if rare.bin(point[1]) == 2) == pytest.approx(0.3)


@given(sizes=st.lists(st.integers(1, 6), min_size=1, max_size=4), seed=st.integers(0, 99))
def test_given_a_grid_when_numbered_then_every_cell_comes_once_and_beginnings_are_spread(
    sizes: list[int], seed: int
) -> None:
    order = CellOrder(sizes, seed)
    cells = [tuple(order.digits(index)) for index in range(order.cells)]

    assert len(set(cells)) == order.cells == math.prod(sizes)
    assert all(0 <= digit < size for cell in cells
               for digit, size in zip(cell, sizes, strict=True))
    assert order.digits(order.cells) == list(cells[0])
    # Each row of cells gets its share of the first ones, but for a rounding.
    first = max(sizes)
    for side, size in enumerate(sizes):
        visits = Counter(cell[side] for cell in cells[:first])
        assert set(visits) == set(range(size))
        assert max(visits.values()) <= math.ceil(first / size)


def test_given_a_huge_grid_when_asked_then_pairs_of_dimensions_are_covered_early() -> None:
    sides = 7
    order = CellOrder([21] * sides, seed=0)
    assert order.cells == 21**7
    cells = [order.digits(index) for index in range(21 * 21)]
    for one in range(sides):
        for other in range(one):
            pairs = {(cell[one], cell[other]) for cell in cells}
            assert len(pairs) > 0.5 * 21 * 21  # by chance it would be 0.63


def test_given_runs_when_a_grid_is_laid_then_it_fits_into_them_and_is_then_jittered() -> None:
    space = make_space((X, Dimension(name='kind', weights=(1, 1)), Y))
    asked = [point for point, _ in ask('grid', space, 3 * 24)]
    grid = Grid(space, 1, 24)
    first = [grid.ask() for _ in range(24)]
    assert len(set(first)) == 24
    assert sorted({point[0] for point in first}) == [1 / 8, 3 / 8, 5 / 8, 7 / 8]
    assert sorted({point[2] for point in first}) == pytest.approx([1 / 6, 1 / 2, 5 / 6])
    assert len(set(asked)) == 72

    again = [grid.ask() for _ in range(24)]
    for old, new in zip(first, again, strict=True):
        assert new != old
        assert all(abs(a - b) <= half for a, b, half in
                   zip(old, new, (1 / 8, 1 / 4, 1 / 6), strict=True))


def test_given_a_number_of_points_when_a_grid_is_laid_then_it_has_them() -> None:
    asked = ask('grid', (X, Y), 25, points='5')
    assert sorted({point[0] for point, _ in asked}) == pytest.approx([0.1, 0.3, 0.5, 0.7, 0.9])
    assert len(set(asked)) == 25


KIND = Dimension(name='kind', weights=(2, 1))
DRY = Dimension(name='dry', weights=(1, 1, 1), when=(Branch('kind', (0,)),))
WET = Dimension(name='wet', weights=(1, 2), when=(Branch('kind', (1,)),))
RAIN = Dimension(name='rain', when=(Branch('kind', (1,)),))


def test_t11_given_idle_choices_when_on_a_grid_then_no_scene_is_counted_twice() -> None:
    """5 scenes, where all combinations of the categories would be 12."""
    asked = ask('grid', (KIND, DRY, WET), 5)
    cells = [make_space((KIND, DRY, WET)).bins(point) for point, _ in asked]
    assert sorted(cells) == [(0, 0, -1), (0, 1, -1), (0, 2, -1), (1, -1, 0), (1, -1, 1)]
    with pytest.raises(Exhausted, match='all 5 combinations of the grid have been tried'):
        ask('grid', (KIND, DRY, WET), 6)
    weights = {cell: weight for cell, (_, weight) in zip(cells, asked, strict=True)}
    shares = {(0, 0, -1): 2 / 9, (0, 1, -1): 2 / 9, (0, 2, -1): 2 / 9,
              (1, -1, 0): 1 / 9, (1, -1, 1): 2 / 9}
    assert weights == pytest.approx({cell: 5 * share for cell, share in shares.items()})


def test_t11_given_ranges_under_options_when_on_a_grid_then_it_fits_into_the_runs() -> None:
    asked = ask('grid', (KIND, DRY, WET, RAIN, X), 60)
    assert len({point for point, _ in asked}) == 60
    grid = Grid(make_space((KIND, DRY, WET, RAIN, X)), 1, 60)
    assert 40 <= grid.cells <= 60
    first = [grid.ask() for _ in range(grid.cells)]
    assert sum(grid.weight(index) for index in range(grid.cells)) == pytest.approx(grid.cells)
    assert {KIND.bin(point[0]) for point in first[:2]} == {0, 1}, 'each option is tried early'


def test_t11_given_too_many_combinations_of_options_when_on_a_grid_then_one_line_says_so() -> None:
    parents = [Dimension(name=f'p{number}', weights=(1,) * 10) for number in range(5)]
    children = [Dimension(name=f'c{number}', when=(Branch(f'p{number}', (0,)),))
                for number in range(5)]
    with pytest.raises(UsageError, match='more than 10000 combinations of options'):
        make_sampler('grid', [*parents, *children], 0, 100)
    assert ask('sobol', [*parents, *children], 4)


@pytest.mark.parametrize('word', ['halton', 'sobol', 'random'])
def test_s3_given_a_requirement_in_some_runs_only_then_the_others_stay_as_the_program_draws(word):
    sampler = make_sampler(word, (Dimension(name='x'),), 3, 2048)
    free = []
    for run, required in enumerate(np.random.default_rng(5).random(2048) < 0.5):
        _, (value,) = sampler.next()
        while required and value < 0.7:
            (value,) = sampler.again()
        sampler.tell(run, 1.0)
        if not required:
            free.append(value)
    # Four standard errors of the mean of independent draws.
    assert np.mean(free) == pytest.approx(0.5, abs=4 / np.sqrt(12 * len(free)))
    assert kstest(free, 'uniform').pvalue > 1e-4
