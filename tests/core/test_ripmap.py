from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.ripmap import build_ripmap

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


@given(st.integers(0, 4), st.integers(0, 3))
def test_given_a_level_when_the_layouts_law_is_applied_then_a_texels_middle_is_where_it_lies(
    level: int, place: int
) -> None:
    ramp = np.repeat(np.arange(0, 256, 4, dtype=np.uint8), 32 * 3).reshape(64, 32, 3)
    scale = 2.0**-level
    middle = (place + 0.5) / scale
    row = 2 * 64 + scale * (middle - 2 * 64) - 0.5

    found = build_ripmap(ramp, 5, 1)[round(row), 0, 0]
    assert row == round(row)
    assert found == pytest.approx(4 * (middle - 0.5), abs=0.5 * level)
