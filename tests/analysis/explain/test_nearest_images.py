"""The nearest training images are found, and what resembles none of them is told."""

import numpy as np
import pandas as pd
import pytest

from taxinet_ros.analysis.explain.nearest_images import NearestImages, TrainingImages
from taxinet_ros.core.camera.camera import IMAGE_HEIGHT, IMAGE_WIDTH
from taxinet_ros.core.perception.network import shrink

COUNT = 200


def frame(level, seed):
    """A frame around a grey level."""
    noise = np.random.default_rng(seed).integers(0, 20, (IMAGE_HEIGHT, IMAGE_WIDTH, 3))
    return (level + noise).astype(np.uint8)


@pytest.fixture(scope='module')
def images():
    frames = [shrink(frame(60 + number // 2, number)) for number in range(COUNT)]
    return TrainingImages(
        name='set', total=COUNT, pictures=np.array(frames),
        scenes=pd.DataFrame({
            'image': [f'{number}.png' for number in range(COUNT)],
            'cte_m': np.linspace(-8, 8, COUNT), 'heading_error_deg': np.zeros(COUNT),
            'clouds': ['clear', 'overcast'] * (COUNT // 2),
        }),
    )


def test_given_an_image_of_the_set_then_it_is_its_own_nearest(images):
    found = NearestImages(images).near(
        frame(60 + 70 // 2, 70), {'cte_m': images.scenes['cte_m'][121], 'clouds': 'overcast'})
    assert len(found.by_picture) == len(found.by_scene) == 3
    assert (found.by_picture[0].row, found.by_picture[0].distance) == (70, pytest.approx(0))
    assert (found.farther_than, found.foreign) == (0.0, False)
    assert found.by_scene[0].row == 121
    assert found.by_scene[0].distance == pytest.approx(0)
    assert all(near.row % 2 for near in found.by_scene)  # of the same sky


def test_given_a_frame_like_none_then_it_is_out_of_distribution_and_its_distance_right(images):
    found = NearestImages(images).near(np.zeros((IMAGE_HEIGHT, IMAGE_WIDTH, 3), np.uint8), {})
    assert found.foreign
    assert found.farther_than == 1.0
    # The darkest images lie around grey 70; the distance is in grey levels.
    assert found.by_picture[0].distance == pytest.approx(69.5, abs=1)
    assert found.usual < 2
    distances = [near.distance for near in found.by_picture]
    assert distances == sorted(distances)


def test_given_a_frame_between_those_of_the_set_then_it_is_not_out_of_distribution(images):
    assert not NearestImages(images).near(frame(90, 12345), {}).foreign


def test_given_a_single_image_then_it_has_no_nearest_other_one(images):
    with pytest.raises(ValueError, match='no nearest other'):
        NearestImages(TrainingImages(
            name='one', total=1, pictures=images.pictures[:1], scenes=images.scenes[:1]))
