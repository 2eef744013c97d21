"""The aircraft's own shadow: when it is in the picture, where, and how dark.

The expectation is worked out here by casting a ray from the ground towards the sun and seeing
whether it meets a part of the aircraft's outline; none of the renderer's projections is used.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from picture_samples import OPEN, at, ground_points, luminance, placed, shot
from scipy.spatial import ConvexHull

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.camera.light import sun_direction, sun_position
from taxinet_ros.core.rig.catalogue import find_aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState

Mask = NDArray[np.bool_]
OUTLINE = [part.points for part in find_aircraft('caravan').outline if part.shades]

def _planes(part: NDArray[np.float64]) -> NDArray[np.float64]:
    """Faces of a part's hull (N, 4), outward normal and offset; flat parts get a millimetre."""
    thick = np.concatenate([part, part + np.array([0, 0, 1e-3])]) if len(part) == 4 else part
    return np.unique(ConvexHull(thick).equations.round(9), axis=0)


_PARTS = [_planes(part) for part in OUTLINE]


def clock(text: str) -> float:
    hours, minutes = text.split(':')
    return int(hours) + int(minutes) / 60


def shaded(state: AircraftState, hour: float, step: int = 1) -> Mask:
    """Pixels right of the aircraft's parts whose ray from the ground to the sun meets the aircraft.

    Every ``step``-th row and column of (200, 300).
    """
    sun = sun_direction(*sun_position(Scenario().date, hour * 3600))
    points = ground_points(state)[::step, OPEN.start :: step]
    if sun[2] <= 0:
        return np.zeros(points.shape[:2], bool)
    attitude, place = placed(state)
    starts = attitude.inv().apply((points - place).reshape(-1, 3))
    towards = attitude.inv().apply(sun)
    hit = np.zeros(len(starts), bool)
    for part, planes in zip(OUTLINE, _PARTS, strict=True):
        middle = part.mean(axis=0)
        reach = np.linalg.norm(part - middle, axis=1).max() + 0.01
        away = starts - middle
        near = np.square(away).sum(axis=1) - np.square(away @ towards) < reach**2
        # The line is inside every plane from the last entry to the first exit.
        outside = starts[near] @ planes[:, :3].T + planes[:, 3]
        slope = planes[:, :3] @ towards
        with np.errstate(divide='ignore', invalid='ignore'):
            crossing = -outside / slope
        enter = np.where(slope < 0, crossing, -np.inf).max(axis=1)
        leave = np.where(slope > 0, crossing, np.inf).min(axis=1)
        hit[near] |= (enter < leave) & (leave > 0)
    return hit.reshape(points.shape[:2])


def darkened(state: AircraftState, hour: float) -> tuple[Mask, Mask]:
    """Pixels (200, 300) that the shadow changes at all, and those it darkens by half or more."""
    lit, dark = (luminance(shot(state, hour, shadows=on))[:, OPEN] for on in (False, True))
    lost = (lit - dark) / lit
    return lost > 0, lost > 0.5 * np.percentile(lost, 99.9)


def grown(mask: Mask, px: int) -> Mask:
    """A mask with a rim of so many pixels added, or taken away where negative."""
    kernel = np.ones((2 * abs(px) + 1,) * 2, np.uint8)
    change = cv2.dilate if px > 0 else cv2.erode
    return np.asarray(change(mask.astype(np.uint8), kernel) > 0)


IN_VIEW = {
    # Heading [deg]: nose to the right, along the runway, to the left. The shadow comes in from
    # below at the first time and goes with the sun, whose middle is on the horizon at 18:08.
    -30: ('13:25', '18:00'),
    0: ('12:15', '18:00'),
    30: ('10:15', '18:00'),
}


