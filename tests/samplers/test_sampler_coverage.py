"""The sampler that covers combinations of cells: how few runs it takes, and what it leaves."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from taxinet_ros.samplers.covering import Covering, own_cells
from taxinet_ros.samplers.registry import make_covering_sampler, make_sampler
from taxinet_ros.samplers.space import Branch, Dimension, make_space


def runs_to_cover(space, strength: int, cells: int, seed: int, most: int = 400) -> int:
    """Number of runs after which all combinations are covered."""
    wanted, cells_of = own_cells(space, cells, strength)
    left = {each: mask.copy() for each, mask in wanted.items()}
    sampler = make_sampler('coverage', space, seed, most, strength=strength, cells=cells)
    for number in range(1, most + 1):
        index, point = sampler.next()
        found = cells_of(point)
        for each, mask in left.items():
            mask[tuple(found[one] for one in each)] = False
        if not any(mask.any() for mask in left.values()):
            return number
        sampler.tell(index, 1.0)
    raise AssertionError(f'not covered after {most} runs')


@pytest.mark.nightly
@pytest.mark.parametrize(
    ('sizes', 'strength', 'least', 'most'),
    # least: the product of the largest sides, which no covering array can undercut; most: less
    # than twice the sizes of the best arrays known (Colbourn's tables: 9, 15 at most, 27, 16).
    [((3,) * 4, 2, 9, 17), ((3,) * 8, 2, 9, 27), ((3,) * 4, 3, 27, 53), ((4, 4, 3, 2), 2, 16, 28)],
)
def test_given_categories_then_every_combination_is_covered_in_few_runs(
    sizes, strength, least, most
):
    space = make_space(
        Dimension(name=f'd{number}', weights=(1,) * size) for number, size in enumerate(sizes)
    )
    found = [runs_to_cover(space, strength, 1, seed) for seed in range(3)]
    assert least <= min(found)
    assert max(found) <= most


def test_given_rare_categories_and_numbers_then_it_needs_far_fewer_runs_than_drawing():
    """Two rare options at once have one draw in 400, so 300 draws often miss them."""
    space = make_space((
        Dimension(name='a', weights=(19, 1)), Dimension(name='b', weights=(19, 1)),
        Dimension(name='x'), Dimension(name='y'),
    ))
    assert max(runs_to_cover(space, 2, 4, seed) for seed in range(3)) <= 28


def test_given_conditional_choices_then_idle_ones_have_no_cell():
    space = make_space((
        Dimension(name='kind', weights=(1, 1)),
        Dimension(name='rain', when=(Branch('kind', (1,)),)),
    ))
    wanted, cells = own_cells(space, 4, 2)
    assert list(wanted) == [(0, 1)]
    assert cells((0.2, None)) == (0, -1)
    assert cells((0.7, 0.99)) == (1, 3)
    sampler = Covering(space, 1, wanted, cells)
    places = {cells(sampler.ask()) for _ in range(12)}
    assert {(1, cell) for cell in range(4)} <= places
    # that of a dry sky with rain does not exist
    assert set(sampler.reach().unseen) == {((0, 1), (0, cell)) for cell in range(4)}


SQUARE = make_space((Dimension(name='x'), Dimension(name='y')))
WANTED = {(0, 1): np.ones((4, 4), dtype=bool)}


def below_the_diagonal(point) -> tuple[int, int] | None:
    """Cells of a program that never has both quantiles high, which is of no use."""
    x, y = point
    return None if x + y > 1 else (int(4 * x), int(4 * y))


def test_given_what_the_program_cannot_reach_then_it_is_named_and_the_rest_covered():
    sampler = Covering(SQUARE, 3, WANTED, below_the_diagonal)
    places = [below_the_diagonal(sampler.ask()) for _ in range(10)]
    assert None not in places
    assert len(set(places)) == 10  # ten of the 16 cells have a part below it
    reach = sampler.reach()
    assert (reach.wanted, reach.covered, reach.seen) == (16, 10, 10)
    assert reach.points > 128
    assert reach.unseen == tuple(
        ((0, 1), cells) for cells in itertools.product(range(4), repeat=2) if sum(cells) > 3
    )


def test_given_excluded_combinations_then_no_run_is_spent_on_them():
    wanted = {(0, 1): np.triu(np.ones((4, 4), dtype=bool))}
    cells = own_cells(SQUARE, 4, 2)[1]
    sampler = Covering(SQUARE, 1, wanted, cells)
    places = [cells(sampler.ask()) for _ in range(10)]
    assert sorted(places) == [(x, y) for x in range(4) for y in range(x, 4)]


def test_given_a_run_without_a_result_then_its_combinations_are_wanted_again():
    cells = own_cells(SQUARE, 4, 2)[1]
    sampler = Covering(SQUARE, 1, WANTED, cells)
    places = [cells(sampler.ask()) for _ in range(16)]
    assert len(set(places)) == 16
    sampler.tell(4, -1.0)  # a failure covers as well
    sampler.tell(5, None)
    assert cells(sampler.ask()) == places[5]


def test_given_points_that_the_program_refuses_then_others_cover_and_nothing_is_counted_twice():
    cells = own_cells(SQUARE, 4, 2)[1]
    sampler = Covering(SQUARE, 1, WANTED, cells)
    sampler.ask()
    for _ in range(3):
        last = cells(sampler.again())
    places = [cells(sampler.ask()) for _ in range(15)]
    assert len({last, *places}) == 16
    assert sampler.reach().covered == 16


def test_given_a_floor_then_what_the_program_draws_counts_as_covered():
    cells = own_cells(SQUARE, 4, 2)[1]
    lagged, covering = make_covering_sampler(SQUARE, 5, WANTED, cells, floor=0.5)
    places, drawn = [], []
    for _ in range(32):
        index, point = lagged.next()
        lagged.tell(index, 1.0)
        places.append(cells(point))
        drawn.append(lagged.drawn(index))
    assert sum(drawn) == 16
    assert lagged.weight(0) is None
    assert len(set(places)) == 16
    # Results arrive 8 runs late; all before is known.
    known = {place for place, own in zip(places, drawn, strict=True) if not own}
    assert covering.reach().covered >= len(known)


def test_given_the_same_seed_then_the_same_points_and_otherwise_others():
    def points(seed: int):
        cells = own_cells(SQUARE, 4, 2)[1]
        sampler = Covering(SQUARE, seed, WANTED, cells)
        return [sampler.ask() for _ in range(20)]

    assert points(1) == points(1)
    assert points(1) != points(2)


def test_given_a_program_that_is_never_of_use_then_it_still_gets_draws():
    sampler = Covering(SQUARE, 1, WANTED, lambda point: None)
    points = [sampler.ask() for _ in range(3)]
    assert len(set(points)) == 3
    sampler.tell(0, None)
    assert sampler.reach().covered == 0


def test_given_a_pool_that_is_full_then_it_goes_on(monkeypatch):
    monkeypatch.setattr('taxinet_ros.samplers.covering._MOST_POOL', 150)
    space = make_space(Dimension(name=f'd{number}', weights=(1, 1, 1)) for number in range(4))
    assert runs_to_cover(space, 2, 1, 1) <= 17
