from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from network_samples import frame
from numpy.typing import NDArray
from onnx_samples import described, our_scaling, shrunk

from taxinet_ros.core.network import normalise
from taxinet_ros.core.onnx_picture import prepare
from taxinet_ros.core.onnx_sidecar import parse_sidecar

WHOLE: dict[str, Any] = {'input.height': 200, 'input.width': 360, 'scaling.divide_by': 1}


def prepared(image: NDArray[np.uint8], changes: dict[str, Any]) -> NDArray[np.float32]:
    """What the network gets; a dictionary of everything that differs from the plain choice."""
    data = yaml.safe_dump(described(changes)).encode()
    return prepare(image, parse_sidecar(Path('net.yaml'), data))


def smooth() -> NDArray[np.uint8]:
    """A frame whose pixels all differ a little, as those of a runway do."""
    rows, columns = np.mgrid[:200, :360]
    return np.stack([rows, columns / 2, 255 - rows], axis=2).astype(np.uint8)


def test_given_our_own_networks_scaling_when_prepared_then_its_input_is_ours() -> None:
    for image in (frame(), smooth()):
        ours = normalise(shrunk(image)[np.newaxis])
        theirs = prepared(image, our_scaling())
        assert theirs.shape == ours.shape
        assert ours.std() > 0.05
        np.testing.assert_allclose(theirs, ours, atol=1e-5)


@pytest.mark.parametrize('divide_by', [1, 255])
def test_given_standardise_when_prepared_then_mean_nought_and_deviation_one(divide_by: int) -> None:
    changes = {'scaling.per_image': 'standardise', 'scaling.divide_by': divide_by}
    levels = prepared(smooth(), changes)
    assert levels.dtype == np.float32
    assert abs(levels.mean()) < 1e-5
    assert levels.std() == pytest.approx(1)
    assert not prepared(np.full((200, 360, 3), 77, np.uint8), changes).any()


def test_given_faint_contrast_when_standardised_then_it_is_not_blown_up() -> None:
    image = np.full((200, 360, 3), 77, np.uint8)
    image[:100] = 78
    changes = {**WHOLE, 'scaling.divide_by': 255, 'scaling.per_image': 'standardise'}
    assert np.abs(prepared(image, changes)).max() == pytest.approx(0.5, abs=1e-4)


def test_given_centre_when_prepared_then_only_the_mean_is_taken_out() -> None:
    plain = prepared(smooth(), {})
    centred = prepared(smooth(), {'scaling.per_image': 'centre'})
    np.testing.assert_allclose(centred, plain - plain.mean(), atol=1e-6)


def test_given_layouts_and_colours_when_prepared_then_the_same_pixels_in_their_order() -> None:
    image = frame()
    rgb = prepared(image, {**WHOLE, 'input.colour': 'rgb', 'input.layout': 'nhwc'})
    assert np.array_equal(rgb[0], image)
    planes = prepared(image, {**WHOLE, 'input.colour': 'rgb'})
    assert np.array_equal(planes[0], image.transpose(2, 0, 1))
    bgr = prepared(image, {**WHOLE, 'input.colour': 'bgr', 'input.layout': 'nhwc'})
    assert np.array_equal(bgr[0], image[..., ::-1])
    grey = prepared(image, WHOLE)
    flat = prepared(image, {**WHOLE, 'input.layout': 'flat'})
    assert np.array_equal(flat[0], grey.ravel())
    assert np.abs(grey[0, 0] - image @ (0.299, 0.587, 0.114)).max() < 1


def test_given_a_crop_when_prepared_then_only_those_pixels_are_left() -> None:
    image = frame()
    cut = prepared(image, {
        'input.crop': [50, 10, 110, 45], 'input.height': 35, 'input.width': 60,
        'input.colour': 'rgb', 'input.layout': 'nhwc', 'scaling.divide_by': 1,
    })
    assert np.array_equal(cut[0], image[10:45, 50:110])


def test_given_area_and_nearest_when_shrunk_then_means_or_single_pixels() -> None:
    image = frame()
    changes = {'input.height': 50, 'input.width': 90, 'scaling.divide_by': 1,
               'input.colour': 'rgb', 'input.layout': 'nhwc'}
    means = image.reshape(50, 4, 90, 4, 3).mean(axis=(1, 3))
    assert np.abs(prepared(image, changes)[0] - means).max() <= 0.5
    picked = prepared(image, {**changes, 'input.resize': 'nearest'})
    assert np.array_equal(picked[0], image[::4, ::4])
    smoothed = [prepared(image, {**changes, 'input.resize': word}) for word in ('linear', 'cubic')]
    assert not np.array_equal(*smoothed)


@pytest.mark.parametrize('keep', [1, 7, 16])
def test_given_brightest_when_prepared_then_each_square_is_the_mean_of_those(keep: int) -> None:
    image = frame()
    got = prepared(image, {
        'input.crop': [4, 8, 28, 24], 'input.height': 4, 'input.width': 6, 'input.layout': 'nhwc',
        'input.colour': 'rgb', 'scaling.divide_by': 1,
        'input.brightest': {'block': 4, 'keep': keep},
    })[0]
    for row, column, channel in np.ndindex(4, 6, 3):
        top, left = 8 + 4 * row, 4 + 4 * column
        square = np.sort(image[top:top + 4, left:left + 4, channel], axis=None)
        assert got[row, column, channel] == pytest.approx(square[-keep:].mean())
    assert got.std() > 0


def test_given_mean_std_and_clip_when_prepared_then_each_channel_has_its_own() -> None:
    image = frame()
    changes = {**WHOLE, 'input.colour': 'rgb', 'scaling.divide_by': 255,
               'scaling.mean': [0.5, 0.4, 0.3], 'scaling.std': [0.1, 0.2, 0.5]}
    expected = (image / 255 - (0.5, 0.4, 0.3)) / (0.1, 0.2, 0.5)
    np.testing.assert_allclose(prepared(image, changes)[0].transpose(1, 2, 0), expected, atol=1e-5)
    clipped = prepared(image, {**changes, 'scaling.clip': [-1, 0.5]})
    np.testing.assert_allclose(
        clipped[0].transpose(1, 2, 0), expected.clip(-1, 0.5), atol=1e-5)
    assert (clipped.min(), clipped.max()) == (-1, 0.5)


def test_given_the_tiny_network_of_the_manual_when_prepared_then_half_is_the_mean() -> None:
    tiny = prepared(smooth(), {
        'input.crop': [55, 5, 360, 135], 'input.height': 8, 'input.width': 16,
        'input.brightest': {'block': 16, 'keep': 16}, 'scaling.per_image': 'centre',
        'scaling.mean': [-0.5], 'scaling.std': [1], 'scaling.clip': [0, 1],
    })
    assert tiny.shape == (1, 1, 8, 16)
    assert tiny.mean() == pytest.approx(0.5, abs=1e-5)
    assert 0 <= tiny.min() < tiny.max() <= 1


def test_given_a_view_of_a_frame_when_prepared_then_it_is_left_alone() -> None:
    image = frame()[:, ::-1]
    before = image.copy()
    got = prepared(image, {**WHOLE, 'input.colour': 'rgb', 'input.layout': 'nhwc'})
    assert np.array_equal(got[0], before)
    assert np.array_equal(image, before)
