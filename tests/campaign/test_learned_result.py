"""What several searches have learned, put together."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.campaign.learned_result import (
    LEARNED_NAME,
    Evidence,
    LearnedResult,
    LearnedTogether,
)
from taxinet_ros.campaign.rates import share_bounds
from taxinet_ros.campaign.samplers.registry import make_sampler
from taxinet_ros.campaign.samplers.space import Dimension
from taxinet_ros.campaign.scenes.search_space import Choice, Piece
from taxinet_ros.errors import UsageError

# Half of the starts lie in the first tenth of the runway.
DISTANCE = Choice(
    dimension=Dimension(name='distance', buckets=4), feeds=frozenset({'distance_m'}),
    pieces=(Piece(start=0.0, end=0.5, low=0.0, high=200.0),
            Piece(start=0.5, end=1.0, low=200.0, high=2000.0)),
)
CLOUDS = Choice(
    dimension=Dimension(name='clouds', weights=(2.0, 1.0)), options=('clear', 'stratus')
)


def result(seed: int, distance: tuple[float, ...] = (0.25,) * 4, **facts: object) -> LearnedResult:
    """A search that learned ``distance``, from 100 plain failures in these proportions."""
    return LearnedResult(
        facts={'program': 's_falsif', 'sampler': 'ce', 'perception': 'original', 'seed': seed,
               'runs_made': 10, **facts},
        choices=(DISTANCE, CLOUDS), probabilities={'distance': distance, 'clouds': (0.5, 0.5)},
        evidence={
            'distance': Evidence(amounts=tuple(100 * each for each in distance), squares=100.0),
            'clouds': Evidence(amounts=(50.0, 50.0), squares=100.0),
        },
    )


def together(*results: LearnedResult) -> LearnedTogether:
    return LearnedTogether(results, [Path(f'seed-{number}') for number in range(len(results))])


def test_given_a_result_when_written_then_it_reads_back_equal(tmp_path: Path) -> None:
    (tmp_path / LEARNED_NAME).write_text(result(3).to_json())
    assert LearnedResult.read(tmp_path) == result(3)


def test_given_several_then_each_bin_has_its_share_of_all_failures_and_its_interval() -> None:
    both = together(result(1, (0.1, 0.2, 0.3, 0.4)), result(2, (0.3, 0.2, 0.1, 0.4)))
    shares = both.bins(DISTANCE)
    assert [each.share for each in shares] == pytest.approx([0.2, 0.2, 0.2, 0.4])
    # Where both agree it is as of 200 plain failures, no better; else two searches say little.
    assert tuple(shares[1]) == pytest.approx((0.2, *share_bounds(40, 160, 0.025)))
    assert tuple(shares[3]) == pytest.approx((0.4, *share_bounds(80, 120, 0.025)))
    assert shares[0].low < 0.01
    assert shares[0].high > 0.9
    assert both.failures(DISTANCE) == pytest.approx(200)
    assert both.mean['distance'] == pytest.approx((0.2, 0.2, 0.2, 0.4))


def test_given_what_was_learned_then_an_interval_of_values_has_its_probability() -> None:
    both = together(result(1, (0, 0, 0, 1)), result(2, (1, 0, 0, 0)))
    assert both.within('distance', 0, 100).share == pytest.approx(0.5)
    assert both.within('distance', 1100, 2000).share == pytest.approx(0.5)
    assert both.within('distance_m', 1100, 2000) == both.within('distance', 1100, 2000)
    assert both.within('distance', 1100, 1550).share == pytest.approx(0.25)
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
    ({'seed': 1}, 'seed 1 is given twice'),
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


def test_t14_given_no_failures_or_no_weights_then_no_share_is_claimed() -> None:
    none = dataclasses.replace(result(1), evidence={
        name: Evidence(amounts=(0.0,) * bins, squares=0.0)
        for name, bins in (('distance', 4), ('clouds', 2))
    })
    assert [(each.low, each.high) for each in together(none).bins(DISTANCE)] == [(0, 1)] * 4
    assert math.isnan(together(none).bins(DISTANCE)[0].share)
    with pytest.raises(UsageError, match=r'does not say which failures .*require\[p\]'):
        together(dataclasses.replace(result(1), evidence={}))


def searched(seed: int, runs: int, fails: float) -> LearnedResult:
    """A search by cross-entropy: 98 % of the failures are in the third quarter of the distances."""
    sampler = make_sampler('ce', (DISTANCE.dimension,), seed, runs)
    chance = np.random.default_rng([seed, 7])
    amounts, squares = [0.0] * 4, 0.0
    for _ in range(runs):
        index, point = sampler.next()
        assert point[0] is not None
        bin_ = DISTANCE.dimension.bin(point[0])
        failed = chance.random() < 4 * fails * (0.98 if bin_ == 2 else 0.02 / 3)
        weight = sampler.weight(index)
        assert weight is not None
        sampler.tell(index, -1.0 if failed else 1.0)
        if failed:
            amounts[bin_] += weight
            squares += weight**2
    return LearnedResult(
        facts={'seed': seed}, choices=(DISTANCE,), probabilities=sampler.learned(),
        evidence={'distance': Evidence(amounts=tuple(amounts), squares=squares)},
    )


def test_t14_given_five_searches_then_the_interval_of_a_share_holds_the_truth() -> None:
    """The samplers' own histograms say less than half where the truth is 98 %."""
    groups = [together(*(searched(100 * group + seed, 120, 0.1) for seed in range(5)))
              for group in range(40)]
    shares = [group.bins(DISTANCE)[2] for group in groups]
    held = sum(share.low <= 0.98 <= share.high for share in shares)
    assert held >= 36
    assert np.mean([share.share for share in shares]) == pytest.approx(0.98, abs=0.01)
    assert np.mean([share.high - share.low for share in shares]) < 0.15
    assert np.mean([group.mean['distance'][2] for group in groups]) < 0.6