def test_given_a_clear_equinox_then_the_own_shadow_is_in_view_from_then_to_sunset() -> None:
    spans = {heading: [clock(text) for text in span] for heading, span in IN_VIEW.items()}
    near = [first + minutes / 60 for first, _ in spans.values() for minutes in (-10, 10)]
    seen = dict.fromkeys(spans, 0)
    for hour in sorted([*np.arange(6.0, 18.0), 17.75, 18.0, 18.25, *near]):
        for heading, (first, last) in spans.items():
            state = at(heading_deg=heading)
            expected = first <= hour <= last
            where = f'heading {heading}, {hour:.2f} h'
            assert shaded(state, hour, 3).any() == expected, f'by geometry: {where}'
            assert darkened(state, hour)[0].any() == expected, f'in the picture: {where}'
            seen[heading] += expected
    assert [count > 5 for count in seen.values()] == [True] * 3


@pytest.mark.parametrize(
    ('heading_deg', 'hour'),
    [(-30, 14.5), (-30, 17.25), (0, 13.75), (0, 15.0), (0, 17.25), (30, 12.0), (30, 16.5)],
)
def test_given_the_sun_behind_when_photographed_then_the_shadow_lies_where_rays_to_it_are_cut(
    heading_deg: float, hour: float
) -> None:
    state = at(heading_deg=heading_deg)
    expected = shaded(state, hour)
    _, found = darkened(state, hour)
    inside, outside = grown(expected, -1), ~grown(expected, 2)
    assert inside.sum() > 1000
    assert found[inside].mean() > 0.99
    # A strut that the sun sees edge on is still drawn a pixel wide.
    assert found[outside].sum() < 30


@pytest.mark.parametrize('hour', [14.0, 16.0])
def test_given_thicker_clouds_when_photographed_then_the_shadow_fades_until_there_is_none(
    hour: float,
) -> None:
    state = at(1200.0)
    inside = grown(shaded(state, hour), -3)
    contrast = {}
    for clouds in ('clear', 'scattered', 'cirrus', 'broken', 'overcast', 'stratus'):
        lit, dark = (
            luminance(shot(state, hour, clouds, on))[:, OPEN] for on in (False, True)
        )
        contrast[clouds] = float(1 - dark[inside].mean() / lit[inside].mean())
    assert contrast['clear'] > 0.35
    fading = [contrast[clouds] for clouds in ('clear', 'scattered', 'cirrus', 'broken')]
    assert min(first - second for first, second in pairwise(fading)) > 0.03
    assert contrast['broken'] > 0.1
    assert contrast['overcast'] == contrast['stratus'] == 0


def test_given_cloud_before_the_sun_when_photographed_then_the_penumbra_is_wider() -> None:
    state, widths = at(1200.0), {}
    for clouds in ('clear', 'scattered', 'cirrus', 'broken'):
        lit, dark = (luminance(shot(state, 15.0, clouds, on))[:, OPEN] for on in (False, True))
        share = (lit - dark) / lit
        full = np.percentile(share, 99)
        partly = (share > 0.2 * full) & (share < 0.8 * full)
        outline = cv2.Canny((255 * (share > full / 2)).astype(np.uint8), 50, 100) > 0
        widths[clouds] = partly.sum() / outline.sum()
    assert widths['clear'] > 1.2, 'its edge is soft'
    assert widths['scattered'] == pytest.approx(widths['clear'], rel=0.25)
    assert widths['cirrus'] > 1.5 * widths['clear']
    assert widths['broken'] > 1.2 * widths['cirrus']


def test_given_a_shadow_that_passes_beside_a_corner_of_the_picture_then_it_is_not_in_view():
    tilted = AircraftState(
        x_m=500.0, y_m=0.0, z_m=1.55, roll_rad=0.11735950829596825, pitch_rad=0.0968148956779738,
        yaw_rad=0.886338758312271,
        speed_mps=5.0, yaw_rate_radps=0.0,
    )
    for clock in (17.75, 18.0):
        scene = Scenario(time_of_day_s=clock * 3600, camera='nose')
        assert Camera(scene).render(tilted, 0).any()
