"""A map must show the part of the picture that a network goes by, and no other."""

import numpy as np
import pytest

from taxinet_ros.analysis.explain.occlusion import (
    PATCH_PX,
    STRIDE_PX,
    changed_pixels,
    occlusion_map,
    patches,
)
from taxinet_ros.core.camera.camera import IMAGE_HEIGHT, IMAGE_WIDTH
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.types import NO_ESTIMATE, TrackingError

GAINS = SteeringGains()


@pytest.fixture(scope='module')
def frame():
    """Grey, with bright stripes that stand out wherever one looks."""
    image = np.full((IMAGE_HEIGHT, IMAGE_WIDTH, 3), 90, np.uint8)
    image[:, ::6] = 250
    return image


def contrast_at(rows, columns):
    """A network that goes by the contrast in one part of the picture and by nothing else."""
    def look(image):
        return TrackingError(cte_m=float(image[rows, columns].std()) / 10, he_rad=0.0)

    return look


@pytest.mark.parametrize(('rows', 'columns', 'words'), [
    (slice(10, 40), slice(20, 60), 'upper left'),
    (slice(150, 190), slice(300, 340), 'lower right'),
    (slice(85, 115), slice(160, 200), 'centre'),
])
def test_given_a_network_that_reads_one_part_then_the_map_finds_it(frame, rows, columns, words):
    found = occlusion_map(contrast_at(rows, columns), frame, GAINS)
    region, share = found.region
    assert region == words
    assert share > 0.9
    near = np.zeros((IMAGE_HEIGHT, IMAGE_WIDTH), bool)
    near[max(rows.start - PATCH_PX, 0):rows.stop + PATCH_PX,
         max(columns.start - PATCH_PX, 0):columns.stop + PATCH_PX] = True
    assert found.share(near) == pytest.approx(1.0)
    assert found.share(~near) == pytest.approx(0.0, abs=1e-9)
    peak = np.unravel_index(np.abs(found.cte_m).argmax(), found.cte_m.shape)
    assert rows.start <= peak[0] * STRIDE_PX + STRIDE_PX / 2 <= rows.stop
    assert columns.start <= peak[1] * STRIDE_PX + STRIDE_PX / 2 <= columns.stop
    # What is covered has less contrast: the estimate moves to the right, and only that estimate.
    assert found.cte_m.min() < -0.5
    assert found.cte_m.max() < 1e-9
    assert not found.he_rad.any()
    assert found.weight_rad.max() == pytest.approx(
        -found.cte_m.min() * GAINS.cte_gain_rad_per_m)


@pytest.mark.parametrize(('cte_m', 'effect'), [(0.0, 1.0), (8.4, 0.35 / 0.8), (12.0, 0.0)])
def test_given_an_estimate_at_the_intercept_limit_then_only_what_turns_counts(
    frame, cte_m, effect,
):
    """Covers move the cross-track estimate by 0.8 m; beyond 8.75 m none changes the command."""
    def look(image):
        covered = not np.array_equal(image, frame)
        return TrackingError(cte_m=cte_m + 0.8 * covered, he_rad=0.0)

    found = occlusion_map(look, frame, GAINS)
    limit_m = GAINS.max_intercept_rad / GAINS.cte_gain_rad_per_m
    assert limit_m == pytest.approx(8.75)
    assert found.cte_m.max() == pytest.approx(0.8)
    assert found.weight_rad.max() == pytest.approx(
        effect * 0.8 * GAINS.cte_gain_rad_per_m, abs=1e-12)


def test_given_a_network_that_does_not_look_then_nothing_matters(frame):
    looks = []

    def look(image):
        looks.append(image)
        return TrackingError(cte_m=1.0, he_rad=0.2)

    found = occlusion_map(look, frame, GAINS)
    assert len(looks) == patches(IMAGE_HEIGHT, IMAGE_WIDTH) + 1
    assert found.region[1] == 0
    assert not found.cte_m.any()
    assert found.lost == 0
    assert np.array_equal(looks[0], frame)
    # Every bright pixel is covered by some patch.
    bright = frame[:, ::6, 0]
    assert (np.min([covered[:, ::6, 0] for covered in looks[1:]], axis=0) < bright).all()


def test_given_two_frames_then_pixels_that_differ_in_any_colour_are_found(frame):
    other = frame.copy()
    other[3, 5, 1] += 5
    other[9, 8, 2] += 4
    assert np.argwhere(changed_pixels(frame, other)).tolist() == [[3, 5]]


def test_given_a_network_that_loses_its_answer_then_that_is_counted_and_no_change(frame):
    def look(image):
        whole = np.array_equal(image, frame)
        return TrackingError(cte_m=1.0, he_rad=0.0) if whole else NO_ESTIMATE

    found = occlusion_map(look, frame, GAINS)
    assert found.lost == patches(IMAGE_HEIGHT, IMAGE_WIDTH)
    assert not found.cte_m.any()
