from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.ripmap import build_ripmap, shrink_factor, to_atlas

BASE = np.random.default_rng(3).integers(0, 256, (64, 32, 3), dtype=np.uint8)


def test_given_a_texture_when_built_then_each_level_holds_its_block_means() -> None:
    atlas = build_ripmap(BASE, 5, 4)

    np.testing.assert_array_equal(atlas[:64, :32], BASE)
    for i, j in ((1, 0), (0, 1), (2, 1), (4, 3)):
        rows, columns = 64 >> i, 32 >> j
        blocks = BASE.reshape(rows, 1 << i, columns, 1 << j, 3).mean(axis=(1, 3))
        row, column = 128 - 2 * rows, 64 - 2 * columns
        level = atlas[row : row + rows, column : column + columns]
        # Every halving rounds once.
        assert np.abs(level - blocks).max() <= 0.5 * (i + j) + 0.5


@given(st.floats(2**-10, 2**20, width=32))
def test_given_a_footprint_when_choosing_a_level_then_its_texel_is_the_largest_not_above(
    footprint: float,
) -> None:
    shrink = shrink_factor(np.array([footprint], np.float32), 6)
    level = min(max(math.floor(math.log2(footprint)), 0), 5)
    assert shrink[0] == 2.0**-level


@given(st.integers(0, 4), st.integers(0, 3))
def test_given_a_level_when_a_texels_middle_is_looked_up_then_it_is_the_level_texels_middle(
    level: int, place: int
) -> None:
    width = 1 << level
    texel = np.array([(place + 0.5) * width], np.float32)
    at = to_atlas(texel, np.array([1 / width], np.float32), 64)
    assert at[0] == (128 - 128 / width) + place
