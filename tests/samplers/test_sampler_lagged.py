"""The same runs for any number of workers, any order of answers, and after any interruption."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.samplers.registry import SAMPLERS, make_sampler
from taxinet_ros.samplers.sampler import LAG, Lagged
from taxinet_ros.samplers.space import Dimension, Point, make_space

SPACE = make_space((Dimension(name='x'), Dimension(name='kind', weights=(2, 1))))
RUNS = 24


class Diary:
    """A learner whose points say what it knew when asked."""

    def __init__(self) -> None:
        self.told: list[tuple[int, float | None]] = []
        self.known: list[list[tuple[int, float | None]]] = []

    def ask(self) -> Point:
        self.known.append(list(self.told))
        return (len(self.known) / 1000,)

    def again(self) -> Point:
        self.known.pop()
        return self.ask()

    def tell(self, index: int, rho: float | None) -> None:
        self.told.append((index, rho))

    def weight(self, index: int) -> float:
        return 1.0 + index

    def drawn(self, index: int) -> bool:
        return index % 2 == 0

    def learned(self) -> dict[str, tuple[float, ...]]:
        return {'x': (float(len(self.told)),)}


def result(index: int, point: Point) -> float | None:
    """Fixed by the run alone; one in seven has none."""
    return None if index % 7 == 3 else point[0] - 0.4


def campaign(sampler: Lagged, runs: int, choose, workers: int = LAG) -> list[Point]:
    """Points of all runs; ``choose(n)`` picks which of the n runs under way ends next."""
    points: list[Point] = []
    under_way: list[int] = []
    while len(points) < runs or under_way:
        free = len(points) < runs and len(under_way) < workers and sampler.ready
        # Choosing one beyond the runs under way starts another.
        picked = choose(len(under_way) + free)
        if picked == len(under_way):
            index, point = sampler.next()
            assert index == len(points)
            points.append(point)
            under_way.append(index)
        else:
            index = under_way.pop(picked)
            sampler.tell(index, result(index, points[index]))
    return points


def one_by_one(sampler: Lagged, runs: int = RUNS) -> list[Point]:
    return campaign(sampler, runs, choose=lambda number: 0, workers=1)


@given(data=st.data(), workers=st.integers(1, LAG))
def test_given_any_order_of_answers_when_asked_then_the_same_is_known(
    data: st.DataObject, workers: int
) -> None:
    learner = Diary()

    campaign(
        Lagged(learner), RUNS, workers=workers,
        choose=lambda number: data.draw(st.integers(0, number - 1)),
    )  # fmt: skip

    assert len(learner.known) == RUNS
    for index, known in enumerate(learner.known):
        of_whom = range(max(index - LAG + 1, 0))
        assert known == [(run, result(run, ((run + 1) / 1000,))) for run in of_whom]


@pytest.mark.parametrize('name', SAMPLERS)
def test_given_eight_workers_that_end_last_first_when_run_then_it_equals_one(name: str) -> None:
    alone = one_by_one(make_sampler(name, SPACE, 3, RUNS))
    together = campaign(make_sampler(name, SPACE, 3, RUNS), RUNS, lambda number: number - 1)
    assert len(set(alone)) == RUNS
    assert together == alone


@given(stopped=st.integers(1, RUNS), lost=st.sets(st.integers(0, LAG - 1)))
def test_given_an_interruption_when_its_results_are_told_again_then_the_rest_is_the_same(
    stopped: int, lost: set[int]
) -> None:
    def fresh() -> Lagged:
        return make_sampler('ce', SPACE, 5, RUNS, every=4)

    expected = one_by_one(fresh())
    ledger = {index: result(index, expected[index]) for index in range(stopped)}
    for back in lost:
        ledger.pop(stopped - 1 - back, None)

    resumed = fresh()
    open_runs: list[int] = []
    points: list[Point] = []
    while len(points) < stopped:
        index, point = resumed.next()
        points.append(point)
        if index in ledger:
            resumed.tell(index, ledger[index])
        else:
            open_runs.append(index)
    for index in open_runs:
        resumed.tell(index, result(index, points[index]))
    while len(points) < RUNS:
        index, point = resumed.next()
        points.append(point)
        resumed.tell(index, result(index, point))

    assert points == expected


def test_given_lag_runs_under_way_when_the_oldest_ends_then_there_is_one_more() -> None:
    sampler = Lagged(Diary())
    for _ in range(LAG):
        assert sampler.ready
        sampler.next()
    assert not sampler.ready
    with pytest.raises(RuntimeError, match='run 8 depends on the result of run 0'):
        sampler.next()

    sampler.tell(1, 1.0)
    assert not sampler.ready
    sampler.tell(0, None)
    assert sampler.ready
    assert sampler.next()[0] == LAG
    assert sampler.ready
    sampler.next()
    with pytest.raises(RuntimeError, match='run 10 depends on the result of run 2'):
        sampler.next()


def test_given_a_wrong_ticket_when_told_then_it_is_refused_and_nothing_changes() -> None:
    learner = Diary()
    sampler = Lagged(learner, lag=2)
    for index in range(4):
        sampler.next()
        if index < 3:
            sampler.tell(index, 1.0)
    with pytest.raises(ValueError, match='run 4 was not asked for: 4 runs were'):
        sampler.tell(4, 1.0)
    with pytest.raises(ValueError, match='run -1 was not asked for'):
        sampler.tell(-1, 1.0)
    for index in (0, 2):
        with pytest.raises(ValueError, match=f'run {index} has its result already'):
            sampler.tell(index, 2.0)
    with pytest.raises(ValueError, match='run 3: NaN'):
        sampler.tell(3, math.nan)
    with pytest.raises(ValueError, match='run 4 was not asked for'):
        sampler.weight(4)
    assert sampler.weight(3) == 4

    sampler.tell(3, 1.0)
    sampler.next()
    sampler.tell(4, 2.0)
    sampler.next()
    assert learner.told == [(index, 1.0) for index in range(4)]


def test_given_answers_that_wait_when_asked_what_is_learned_then_they_count_but_are_not_told() -> (
    None
):
    learner = Diary()
    sampler = Lagged(learner)
    for _ in range(3):
        sampler.next()
    assert sampler.learned() == {'x': (0,)}
    sampler.tell(2, 1.0)
    sampler.tell(0, None)
    assert sampler.learned() == {'x': (2,)}
    assert learner.told == []


@pytest.mark.one_in(4)
@pytest.mark.parametrize('name', SAMPLERS)
def test_s9_given_refused_points_when_asked_again_then_the_run_stays_and_has_another_point(
    name: str,
) -> None:
    """Twice the run's first point is refused; the results belong to the runs all the same."""
    def points(refused: set[int]) -> list[list[Point]]:
        sampler = make_sampler(name, SPACE, 3, RUNS)
        tried = []
        for run in range(RUNS):
            index, point = sampler.next()
            assert index == run
            tried.append([point])
            if run in refused:
                tried[-1] += [sampler.again(), sampler.again()]
            sampler.tell(index, result(index, tried[-1][-1]))
        return tried

    tried = points({2, 20})
    assert tried == points({2, 20})
    for run in (2, 20):
        assert len(set(tried[run])) == 3
    undisturbed = points(set())
    assert tried[:2] == undisturbed[:2]
    if name in ('random', 'ce', 'mab'):  # what follows from run and attempt, not from the order
        assert tried[2][0] == undisturbed[2][0]
        assert tried[3] == undisturbed[3]


def test_given_a_refused_move_when_splitting_then_the_run_is_that_of_the_next_chain() -> None:
    def after_the_draws() -> Lagged:
        sampler = make_sampler('splitting', SPACE, 1, 200, draws=50, particles=10, islands=2)
        for _ in range(50):
            index, point = sampler.next()
            sampler.tell(index, point[0] - 1e-3)
        return sampler

    refused, undisturbed = after_the_draws(), after_the_draws()
    assert refused.next() == undisturbed.next()
    assert not refused.drawn(50)
    assert refused.again() == undisturbed.next()[1]


def test_s9_given_a_run_with_its_result_when_asked_for_another_point_then_there_is_none() -> None:
    sampler = Lagged(Diary())
    with pytest.raises(RuntimeError, match='run -1 is not waiting'):
        sampler.again()
    sampler.next()
    sampler.again()
    sampler.tell(0, 1.0)
    with pytest.raises(RuntimeError, match='run 0 is not waiting for another point'):
        sampler.again()
