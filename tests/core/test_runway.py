from __future__ import annotations

import math

import numpy as np
import pymap3d
import pytest

from taxinet_ros.core import runway


def of_kind(kind: str) -> list[runway.Marking]:
    return [marking for marking in runway.markings() if marking.kind == kind]


def test_given_the_end_points_when_measured_on_the_ellipsoid_then_length_and_bearing_agree() -> (
    None
):
    east, north, _ = pymap3d.geodetic2enu(
        runway.END_LAT_DEG,
        runway.END_LON_DEG,
        0.0,
        runway.THRESHOLD_LAT_DEG,
        runway.THRESHOLD_LON_DEG,
        0.0,
    )
    # The published length is that of a great circle on a sphere, 0.2 % short here.
    assert math.hypot(east, north) == pytest.approx(runway.LENGTH_M, rel=3e-3)
    assert math.degrees(math.atan2(east, north)) == pytest.approx(
        math.degrees(runway.BEARING_RAD), abs=0.2
    )


def test_given_all_markings_when_listed_then_they_lie_on_the_runway() -> None:
    corners = np.array([corner for m in runway.markings() for corner in m.polygon])

    assert len(runway.markings()) > 100
    assert corners[:, 0].min() >= 0
    assert corners[:, 0].max() <= runway.LENGTH_M
    assert np.abs(corners[:, 1]).max() <= runway.HALF_WIDTH_M


def test_given_the_threshold_when_counted_then_eight_stripes_an_end_of_the_circulars_size() -> None:
    stripes = of_kind('threshold')

    assert len(stripes) == 16
    sizes = {
        (round(abs(p[1][0] - p[0][0]), 2), round(abs(p[2][1] - p[1][1]), 2))
        for p in (stripe.polygon for stripe in stripes)
    }
    assert sizes == {(45.72, 1.75)}


def test_given_the_centreline_when_measured_then_stripes_and_gaps_are_120_and_80_feet() -> None:
    starts = sorted(min(x for x, _ in m.polygon) for m in of_kind('centreline'))
    first, second = starts[:2]

    assert second - first == pytest.approx(200 * runway.FOOT_M)
    polygon = min(of_kind('centreline'), key=lambda m: m.polygon[0][0]).polygon
    assert polygon[1][0] - polygon[0][0] == pytest.approx(120 * runway.FOOT_M)


@pytest.mark.parametrize('kind', ['centreline', 'edge'])
def test_given_the_crossing_when_painting_then_our_stripes_are_interrupted(kind: str) -> None:
    spans = [(m.polygon[0], m.polygon[1]) for m in of_kind(kind)]
    inside = []
    for (x0, y0), (x1, _) in spans:
        clear0, clear1 = runway.crossing_clear_x(y0)
        inside.append(min(x1, clear1 + 1) - max(x0, clear0 - 1) > 2.1)

    assert len(inside) >= 4
    assert not any(inside)
    low, high = runway.crossing_clear_x(0.0)
    assert 1350 < low < 1400
    assert 1490 < high < 1530


def test_given_the_designation_when_read_then_zero_stands_left_of_four() -> None:
    near = [m.polygon for m in of_kind('designation') if m.polygon[0][0] < 1000]
    ys = [y for polygon in near for _, y in polygon]

    assert len(near) == 7
    assert min(ys) == pytest.approx(-max(ys), abs=1.2)
    # A zero is as wide at half its height on both sides; a four has its stem on the right only.
    middle = runway.CENTRELINE_START_M - 70 * runway.FOOT_M
    left = [p for p in near if max(y for _, y in p) > 0 and _covers(p, middle)]
    assert len(left) == 2


def _covers(polygon: runway.Polygon, x_m: float) -> bool:
    xs = [x for x, _ in polygon]
    return min(xs) < x_m < max(xs)
