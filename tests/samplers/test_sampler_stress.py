"""The likeliest failure is known where a system is linear: the sampler has to come near it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest

from taxinet_ros.samplers.histogram import Floats
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.samplers.space import Dimension, make_space, prior_point
from taxinet_ros.samplers.stress import deviations

STEPS = 20
GAINS = 0.8 ** np.arange(STEPS)[::-1]
"""Of each disturbance on the last state of x' = 0.8 x + z."""
SIGMA = 4.0
"""Distance of the likeliest failure from 0: the limit over the last state's deviation."""
LIKELIEST = SIGMA * GAINS / np.linalg.norm(GAINS)


def always(path: Floats) -> float:
    """Robustness of "the state never leaves its limits"; it may fail earlier, if less likely."""
    state, most = 0.0, 0.0
    for disturbance in path:
        state = 0.8 * state + float(disturbance)
        most = max(most, abs(state))
    return SIGMA * float(np.linalg.norm(GAINS)) - most


def at_the_end(path: Floats) -> float:
    """Robustness of "the last state is within its limits"."""
    return SIGMA * float(np.linalg.norm(GAINS)) - abs(float(GAINS @ path))


def failures(
    rho: Callable[[Floats], float | None], steps: int, seed: int, runs: int
) -> list[Floats]:
    """Failing paths of a search, whose results arrive as late as with eight workers."""
    space = [Dimension(name=f'x{number}') for number in range(steps)]
    sampler, under_way, found = make_sampler('stress', space, seed, runs), deque(), []
    for _ in range(runs):
        if len(under_way) == LAG:
            sampler.tell(*under_way.popleft())
        index, point = sampler.next()
        path = deviations(point)
        under_way.append((index, rho(path)))
        if under_way[-1][1] is not None and under_way[-1][1] <= 0:
            found.append(path)
    return found


def likeliest(found: list[Floats]) -> Floats:
    return min(found, key=np.linalg.norm)


@pytest.mark.one_in(3)
@pytest.mark.parametrize('seed', range(3))
def test_given_a_linear_system_then_the_likeliest_failing_path_is_found(seed: int) -> None:
    """Its log-likelihood is within 0.05 of -8 beside the means, after 400 runs."""
    path = likeliest(failures(at_the_end, STEPS, seed, 400))
    assert -8.05 <= -path @ path / 2 <= -8 + 1e-9
    side = math.copysign(1.0, path @ LIKELIEST)
    np.testing.assert_allclose(side * path, LIKELIEST, atol=0.3)


@pytest.mark.parametrize('seed', range(3))
def test_given_a_system_that_may_fail_at_any_step_then_it_is_found(seed: int) -> None:
    """Within 0.2 of -8: a failure two steps earlier is nearly as likely."""
    path = likeliest(failures(always, STEPS, seed, 400))
    assert -8.2 <= -path @ path / 2 <= -8 + 1e-9


def test_given_a_nearer_region_behind_the_start_then_a_later_start_finds_it() -> None:
    ahead = np.ones(10) / math.sqrt(10)
    aside = np.where(np.arange(10) % 2, 1, -1) / math.sqrt(10)

    def rho(path: Floats) -> float:
        return min(4 - 3 * float(ahead @ path), 3 - float(aside @ path))

    sigmas = [np.linalg.norm(likeliest(failures(rho, 10, seed, 400))) for seed in range(3)]
    assert min(sigmas) >= 4 / 3 - 1e-9
    assert max(sigmas) <= 1.4


def test_given_means_that_fail_then_they_are_the_first_run_and_the_likeliest() -> None:
    found = failures(lambda path: float(np.abs(path).sum()) - 2, 3, 1, 30)
    np.testing.assert_array_equal(found[0], np.zeros(3))
    assert np.linalg.norm(likeliest(found)) == 0


@pytest.mark.parametrize('rho', [
    lambda path: math.copysign(1.0, 2 - path.sum() / math.sqrt(3)),  # no slope
    lambda path: math.inf if path[0] < 2 else -math.inf,
    lambda path: None if path[1] > 0 else 2 - abs(path[0]),  # without results on one side
])
def test_given_results_without_slopes_or_missing_then_points_stay_valid_and_failures_are_found(
    rho: Callable[[Floats], float | None]
) -> None:
    found = failures(rho, 3, 2, 300)
    assert found
    assert np.isfinite(found).all()
    assert 2 - 1e-9 <= np.linalg.norm(likeliest(found)) <= 3.5


def test_given_quantiles_then_deviations_are_those_of_a_normal_and_idle_ones_are_0() -> None:
    space = make_space([Dimension(name='x'), Dimension(name='y'), Dimension(name='z')])
    path = deviations(space.point([0.5, 0.8413447460685429, 0.0]))
    np.testing.assert_allclose(path, [0, 1, -9], atol=1e-12)
    np.testing.assert_array_equal(deviations((None, 0.5)), [0, 0])
    draws = np.array([deviations(prior_point(space, 1, index)) for index in range(500)])
    assert abs(draws.mean()) < 0.1
    assert abs(draws.std() - 1) < 0.1


def test_given_a_share_of_draws_then_they_are_learned_from() -> None:
    def points(sign: float) -> list[object]:
        sampler = make_sampler('stress', [Dimension(name='x')], 1, 12, floor=0.5)
        sampler.set_lag(1)
        found: list[object] = []
        for _ in range(12):
            index, point = sampler.next()
            if not sampler.drawn(index):
                found.append(point)
            sampler.tell(index, 1 + sign * point[0] if sampler.drawn(index) else None)
        return found

    assert points(1.0) != points(-1.0)
