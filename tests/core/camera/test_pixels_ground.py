from __future__ import annotations

import functools
import math

import cv2
import numpy as np
import pytest
from ground_reference import ground_picture
from hypothesis import given, settings
from hypothesis import strategies as st
from picture_samples import at

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.camera import IMAGE_HEIGHT, IMAGE_WIDTH, intrinsics, pose
from taxinet_ros.core.camera.ground import atlas as ground
from taxinet_ros.core.camera.ground import view as ground_view
from taxinet_ros.core.camera.ground.atlas import grain_atlas, ground_atlas, ground_layout
from taxinet_ros.core.camera.ground.view import GroundView
from taxinet_ros.core.place.catalogue import default_runway, find_track
from taxinet_ros.core.place.track import Track
from taxinet_ros.core.types import AircraftState

KMWH = default_runway()
TRACK = find_track('kmwh_04', 'exit_left')
RULER = ground_view._ruler(ground_layout(KMWH))

GAIN = np.array([1.0, 0.93, 0.71])
NOTHING_HIDDEN = np.zeros(2, np.int32)


POSES = st.builds(
    at, st.floats(-300, 3400), st.floats(-220, 220), st.floats(-180, 180), st.floats(-6, 6),
    st.floats(-6, 6),
)


@functools.cache
def view(height: int, width: int) -> GroundView:
    return GroundView(ground_atlas(KMWH), grain_atlas(), GAIN, np.zeros(height, np.int32), width)


@functools.cache
def view_of_track() -> GroundView:
    hidden = np.zeros(IMAGE_HEIGHT, np.int32)
    return GroundView(
        ground_atlas(KMWH, TRACK), grain_atlas(), GAIN, hidden, IMAGE_WIDTH,
        ground_layout(KMWH, TRACK),
    )


def first_row_of_ground(sight: pixels.Sight) -> int:
    """Number of rows at the top of a picture in which no ray falls."""
    by_column, by_row = map(np.asarray, sight.fall())
    falls = (by_column + by_row[:, None] > 0).any(axis=1)
    return int(falls.argmax()) if falls.any() else len(falls)


def assert_as_written(
    subject: GroundView, state: AircraftState, size: tuple[int, int], track: Track | None = None
) -> None:
    """Every byte of the ground is that of the written rules; rows of nothing but sky stay."""
    _, to_optical, camera = pose(state)
    rays = to_optical.T @ np.linalg.inv(intrinsics())
    sight = pixels.Sight(rays, camera, *size)
    first = first_row_of_ground(sight)
    before = subject._colour[:first].copy()
    stretched = ground_view._FINER_CODES * GAIN
    wanted = ground_picture(
        atlas=ground_atlas(KMWH, track),
        grain=cv2.multiply(grain_atlas(), np.append(stretched, 1.0)),
        neutral=np.rint(ground.GRAIN_NEUTRAL * stretched).astype(np.uint8),
        sight=sight,
        camera=camera,
        dither=ground_view._dither(*size),
        layout=ground_layout(KMWH, track),
    )
    found = subject.render(rays, camera)
    np.testing.assert_array_equal(found[first:], wanted[first:])
    np.testing.assert_array_equal(found[:first], before)


@settings(max_examples=40, deadline=None)
@given(state=POSES, size=st.sampled_from([(IMAGE_HEIGHT, IMAGE_WIDTH), (150, 361), (90, 1)]))
def test_given_a_pose_when_the_ground_is_sampled_then_every_byte_is_that_of_the_written_rules(
    state: AircraftState, size: tuple[int, int]
) -> None:
    assert_as_written(view(*size), state, size)


@settings(max_examples=15, deadline=None)
@given(share=st.floats(0, 1), left=st.floats(-30, 30), turned=st.floats(-3, 3))
def test_given_a_pose_at_a_track_when_its_ground_is_sampled_then_the_same_rules_hold(
    share: float, left: float, turned: float
) -> None:
    x, y, yaw = TRACK.pose(share * TRACK.length_m, left, turned)
    seen_from = at(x, y, math.degrees(yaw), -1.0, 1.0)
    assert_as_written(view_of_track(), seen_from, (IMAGE_HEIGHT, IMAGE_WIDTH), TRACK)


@settings(max_examples=20, deadline=None)
@given(state=POSES, seed=st.integers(0, 9))
def test_given_hidden_columns_when_the_ground_is_sampled_then_they_stay_and_the_rest_is_the_same(
    state: AircraftState, seed: int
) -> None:
    _, to_optical, camera = pose(state)
    rays = to_optical.T @ np.linalg.inv(intrinsics())
    height, width = 40, 361
    hidden = np.random.default_rng(seed).integers(0, width + 1, height, dtype=np.int32)
    partly = GroundView(ground_atlas(KMWH), grain_atlas(), GAIN, hidden, width)
    found, whole = partly.render(rays, camera), view(height, width).render(rays, camera)
    is_hidden = np.arange(width)[None, :] < hidden[:, None]
    is_hidden[:first_row_of_ground(pixels.Sight(rays, camera, height, width))] = True
    np.testing.assert_array_equal(found, np.where(is_hidden[..., None], 0, whole))


@pytest.mark.parametrize('shape', [(4, 4), (1, 4, 3), (4, 1, 3), (4, 4, 4)])
def test_given_what_is_no_texture_when_a_ground_is_made_of_it_then_it_says_so(
    shape: tuple[int, ...],
) -> None:
    no_texture, dither = np.zeros(shape, np.uint8), np.ones((2, 3), np.float32)
    with pytest.raises(ValueError, match=r'a texture is \(rows, columns, 3\)'):
        pixels.Ground(no_texture, grain_atlas(), dither, RULER, (1, 1, 1), 1.0)


@pytest.mark.parametrize('shape', [(3, 3, 3), (2, 2, 3), (2, 3, 4), (6, 3)])
def test_given_a_picture_of_another_size_when_filled_then_it_says_so_and_writes_nothing(
    shape: tuple[int, ...],
) -> None:
    dither, out = np.ones((2, 3), np.float32), np.zeros(shape, np.uint8)
    textures = ground_atlas(KMWH), grain_atlas()
    small = pixels.Ground(*textures, dither, RULER, (1, 1, 1), 1.0)
    with pytest.raises(ValueError, match='of one size'):
        small.sample(out, pixels.Sight(np.eye(3), np.ones(3), 2, 3), NOTHING_HIDDEN)
    assert not out.any()


@pytest.mark.parametrize('hidden', [[0], [0, 4], [-1, 0]])
def test_given_other_columns_than_there_are_when_left_out_then_it_says_so(
    hidden: list[int],
) -> None:
    small = pixels.Ground(
        ground_atlas(KMWH), grain_atlas(), np.ones((2, 3), np.float32), RULER,
        (1, 1, 1), 1.0,
    )
    sight = pixels.Sight(np.eye(3), np.ones(3), 2, 3)
    with pytest.raises(ValueError, match='so many columns are hidden'):
        small.sample(np.zeros((2, 3, 3), np.uint8), sight, np.array(hidden, np.int32))


def test_given_a_picture_whose_rows_lie_apart_when_filled_then_it_refuses_to_fill_a_copy() -> None:
    dither = np.ones((2, 3), np.float32)
    small = pixels.Ground(
        ground_atlas(KMWH), grain_atlas(), dither, RULER, (1, 1, 1), 1.0
    )
    part = np.zeros((2, 5, 3), np.uint8)[:, :3]
    with pytest.raises(TypeError, match='incompatible function arguments'):
        small.sample(part, pixels.Sight(np.eye(3), np.ones(3), 2, 3), NOTHING_HIDDEN)
