"""Tracks: coordinates along straight legs and arcs, files, routes, and runs along them."""

from __future__ import annotations

import dataclasses
import json
import math
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from own_place import OWN as OWN_PLACE

from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.place.catalogue import (
    SHIPPED_PLACES,
    SHIPPED_TRACKS,
    find_place,
    find_track,
    load_place,
)
from taxinet_ros.core.place.track import Track, check_room, make_track
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.errors import UsageError

TRACKS = [
    (place, track.name) for place in SHIPPED_PLACES for track in find_place(place).tracks
]
SPIRAL = make_track(
    'spiral', 'three quarters of a turn, in three arcs', 20.0,
    ((200, 0), (400, 0), (400, 200), (100, 200), (100, 60)), (60.0, 90.0, 60.0),
)
TRACK = st.sampled_from([find_track(*one) for one in TRACKS] + [SPIRAL])
SHARE = st.floats(0, 1)


def bent(points, radii, width_m: float = 20.0) -> Track:
    track = make_track('bent', 'bent', width_m, points, radii)
    check_room(track)
    return track


@given(TRACK, SHARE, st.floats(-1, 1), st.floats(-3, 3))
def test_given_a_place_along_a_track_when_measured_then_it_is_the_same(track, share, side, he_rad):
    asked = share * track.length_m, side * track.half_width_m, he_rad
    assert track.measure(*track.pose(*asked)) == pytest.approx(asked, abs=1e-9)


