"""What time of day and weather do to the picture, measured in the picture."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from picture_samples import OPEN, Picture, at, luminance, shot

from taxinet_ros.core.scenario import CLOUDS

PLACES_M = (600, 800, 1000, 1200, 1800, 2000, 2200, 2400)


def pictures(clouds: str) -> list[Picture]:
    return [shot(at(x), clouds=clouds)[:, OPEN] for x in PLACES_M]


def test_given_the_six_kinds_of_cloud_at_noon_then_each_has_a_light_of_its_own() -> None:
    # Mean luminance and contrast in display codes, and redness in per cent of blue.
    light, contrast, redness = {}, {}, {}
    for clouds in CLOUDS:
        shots = pictures(clouds)
        light[clouds] = float(np.mean([luminance(p).mean() for p in shots]))
        contrast[clouds] = float(np.mean([luminance(p).std() for p in shots]))
        redness[clouds] = float(np.mean([100 * p[..., 0].mean() / p[..., 2].mean() for p in shots]))
    falling = ('clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus')
    assert min(light[a] - light[b] for a, b in pairwise(falling)) > 2.5
    assert light['stratus'] < 0.7 * light['clear']
    apart = [
        (a, b)
        for a, b in combinations(CLOUDS, 2)
        if abs(contrast[a] - contrast[b]) > 0.5 or abs(redness[a] - redness[b]) > 0.8
    ]
    assert apart == list(combinations(CLOUDS, 2))


def test_given_single_clouds_then_light_and_shade_lie_along_the_runway_and_else_they_do_not() -> (
    None
):
    clear = [luminance(p).mean() for p in pictures('clear')]
    patches = {}
    for clouds in CLOUDS[1:]:
        shares = np.array([luminance(p).mean() for p in pictures(clouds)]) / clear
        patches[clouds] = float(shares.std())
    for clouds in ('scattered', 'broken'):
        assert patches[clouds] > 0.02
    for clouds in ('cirrus', 'overcast', 'stratus'):
        assert patches[clouds] < 0.01


EARLY, LATE = 6.5, 17 + 38 / 60
"""Hours of the same low sun, nearly 5 degrees high, in the east and in the west."""


def far_and_near(hour: float, clouds: str = 'clear') -> tuple[Picture, Picture]:
    """The far and the near runway, seen eastwards."""
    picture = shot(at(900.0, heading_deg=-37.0), hour, clouds)[:, OPEN]
    return picture[3:25], picture[120:]


def test_given_a_low_sun_ahead_then_the_far_runway_is_veiled_and_warmer_than_with_it_behind() -> (
    None
):
    (ahead, near), (behind, as_near) = far_and_near(EARLY), far_and_near(LATE)
    veil = luminance(ahead) - luminance(behind)
    assert veil.mean() > 0.05 * luminance(behind).mean()
    assert veil.min() > -1.5, 'it takes nothing away'
    red, _, blue = (ahead - behind).mean(axis=(0, 1))
    assert red > 1.3 * blue
    assert luminance(near).mean() == pytest.approx(luminance(as_near).mean(), rel=0.02)


def test_given_a_high_or_hidden_sun_then_there_is_no_glare_to_speak_of() -> None:
    low = luminance(far_and_near(EARLY)[0]).mean() / luminance(far_and_near(LATE)[0]).mean() - 1
    # 28 degrees high in the south-east and in the south-west.
    high = luminance(far_and_near(9.0)[0]).mean() / luminance(far_and_near(15.13)[0]).mean() - 1
    assert abs(high) < low / 3
    hidden = [luminance(far_and_near(hour, 'overcast')[0]).mean() for hour in (EARLY, LATE)]
    assert hidden[0] <= hidden[1]
