"""Failure rates under the program's distribution, from the runs of biased samplers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.campaign.rates import rate
from taxinet_ros.campaign.samplers.estimate import Estimate, estimate_rate
from taxinet_ros.campaign.samplers.make import make_sampler
from taxinet_ros.campaign.samplers.space import Dimension

SPACE = (Dimension(name='x'), Dimension(name='kind', weights=(3, 1)), Dimension(name='z'))
TRUE = 0.3 * 0.25 + 0.02
"""Of runs fail that have a low x and the second kind, and 2 % of all others' corner in z."""

OPTIONS = {'ce-verifai': {'alpha': 0.98}}


def rho(point) -> float:
    corner = SPACE[1].bin(point[1]) == 1 and point[0] < 0.3
    rest = not corner and point[2] < 0.02 / (1 - 0.3 * 0.25)
    return -1.0 if corner or rest else 1.0


def estimate(name: str, seed: int, runs: int = 400) -> Estimate:
    sampler = make_sampler(name, SPACE, seed, runs, **OPTIONS.get(name, {}))
    rhos = []
    for _ in range(runs):
        index, point = sampler.next()
        rhos.append(rho(point))
        sampler.tell(index, rhos[-1])
    found = estimate_rate(rhos, [sampler.weight(index) for index in range(runs)])
    assert found is not None
    assert found.runs == runs
    return found


@pytest.mark.parametrize('name', ['random', 'sobol', 'ce', 'ce-verifai', 'mab'])
def test_given_twenty_campaigns_when_rated_then_the_true_rate_is_their_mean(name: str) -> None:
    found = [estimate(name, seed) for seed in range(20)]
    for each in ('rate', 'unnormalised'):
        rates = [getattr(one, each) for one in found]
        values = np.array([one.rate for one in rates])
        error = values.std(ddof=1) / np.sqrt(20)
        assert values.mean() == pytest.approx(TRUE, abs=3 * error + 0.003)
        assert sum(one.low <= TRUE <= one.high for one in rates) >= 17
    if name in ('ce', 'ce-verifai', 'mab'):
        assert np.mean([one.failures for one in found]) > 1.5 * TRUE * 400
        assert np.mean([one.effective for one in found]) < 380


def test_given_a_rare_failure_when_cross_entropy_is_rated_then_it_is_surer_than_chance() -> None:
    def rare(point) -> float:
        return max(point[0], point[2]) - 0.06  # 0.36 % of all

    def width(name: str) -> float:
        sampler = make_sampler(name, SPACE, 3, 1500)
        rhos = []
        for _ in range(1500):
            index, point = sampler.next()
            rhos.append(rare(point))
            sampler.tell(index, rhos[-1])
        found = estimate_rate(rhos, [sampler.weight(index) for index in range(1500)])
        assert found is not None
        assert found.unnormalised.low < 0.0036 < found.unnormalised.high
        return found.unnormalised.high - found.unnormalised.low

    assert width('ce') < 0.7 * width('random')


@given(failed=st.lists(st.booleans(), max_size=60))
def test_given_weights_of_one_when_rated_then_it_is_the_plain_rate(failed: list[bool]) -> None:
    found = estimate_rate([0.0 if each else 1.0 for each in failed], [1.0] * len(failed))
    assert found is not None
    plain = rate(sum(failed), len(failed))
    assert found.rate[1:] == plain[1:]
    assert found.unnormalised[1:] == plain[1:]
    assert (found.runs, found.failures) == (len(failed), sum(failed))
    assert found.effective == len(failed)


@given(failed=st.lists(st.booleans(), min_size=1, max_size=60), weight=st.floats(0.1, 10))
def test_given_equal_weights_when_rated_then_the_interval_is_that_of_equal_runs(
    failed: list[bool], weight: float
) -> None:
    found = estimate_rate([-float(each) + 0.5 for each in failed], [weight] * len(failed))
    assert found is not None
    assert found.rate == pytest.approx(rate(sum(failed), len(failed)))
    assert found.effective == pytest.approx(len(failed))


@given(
    runs=st.lists(
        st.tuples(st.booleans(), st.floats(1e-3, 1e3)), min_size=1, max_size=40
    ),
)  # fmt: skip
def test_given_any_weights_when_rated_then_the_interval_holds_the_rate_within_zero_and_one(
    runs: list[tuple[bool, float]],
) -> None:
    weights = [weight for _, weight in runs]
    found = estimate_rate([-1.0 if failed else 1.0 for failed, _ in runs], weights)
    assert found is not None
    for each in (found.rate, found.unnormalised):
        assert 0 <= each.low <= each.rate <= each.high <= 1
        assert each.low < each.high
    share = sum(weight for failed, weight in runs if failed) / sum(weights)
    assert found.rate.rate == pytest.approx(share)
    assert 1 - 1e-9 <= found.effective <= len(runs) + 1e-9


def test_given_an_unknown_or_impossible_weight_when_rated_then_there_is_no_estimate() -> None:
    assert estimate_rate([1.0, -1.0], [1.0, None]) is None
    for weights in ([1.0], [1.0, 0.0], [1.0, float('nan')], [1.0, float('inf')]):
        with pytest.raises(ValueError, match='weight'):
            estimate_rate([1.0, -1.0], weights)
