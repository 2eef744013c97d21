from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxinet_ros.core.pixels import Reduction


def reduced_by_opencv(frame: np.ndarray, bands: list[tuple[int, int]], columns: int) -> np.ndarray:
    grey, parts = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), []
    for rows, fewer in bands:
        band, grey = grey[:rows], grey[rows:]
        parts.append(cv2.resize(band, (columns, fewer), interpolation=cv2.INTER_AREA))
    return np.vstack(parts)


# No whole number divides one side into the other: there OpenCV takes means of whole numbers.
BANDS = st.sampled_from([[(40, 40), (160, 24)], [(31, 30), (77, 20), (9, 8)], [(25, 6)]])


@settings(max_examples=60)
@given(BANDS, st.sampled_from([(360, 192), (50, 27), (31, 30)]), st.integers(0, 2**32), st.data())
def test_given_a_frame_when_reduced_then_it_is_opencvs_grey_and_area_average_to_the_bit(
    bands: list[tuple[int, int]], widths: tuple[int, int], seed: int, data: st.DataObject
) -> None:
    width, columns = widths
    height = sum(rows for rows, _ in bands)
    coarse = data.draw(st.integers(1, 40))
    blocks = np.random.default_rng(seed).integers(
        0, 256, (-(-height // coarse), -(-width // coarse), 3), dtype=np.uint8
    )
    frame = blocks.repeat(coarse, 0).repeat(coarse, 1)[:height, :width]
    frame = np.ascontiguousarray(frame)

    reduction = Reduction(height, width, bands, columns)
    wanted = reduced_by_opencv(frame, bands, columns)
    np.testing.assert_array_equal(reduction.reduce(frame), wanted)
    np.testing.assert_array_equal(reduction.reduce(frame), wanted)


@pytest.mark.parametrize(('bands', 'columns', 'reason'), [
    ([(40, 40)], 192, 'make up the frame'),
    ([(40, 41), (160, 24)], 192, 'a band is reduced'),
    ([(200, 64)], 361, 'make up the frame'),
    ([(200, 64)], 90, 'no more than a half'),
])  # fmt: skip
def test_given_proportions_that_cannot_be_when_prepared_then_it_says_which(
    bands: list[tuple[int, int]], columns: int, reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        Reduction(200, 360, bands, columns)


def test_given_a_frame_of_another_size_when_reduced_then_it_says_so() -> None:
    with pytest.raises(ValueError, match='a frame of the size'):
        Reduction(200, 360, [(200, 64)], 192).reduce(np.zeros((200, 361, 3), np.uint8))
