from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxinet_ros.training import augment as module
from taxinet_ros.training.augment import augment

PICTURES = np.random.default_rng(5).integers(0, 256, (12, 16, 32), np.uint8)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32), level=st.integers(0, 255), count=st.integers(0, 5))
def test_given_flat_pictures_when_augmented_then_the_mean_stays_within_the_stated_limits(
    seed: int, level: int, count: int
) -> None:
    flat = np.full((count, 64, 128), level, np.uint8)
    changed = augment(flat, np.random.default_rng(seed))
    assert (changed.shape, changed.dtype) == (flat.shape, np.uint8)
    gain, gamma, offset = module.GAIN, module.GAMMA, module.OFFSET
    share = level / 255
    low = np.clip(255 * gain[0] * share ** gamma[1] + offset[0], 0, 255)
    high = np.clip(255 * gain[1] * share ** gamma[0] + offset[1], 0, 255)
    # Where noise is cut off at black or white the mean shifts by less than its deviation.
    slack = module.NOISE[1]
    assert all(low - slack <= picture.mean() <= high + slack for picture in changed)


def test_given_a_generator_state_when_augmented_again_then_the_pictures_are_the_same() -> None:
    before = PICTURES.copy()
    once, again, other = (augment(PICTURES, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(once, again)
    assert not np.array_equal(once, other)
    assert np.array_equal(PICTURES, before)


def test_given_one_picture_many_times_when_augmented_then_every_copy_differs() -> None:
    copies = np.repeat(PICTURES[:1], 8, axis=0)
    changed = augment(copies, np.random.default_rng(1))
    assert len({picture.tobytes() for picture in changed}) == 8


def test_given_no_change_allowed_when_augmented_then_the_pictures_are_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in (('GAIN', 1), ('GAMMA', 1), ('OFFSET', 0), ('NOISE', 0)):
        monkeypatch.setattr(module, name, (value, value))
    monkeypatch.setattr(module, 'BLURRED', 0.0)
    assert np.array_equal(augment(PICTURES, np.random.default_rng(1)), PICTURES)


def test_given_a_bright_line_when_augmented_then_it_stays_in_its_place() -> None:
    pictures = np.full((40, 64, 128), 60, np.uint8)
    pictures[:, :, 70] = 200
    changed = augment(pictures, np.random.default_rng(3))
    assert set(changed.mean(axis=1).argmax(axis=1)) == {70}
