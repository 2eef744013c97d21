from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.pixels import Reduction

PICTURES = arrays.arrays(np.uint8, st.tuples(st.integers(1, 5), st.integers(1, 40), st.just(3)))
CODES = st.floats(-20, 300)


def kept(codes: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Shares in 255ths of codes, rounded; there are no ties."""
    return np.rint(codes.astype(int) * shares / 255).astype(np.uint8)


def codes_of(numbers: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(numbers), 0, 255).astype(np.uint8)


def sum_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.minimum(a.astype(int) + b, 255).astype(np.uint8)


@given(PICTURES, st.data())
def test_given_shares_when_rows_are_tinted_then_each_channel_of_a_row_keeps_its_share(
    picture: np.ndarray, data: st.DataObject
) -> None:
    shares = data.draw(arrays.arrays(np.float64, (len(picture), 3), elements=CODES))
    wanted = kept(picture, codes_of(shares)[:, None].astype(int))
    pixels.tint_rows(picture, shares)
    np.testing.assert_array_equal(picture, wanted)


def test_given_every_code_and_share_when_tinted_then_the_product_is_rounded_to_the_nearest() -> (
    None
):
    picture = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 256, axis=0).repeat(3, 2)
    shares = np.arange(256.0)[:, None].repeat(3, 1)
    wanted = kept(picture, shares[:, None])
    pixels.tint_rows(picture, shares)
    np.testing.assert_array_equal(picture, wanted)


@given(PICTURES, st.data())
def test_given_a_mask_when_a_part_is_tinted_then_it_loses_its_depth_and_the_rest_nothing(
    picture: np.ndarray, data: st.DataObject
) -> None:
    height, width = picture.shape[:2]
    left, depth = data.draw(st.integers(0, width - 1)), data.draw(
        st.tuples(*[st.floats(0, 1, width=32)] * 3)
    )
    mask = data.draw(arrays.arrays(np.uint8, (height, width - left)))
    # Rounded to single precision once, then to whole codes.
    share = (255 - mask[..., None].astype(np.float64) * depth).astype(np.float32)
    wanted = picture.copy()
    wanted[:, left:] = kept(picture[:, left:], np.rint(share).astype(int))
    pixels.tint_masked(picture[:, left:], mask, depth)
    np.testing.assert_array_equal(picture, wanted)


@given(PICTURES, st.data())
def test_given_a_curve_and_a_veil_when_developed_then_the_upper_rows_lie_behind_it(
    ground: np.ndarray, data: st.DataObject
) -> None:
    rows = data.draw(st.integers(0, len(ground)))
    share = data.draw(arrays.arrays(np.float64, rows, elements=CODES))
    added = data.draw(arrays.arrays(np.float64, (rows, 3), elements=CODES))
    curve = data.draw(arrays.arrays(np.uint8, 256))
    before = ground.copy()
    picture = np.empty_like(ground)
    pixels.develop(ground, curve, share, added, picture)

    np.testing.assert_array_equal(ground, before)
    np.testing.assert_array_equal(picture[rows:], curve[ground[rows:]])
    behind = kept(curve[ground[:rows]], codes_of(share)[:, None, None].astype(int))
    np.testing.assert_array_equal(picture[:rows], sum_of(behind, codes_of(added)[:, None]))


@given(PICTURES, st.data())
def test_given_a_picture_to_lay_over_a_part_when_laid_then_it_hides_its_share_and_adds_up_to_white(
    picture: np.ndarray, data: st.DataObject
) -> None:
    shape = (len(picture), data.draw(st.integers(1, picture.shape[1])), 3)
    share, added = (data.draw(arrays.arrays(np.uint8, shape)) for _ in range(2))
    wanted = picture.copy()
    part = wanted[:, : shape[1]]
    part[:] = sum_of(kept(part, share.astype(int)), added)
    pixels.lay_over(picture[:, : shape[1]], share, added)
    np.testing.assert_array_equal(picture, wanted)


@given(PICTURES, st.data())
def test_given_strengths_when_light_is_added_then_it_is_their_product_up_to_white(
    picture: np.ndarray, data: st.DataObject
) -> None:
    strengths = st.floats(0, 300, width=32)
    by_row = data.draw(arrays.arrays(np.float32, len(picture), elements=strengths))
    by_column = data.draw(
        arrays.arrays(np.float32, picture.shape[1], elements=st.floats(0, 1, width=32))
    )
    tint = (1.0, 0.84, 0.58)
    light = np.outer(by_row, by_column)[..., None] * np.array(tint, np.float32)
    wanted = sum_of(picture, codes_of(light))
    pixels.add_shine(picture, by_row, by_column, tint)
    np.testing.assert_array_equal(picture, wanted)


def test_given_a_part_of_a_picture_when_opencv_multiplies_it_by_shares_then_it_finds_the_same() -> (
    None
):
    rng = np.random.default_rng(5)
    picture = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    shares = rng.integers(0, 256, (20, 3)).astype(np.float64)
    factor = np.broadcast_to(shares[:, None].astype(np.uint8), picture.shape)
    wanted = cv2.multiply(picture, np.ascontiguousarray(factor), scale=1 / 255)
    pixels.tint_rows(picture, shares)
    np.testing.assert_array_equal(picture, wanted)

PICTURE = np.zeros((4, 6, 3), np.uint8)
NOTHING = np.zeros(0), np.zeros((0, 3))
CURVE = np.zeros(256, np.uint8)


@pytest.mark.parametrize(('call', 'reason'), [
    (lambda: pixels.tint_rows(PICTURE[..., 0], np.zeros((4, 3))), 'its pixels side by side'),
    (lambda: pixels.tint_rows(PICTURE[:, ::2], np.zeros((4, 3))), 'its pixels side by side'),
    (lambda: pixels.tint_rows(PICTURE, np.zeros((5, 3))), r'shares are \(rows, 3\)'),
    (lambda: pixels.tint_masked(PICTURE, PICTURE[:, :5, 0], (0, 0, 0)), 'as large as its part'),
    (lambda: pixels.develop(PICTURE, CURVE[:9], *NOTHING, PICTURE), '256 codes'),
    (lambda: pixels.develop(PICTURE, CURVE, *NOTHING, PICTURE[:3]), 'two pictures of one size'),
    (lambda: pixels.develop(PICTURE, CURVE, np.ones(5), np.ones((5, 3)), PICTURE), 'upper rows'),
    (lambda: pixels.lay_over(PICTURE, PICTURE[:3], PICTURE), 'as large as that'),
    (lambda: pixels.add_shine(
        PICTURE, np.ones(4, np.float32), np.ones(5, np.float32), (1, 1, 1)), 'one a column'),
])  # fmt: skip
def test_given_arrays_that_do_not_fit_when_used_then_it_says_which(call, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        call()
    assert not PICTURE.any()


def test_given_a_read_only_picture_when_changed_then_it_refuses() -> None:
    picture = PICTURE.copy()
    picture.flags.writeable = False
    with pytest.raises(ValueError, match='not writeable'):
        pixels.tint_rows(picture, np.zeros((4, 3)))


@pytest.mark.parametrize('call', [
    lambda picture: pixels.tint_rows(picture, np.zeros((4, 3))),
    lambda picture: pixels.tint_masked(picture, PICTURE[..., 0].copy(), (1, 1, 1)),
    lambda picture: pixels.develop(PICTURE, CURVE, *NOTHING, picture),
    lambda picture: pixels.lay_over(picture, PICTURE, PICTURE),
    lambda picture: pixels.add_shine(
        picture, np.ones(4, np.float32), np.ones(6, np.float32), (1, 1, 1)),
])  # fmt: skip
def test_given_a_picture_of_another_kind_then_it_refuses_to_change_a_copy(call) -> None:
    with pytest.raises(TypeError, match='incompatible function arguments'):
        call(PICTURE.astype(np.int8))


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
