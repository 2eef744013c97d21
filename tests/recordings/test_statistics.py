"""Intervals of frames in a row hold what they promise."""

import math

import numpy as np
import pytest

from taxinet_ros.recordings.statistics import (
    LEAST_BLOCKS,
    block_mean,
    blocks_of,
    correlation_frames,
)


def alike_series(rng, count, memory):
    """A stationary autoregressive process with mean 1."""
    noise = rng.normal(size=count)
    found = np.empty(count)
    found[0] = noise[0] / math.sqrt(1 - memory**2)
    for at in range(1, count):
        found[at] = memory * found[at - 1] + noise[at]
    return 1.0 + found


@pytest.mark.parametrize('memory', [
    pytest.param(0.0, marks=pytest.mark.nightly), 0.8,
    pytest.param(0.9, marks=pytest.mark.nightly),
])
def test_given_errors_that_are_alike_then_the_interval_holds_their_mean_as_often_as_it_says(memory):
    rng = np.random.default_rng(3)
    groups = np.zeros(900, np.int64)
    held = naive = 0
    for _ in range(100):
        values = alike_series(rng, 900, memory)
        found = block_mean(values, blocks_of(values[None], groups)[0])
        held += found.low <= 1.0 <= found.high
        naive += abs(values.mean() - 1.0) <= 1.96 * values.std() / 30
    assert held >= 0.88 * 100
    assert (naive < 0.75 * 100) == (memory > 0)


def test_given_a_process_then_its_correlation_time_is_found():
    rng = np.random.default_rng(1)
    groups = np.zeros(20_000, np.int64)
    for memory in (0.0, 0.5, 0.9):
        found = correlation_frames(alike_series(rng, 20_000, memory), groups)
        assert found == pytest.approx((1 + memory) / (1 - memory), rel=0.25)
    assert correlation_frames(np.full(100, 2.0), groups[:100]) == 100


def test_given_few_blocks_then_there_is_no_interval():
    values = np.arange(8.0)
    few = block_mean(values, np.arange(8) // 2)
    assert (few.value, few.frames, few.blocks) == (3.5, 8, LEAST_BLOCKS - 1)
    assert math.isnan(few.low)
    assert math.isnan(few.high)
    enough = block_mean(values, np.arange(8))
    assert enough.low < 3.5 < enough.high
    assert block_mean(np.full(4, np.nan), np.arange(4)).frames == 0


def test_given_several_stretches_then_no_block_is_of_two():
    groups = np.repeat([0, 1, 2], [30, 50, 7])
    blocks, alike = blocks_of(alike_series(np.random.default_rng(2), 87, 0.5)[None], groups)
    assert alike > 1
    assert len(np.unique(blocks)) >= 3
    for block in np.unique(blocks):
        assert len(np.unique(groups[blocks == block])) == 1
