from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymap3d.vincenty import vdist

from taxinet_ros.core.frames import GeodeticPose, MapPose, kmwh_04

THRESHOLD = (47.196736, -119.332917)
FAR_END = (47.212778, -119.300297)


def on_the_ground(latitude_deg: float, longitude_deg: float) -> GeodeticPose:
    return GeodeticPose(
        latitude_rad=math.radians(latitude_deg),
        longitude_rad=math.radians(longitude_deg),
        altitude_m=kmwh_04().elevation_m,
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
    there = kmwh_04().to_geodetic(MapPose(x_m=x_m, y_m=y_m, z_m=z_m, yaw_rad=yaw_rad))
    back = kmwh_04().to_map(there)

    assert back.x_m == pytest.approx(x_m, abs=1e-6)
    assert back.y_m == pytest.approx(y_m, abs=1e-6)
    assert back.z_m == pytest.approx(z_m, abs=1e-9)
    assert back.yaw_rad == pytest.approx(yaw_rad, abs=1e-9)


def test_given_the_published_end_points_when_measured_then_they_lie_on_the_x_axis() -> None:
    threshold = kmwh_04().to_map(on_the_ground(*THRESHOLD))
    far_end = kmwh_04().to_map(on_the_ground(*FAR_END))

    assert (threshold.x_m, threshold.y_m) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert far_end.y_m == pytest.approx(0.0, abs=1e-6)
    assert far_end.x_m == pytest.approx(kmwh_04().length_m, abs=1e-6)


def test_given_the_runway_when_its_length_is_taken_then_it_agrees_with_the_geodesic() -> None:
    distance_m, azimuth_deg = vdist(*THRESHOLD, *FAR_END)

    # The geodesic runs on the ellipsoid, the runway 354 m above it.
    lifted_m = float(distance_m) * (1 + 354.0 / 6.378e6)
    assert kmwh_04().length_m == pytest.approx(lifted_m, abs=0.02)
    heading = kmwh_04().to_geodetic(MapPose(x_m=0, y_m=0, z_m=0, yaw_rad=0)).heading_rad
    assert math.degrees(heading) == pytest.approx(float(azimuth_deg), abs=1e-3)


def test_given_points_off_the_centreline_when_placed_then_left_is_north_west() -> None:
    frame = kmwh_04()
    centre = frame.to_geodetic(MapPose(x_m=500, y_m=0, z_m=0, yaw_rad=0))
    left = frame.to_geodetic(MapPose(x_m=500, y_m=10, z_m=0, yaw_rad=0))

    assert left.latitude_rad > centre.latitude_rad
    assert left.longitude_rad < centre.longitude_rad


def test_given_a_nose_to_the_left_when_placed_then_the_compass_turns_back() -> None:
    frame = kmwh_04()
    straight = frame.to_geodetic(MapPose(x_m=500, y_m=0, z_m=0, yaw_rad=0))
    left = frame.to_geodetic(MapPose(x_m=500, y_m=0, z_m=0, yaw_rad=0.3))

    assert straight.heading_rad - left.heading_rad == pytest.approx(0.3, abs=1e-6)


def test_given_both_ends_when_aligned_then_true_heading_grows_by_the_convergence() -> None:
    frame = kmwh_04()
    start = frame.to_geodetic(MapPose(x_m=0, y_m=0, z_m=0, yaw_rad=0))
    end = frame.to_geodetic(MapPose(x_m=frame.length_m, y_m=0, z_m=0, yaw_rad=0))

    convergence_rad = math.radians(FAR_END[1] - THRESHOLD[1]) * math.sin(math.radians(47.2047))
    assert convergence_rad > 4e-4
    assert end.heading_rad - start.heading_rad == pytest.approx(convergence_rad, rel=1e-2)