@given(TRACK, SHARE, st.floats(-1, 1), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_given_a_small_step_beside_a_track_then_its_coordinates_change_as_little(
    track, share, side, dx_m, dy_m
):
    x_m, y_m, yaw_rad = track.pose(share * track.length_m, side * track.half_width_m)
    before, after = (track.measure(x_m + k * dx_m, y_m + k * dy_m, yaw_rad) for k in (0, 1))
    step_m = math.hypot(dx_m, dy_m)
    tightest_m = min(1 / abs(leg.curvature) for leg in track.legs if leg.curvature)
    # On the inner edge of a curve the way along the track is longer than the aircraft's.
    most = tightest_m / (tightest_m - track.half_width_m - 0.05)
    assert abs(after.distance_m - before.distance_m) <= most * step_m + 1e-9
    assert abs(after.cte_m - before.cte_m) <= step_m + 1e-9
    assert abs(after.he_rad - before.he_rad) <= most * step_m / tightest_m + 1e-9


@given(TRACK, SHARE, st.floats(0.1, 5))
def test_given_a_track_then_left_is_positive_and_a_nose_to_the_left_too(track, share, left_m):
    x_m, y_m, yaw_rad = track.pose(share * track.length_m)
    to_left = x_m - left_m * math.sin(yaw_rad), y_m + left_m * math.cos(yaw_rad)
    assert track.measure(*to_left, yaw_rad).cte_m == pytest.approx(left_m, abs=1e-9)
    assert track.measure(x_m, y_m, yaw_rad + 0.2).he_rad == pytest.approx(0.2, abs=1e-9)


@given(TRACK, SHARE)
def test_given_a_track_then_its_direction_turns_by_the_curvature_of_each_leg(track, share):
    distance_m = share * (track.length_m - 0.2)
    before, after = track.pose(distance_m), track.pose(distance_m + 0.1)
    assert math.dist(before[:2], after[:2]) == pytest.approx(0.1, rel=1e-4)
    bends = [
        leg.curvature for leg in track.legs
        if leg.start_m <= distance_m + 0.1 and distance_m <= leg.start_m + leg.length_m
    ]
    turn = math.remainder(after[2] - before[2], math.tau) / 0.1
    assert min(bends) - 1e-6 <= turn <= max(bends) + 1e-6


def test_given_the_shipped_tracks_then_their_legs_continue_without_a_corner_and_have_room():
    assert {'runway', *(name for _, name in TRACKS)} == set(SHIPPED_TRACKS)
    for place, name in TRACKS:
        track = find_track(place, name)
        check_room(track)
        for leg, following in pairwise(track.legs):
            end = leg.point(leg.length_m, 0.0)
            assert end == pytest.approx((following.x_m, following.y_m, following.yaw_rad))
        assert track.legs[0].curvature == track.legs[-1].curvature == 0


def test_given_a_point_before_or_beyond_a_track_then_it_goes_on_straight():
    track = bent(((0, 0), (300, 0), (300, 300)), (60.0,))
    assert track.measure(-25.0, 2.0, 0.1) == pytest.approx((-25.0, 2.0, 0.1))
    assert track.measure(296.0, 340.0, math.pi / 2) == pytest.approx(
        (track.length_m + 40.0, 4.0, 0.0)
    )
    assert track.pose(-25.0, 2.0, 0.1) == pytest.approx((-25.0, 2.0, 0.1))


def test_given_a_quarter_turn_then_its_figures_are_those_of_the_circle():
    track = bent(((0, 0), (100, 0), (100, -200)), (40.0,))
    assert track.length_m == pytest.approx(60 + 40 * math.pi / 2 + 160)
    half = track.pose(60 + 20 * math.pi / 2)
    assert half == pytest.approx((
        60 + 40 * math.sin(math.pi / 4), -40 + 40 * math.cos(math.pi / 4), -math.pi / 4,
    ))
    centre = track.measure(60, -40)
    assert abs(centre.cte_m) == pytest.approx(40)


@pytest.mark.parametrize('pose', [(0.0, 0.0, 0.0), (812.7, -7.3, 0.41), (-3.0, -0.0, -3.1)])
def test_given_the_runway_then_the_coordinates_are_those_of_the_map_to_the_bit(pose):
    track = find_track('kmwh_04', 'runway')
    assert track.measure(*pose) == track.pose(*pose) == pose
    assert (track.last_start_m, track.farthest_start_m, track.half_width_m) == (2600, 15, 15.24)


@pytest.mark.parametrize(('points', 'radii', 'why'), [
    (((0, 0), (0, 0), (300, 0)), (50.0,), 'points 1 and 2 are the same'),
    (((0, 0), (100, 0), (100, 100)), (120.0,), r'points 1 and 2 are 100.0 m, .* need 120.0 m'),
    (((0, 0), (100, 0), (100, 30), (400, 30)), (20.0, 20.0), r'2 and 3 are 30.0 m, .* 40.0 m'),
    (((0, 0), (300, 0), (0, 0)), (50.0,), r'need inf m'),
    (((0, 0), (100, 0)), (), r'is 100 m long, expected 150 m or more'),
    (((0, 0), (200, 0), (200, 200), (100, 200), (100, -200)), (40.0,) * 3, 'is nearer to what it'),
    (((0, 0), (300, 0), (300, 40), (0, 40)), (20.0, 20.0), 'is nearer to what it is at'),
])
def test_given_points_that_make_no_track_then_they_are_refused(points, radii, why):
    with pytest.raises(ValueError, match=why):
        bent(points, radii, width_m=50.0)


# ---- files and routes --------------------------------------------------------------------------

OWN = {
    **OWN_PLACE,
    'tracks': [{
        'name': 'apron', 'width_m': 15, 'radius_m': 50,
        'points_m': [[100, 0], [400, 0], [400, -300]],
    }],
    'routes': [
        {'name': 'A', 'points_m': [[500, 0], [500, 100]]},
        {'name': 'A', 'points_m': [[500, 100], [500, 200]]},
        {'name': 'B', 'points_m': [[500, 200], [800, 200]]},
        {'name': 'B', 'points_m': [[500, 200], [450, 200]], 'one_way': True},
        {'name': 'C', 'points_m': [[900, 0], [900, 9], [870, 9]]},
        {'name': 'R', 'points_m': [[0, 0], [2000, 0]], 'on_runway': True},
    ],
}


def own(folder: Path, **track: object) -> str:
    values = json.loads(json.dumps(OWN))
    values['tracks'][0] |= track
    path = folder / 'own.yaml'
    path.write_text(yaml.safe_dump(values))
    return load_place(str(path))


@pytest.mark.parametrize(('track', 'why'), [
    ({'name': 'Apron'}, 'tracks[0].name: expected a lower-case word, such as exit_left'),
    ({'name': 'runway'}, 'tracks[0].name: there is a track runway already'),
    ({'radius_m': 10}, 'tracks[0].radius_m: expected a number, 16 to'),
    ({'radius_m': [50, 50]}, 'tracks[0].radius_m: expected a list of 1 number,'),
    ({'radius_m': 350}, 'tracks[0].points_m: the track between the points 1 and 2 are 300.0 m'),
    ({'width_m': 3}, 'tracks[0].width_m: expected a number, 7.5 to 80'),
    ({'points_m': [[0, 0], [200, 0]]}, 'tracks[0].radius_m: has no effect: two points'),
    ({'painted': 'yes'}, 'tracks[0].painted: expected true or false'),
    ({'colour': 'yellow'}, 'tracks[0].colour: unknown key; known: name, title, width_m, painted'),
])
def test_given_a_bad_track_in_a_file_then_one_line_says_where(tmp_path, track, why):
    with pytest.raises(UsageError) as caught:
        own(tmp_path, **track)
    assert str(caught.value).startswith(f'{tmp_path}/own.yaml: {why}')
    assert '\n' not in str(caught.value)


def test_given_taxi_routes_then_they_are_tracks_by_their_names_in_order(tmp_path):
    place = find_place(own(tmp_path))
    assert place.track_names == ('runway', 'apron', 'A', 'B', 'C')
    track = place.track('A+B')
    assert track.pose(0)[:2] == (500, 0)
    assert track.pose(track.length_m)[:2] == pytest.approx((800, 200))
    assert {leg.curvature for leg in track.legs} == {0.0, -1 / 30}
    back = place.track('B+A')
    assert back.pose(0)[:2] == (800, 200)
    assert back.pose(back.length_m)[:2] == pytest.approx((500, 0))
    assert place.track('A').pose(0)[:2] == (500, 0), 'from the runway on'


@pytest.mark.parametrize('ys', [
    (20.0, 112.85, 207.09, 273.94, 375.59, 448.45), (20.0, 131.22, 262.36, 364.32, 462.45),
    (20.0, 84.86, 163.03, 281.22, 358.43, 465.65),
])
def test_given_a_route_whose_length_rounds_either_way_then_it_begins_at_the_runway_all_the_same(
    tmp_path, ys
):
    values = json.loads(json.dumps(OWN))
    values['routes'] = [
        {'name': 'A', 'points_m': [[500, near], [500, far]]} for near, far in pairwise(ys)
    ]
    path = tmp_path / 'own.yaml'
    path.write_text(yaml.safe_dump(values))
    assert find_place(load_place(str(path))).track('A').pose(0)[:2] == (500, 20)


def test_given_a_route_of_many_nodes_then_the_track_passes_near_them(tmp_path):
    curve = [
        [500 + 40 * math.sin(k / 10), 40 - 40 * math.cos(k / 10)] for k in range(16)
    ]
    values = json.loads(json.dumps(OWN))
    values['routes'] = [
        {'name': 'A', 'points_m': [[round(x, 2) for x in point] for point in (a, b)]}
        for a, b in pairwise([[300, 0], [400, 0.2], *curve, [540, 200]])
    ]
    path = tmp_path / 'own.yaml'
    path.write_text(yaml.safe_dump(values))
    track = find_place(load_place(str(path))).track('A')
    assert len(track.legs) < 20  # a corner for each of 18 nodes would make 35
    assert max(abs(track.measure(x, y).cte_m) for x, y in curve) < 1.0
    assert min(1 / abs(leg.curvature) for leg in track.legs if leg.curvature) >= 16


@pytest.mark.parametrize(('track', 'why'), [
    ('D', "track is 'D', not one of runway, apron, A, B, C, at own_16@"),
    ('A+apron', "track is 'A+apron', not one of runway, apron, A, B, C, at own_16@"),
    ('A+C', 'the taxi routes of these names do not meet in this order'),
    ('C', 'the turn of 90 deg at its point 2 leaves room for an arc of 9.0 m, expected 16 m'),
])
def test_given_a_track_that_a_place_has_not_then_one_line_says_so(tmp_path, track, why):
    with pytest.raises(UsageError) as caught:
        Scenario(place=own(tmp_path), track=track)
    assert why in str(caught.value)


def test_given_a_track_then_starts_have_its_length_and_width(tmp_path):
    place = own(tmp_path)
    track = find_track(place, 'apron')
    Scenario(place=place, track='apron', distance_m=track.last_start_m, cross_track_m=7.26)
    for values in ({'distance_m': track.last_start_m + 1}, {'cross_track_m': 7.5}):
        with pytest.raises(UsageError, match=r', at track apron of own_16@'):
            Scenario(place=place, track='apron', **values)
    with pytest.raises(UsageError, match="track is 'apron', not one of runway, exit_left, at kmwh"):
        scenario_from_human({'track': 'apron'})
    assert Scenario(track='') == Scenario(track='runway') == Scenario()


# ---- runs --------------------------------------------------------------------------------------

def driven(scenario: Scenario):
    steps = []
    judgement = run_closed_loop(
        scenario, make_perception('truth'), specs=[SHIPPED['phi_eventually']],
        on_step=steps.append,
    )
    return judgement, steps


@pytest.mark.parametrize(('place', 'name'), TRACKS)
def test_given_a_start_on_a_track_then_the_first_truth_is_what_was_asked(place, name):
    track = find_track(place, name)
    for share in (0.0, 0.3, 0.6, 0.9):
        start = Scenario(
            place=place, track=name, distance_m=share * track.last_start_m, cross_track_m=4.0,
            heading_rad=-0.3, duration_s=0.1,
        )
        step = driven(start)[1][0]
        assert step.sample['x'] == pytest.approx(start.distance_m, abs=0.02)
        assert step.sample['cte'] == pytest.approx(4.0, abs=0.02)
        assert step.sample['he'] == pytest.approx(-0.3, abs=0.005)


@pytest.mark.parametrize(('cte_m', 'turned_deg'), [
    (8, -30), *(
        pytest.param(*start, marks=pytest.mark.nightly)
        for start in ((-8, -30), (-8, 30), (0, 0), (8, 30))
    ),
])
@pytest.mark.parametrize(('place', 'name'), TRACKS)
def test_given_the_truth_then_the_steering_law_satisfies_phi_eventually_on_every_shipped_track(
    place, name, cte_m, turned_deg
):
    track = find_track(place, name)
    for part in range(9):
        start = Scenario(
            place=place, track=name, distance_m=part / 8 * track.last_start_m,
            cross_track_m=cte_m, heading_rad=math.radians(turned_deg),
        )
        assert driven(start)[0].satisfied, start


@pytest.mark.parametrize(('place', 'name'), TRACKS)
def test_given_a_run_along_a_track_then_it_ends_where_the_track_leads(place, name):
    track = find_track(place, name)
    bend = next(leg for leg in track.legs if leg.curvature)
    start = Scenario(place=place, track=name, distance_m=bend.start_m, duration_s=60.0)
    _, steps = driven(start)
    last = steps[-1]
    assert last.sample['x'] == pytest.approx(start.distance_m + 300, abs=5)
    assert abs(last.sample['cte']) < 0.6
    state = last.observation.state
    assert state.y_m > 50, 'far off the centreline of the runway'
    assert last.observation.truth != state.tracking_error


def test_given_wind_and_a_slope_on_a_track_then_it_is_pushed_as_on_the_runway():
    start = Scenario(track='exit_left', distance_m=400.0, wind_speed_mps=8.0, slope_fraction=0.01)
    assert driven(start)[0].satisfied
    level = dataclasses.replace(start, slope_fraction=0.0)
    assert driven(level)[1][-1].sample != driven(start)[1][-1].sample
