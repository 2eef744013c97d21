from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymap3d.vincenty import vdist

from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.markings import Marking, Polygon, centreline_start_m, markings
from taxinet_ros.core.place.runway_frame import GeodeticPose, MapPose, runway_frame
from taxinet_ros.core.types import FOOT_M

KMWH = default_runway()


def of_kind(kind: str) -> list[Marking]:
    return [marking for marking in markings(KMWH) if marking.kind == kind]


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

    assert second - first == pytest.approx(200 * FOOT_M)
    polygon = min(of_kind('centreline'), key=lambda m: m.polygon[0][0]).polygon
    assert polygon[1][0] - polygon[0][0] == pytest.approx(120 * FOOT_M)


@pytest.mark.parametrize('kind', ['centreline', 'edge'])
def test_given_the_crossing_when_painting_then_our_stripes_are_interrupted(kind: str) -> None:
    spans = [(m.polygon[0], m.polygon[1]) for m in of_kind(kind)]
    inside = []
    for (x0, y0), (x1, _) in spans:
        clear0, clear1 = KMWH.crossings[0].clear_x(y0)
        inside.append(min(x1, clear1 + 1) - max(x0, clear0 - 1) > 2.1)

    assert len(inside) >= 4
    assert not any(inside)
    low, high = KMWH.crossings[0].clear_x(0.0)
    assert 1350 < low < 1400
    assert 1490 < high < 1530


def test_given_the_designation_when_read_then_zero_stands_left_of_four() -> None:
    near = [m.polygon for m in of_kind('designation') if m.polygon[0][0] < 1000]
    ys = [y for polygon in near for _, y in polygon]

    assert len(near) == 7
    assert min(ys) == pytest.approx(-max(ys), abs=1.2)
    # A zero is as wide at half its height on both sides; a four has its stem on the right only.
    middle = centreline_start_m(KMWH) - 70 * FOOT_M
    left = [p for p in near if max(y for _, y in p) > 0 and _covers(p, middle)]
    assert len(left) == 2


def _covers(polygon: Polygon, x_m: float) -> bool:
    xs = [x for x, _ in polygon]
    return min(xs) < x_m < max(xs)


THRESHOLD = (47.196736, -119.332917)
FAR_END = (47.212778, -119.300297)


def on_the_ground(latitude_deg: float, longitude_deg: float) -> GeodeticPose:
    return GeodeticPose(
        latitude_rad=math.radians(latitude_deg),
        longitude_rad=math.radians(longitude_deg),
        altitude_m=runway_frame(KMWH).elevation_m,
        heading_rad=math.radians(54.0),
    )


@given(
    x_m=st.floats(-100, 3100),
    y_m=st.floats(-60, 60),
    z_m=st.floats(0, 20),
    yaw_rad=st.floats(-3.1, 3.1),
)
def test_given_a_pose_when_placed_and_measured_then_it_is_the_same(
    x_m: float, y_m: float, z_m: float, yaw_rad: float
) -> None:
    there = runway_frame(KMWH).to_geodetic(MapPose(x_m=x_m, y_m=y_m, z_m=z_m, yaw_rad=yaw_rad))
    back = runway_frame(KMWH).to_map(there)

    assert back.x_m == pytest.approx(x_m, abs=1e-6)
    assert back.y_m == pytest.approx(y_m, abs=1e-6)
    assert back.z_m == pytest.approx(z_m, abs=1e-9)
    assert back.yaw_rad == pytest.approx(yaw_rad, abs=1e-9)


def test_given_the_published_end_points_when_measured_then_they_lie_on_the_x_axis() -> None:
    threshold = runway_frame(KMWH).to_map(on_the_ground(*THRESHOLD))
    far_end = runway_frame(KMWH).to_map(on_the_ground(*FAR_END))

    assert (threshold.x_m, threshold.y_m) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert far_end.y_m == pytest.approx(0.0, abs=1e-6)
    assert far_end.x_m == pytest.approx(runway_frame(KMWH).length_m, abs=1e-6)


def test_given_the_runway_when_its_length_is_taken_then_it_agrees_with_the_geodesic() -> None:
    distance_m, azimuth_deg = vdist(*THRESHOLD, *FAR_END)

    # The geodesic runs on the ellipsoid, the runway 354 m above it.
    lifted_m = float(distance_m) * (1 + 354.0 / 6.378e6)
    assert runway_frame(KMWH).length_m == pytest.approx(lifted_m, abs=0.02)
    heading = runway_frame(KMWH).to_geodetic(MapPose(x_m=0, y_m=0, z_m=0, yaw_rad=0)).heading_rad
    assert math.degrees(heading) == pytest.approx(float(azimuth_deg), abs=1e-3)


def test_given_points_off_the_centreline_when_placed_then_left_is_left() -> None:
    frame = runway_frame(KMWH)
    centre, left, turned = (
        frame.to_geodetic(MapPose(x_m=500, y_m=y_m, z_m=0, yaw_rad=yaw_rad))
        for y_m, yaw_rad in ((0, 0), (10, 0), (0, 0.3))
    )

    assert left.latitude_rad > centre.latitude_rad
    assert left.longitude_rad < centre.longitude_rad
    assert centre.heading_rad - turned.heading_rad == pytest.approx(0.3, abs=1e-6)


def test_given_both_ends_when_aligned_then_true_heading_grows_by_the_convergence() -> None:
    frame = runway_frame(KMWH)
    start = frame.to_geodetic(MapPose(x_m=0, y_m=0, z_m=0, yaw_rad=0))
    end = frame.to_geodetic(MapPose(x_m=frame.length_m, y_m=0, z_m=0, yaw_rad=0))

    convergence_rad = math.radians(FAR_END[1] - THRESHOLD[1]) * math.sin(math.radians(47.2047))
    assert convergence_rad > 4e-4
    assert end.heading_rad - start.heading_rad == pytest.approx(convergence_rad, rel=1e-2)
