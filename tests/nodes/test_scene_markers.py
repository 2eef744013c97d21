"""The scene for 3-D viewers says what the runway, the odometry and the camera say."""

from __future__ import annotations

import json

import numpy as np
import pytest
from graph_runs import on_own_domain, spin
from nav_msgs.msg import Odometry
from playing import playing
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from taxinet_msgs.msg import RunStatus
from visualization_msgs.msg import Marker

from taxinet_ros.bag.run.messages import odometry_cdr
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.place.catalogue import default_runway, find_place, find_track
from taxinet_ros.core.place.markings import EDGE_STRIPE_WIDTH_M, edge_stripe_y_m
from taxinet_ros.core.place.track import PAVED_BEYOND_M
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import AircraftState
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages.markers import MovingMarkers, ground_markers
from taxinet_ros.nodes.scene_markers import SceneMarkers

STEPS = 21


def state(**more: float) -> AircraftState:
    values = {
        'x_m': 700.0, 'y_m': 2.0, 'z_m': 1.5, 'roll_rad': 0.01, 'pitch_rad': 0.02, 'yaw_rad': 0.3,
        'speed_mps': 5.0, 'yaw_rate_radps': 0.0,
    }
    return AircraftState(**{**values, **more})


def odometry(at: AircraftState, stamp_ns: int) -> Odometry:
    return deserialize_message(odometry_cdr(at, stamp_ns), Odometry)


def points_of(marker) -> np.ndarray:
    return np.array([(p.x, p.y, p.z) for p in marker.points])


def test_given_the_runway_then_its_markers_have_its_size_and_its_paint_lies_on_it():
    runway = default_runway()
    pavement, crossing, paint = ground_markers(Scenario()).markers
    assert {m.header.frame_id for m in (pavement, crossing, paint)} == {'map'}
    assert (pavement.scale.x, pavement.scale.y) == (runway.length_m, runway.width_m)
    assert pavement.pose.position.x == runway.length_m / 2
    assert crossing.pose.position.x == runway.crossings[0].x_m
    points = points_of(paint)
    assert len(points) % 3 == 0
    assert points[:, 0].min() == 0
    assert points[:, 0].max() == runway.length_m
    assert np.abs(points[:, 1]).max() < runway.half_width_m
    edges = edge_stripe_y_m(runway) + EDGE_STRIPE_WIDTH_M / 2
    assert np.abs(points[:, 1]).max() == pytest.approx(edges)
    (other,) = runway.crossings
    in_crossing = np.abs(points[:, 0] - other.x_m) < other.clear_half_m - 5
    assert not in_crossing.any()


def test_given_a_track_then_its_pavement_and_its_yellow_line_are_markers_too():
    track = find_track('kmwh_04', 'exit_left')
    *_, taxiway, line = ground_markers(Scenario(track='exit_left')).markers
    corners = points_of(taxiway)[:, :2].reshape(-1, 3, 2)
    sides = corners[:, 1:] - corners[:, :1]
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]).sum() / 2
    whole_m = track.length_m + 2 * PAVED_BEYOND_M
    assert area == pytest.approx(whole_m * track.width_m, rel=1e-3)
    away = [abs(track.measure(x, y).cte_m) for x, y, _ in points_of(line)]
    assert max(away) < 1, 'on the track, or beside the centreline where it leads off'


def test_given_odometry_then_the_aircraft_is_there_in_its_size_and_draws_its_path():
    aircraft = MovingMarkers()
    for step in range(3):
        at = state(x_m=700.0 + step)
        body, path = aircraft.markers(odometry(at, step * 100_000_000)).markers
    assert body.pose.position.x == 702.0
    assert body.header.frame_id == 'map'
    assert body.header.stamp.nanosec == 200_000_000
    reach = points_of(body)
    assert np.ptp(reach[:, 1]) == pytest.approx(15.9, abs=0.1)
    assert np.ptp(reach[:, 0]) == pytest.approx(11.4, abs=0.3)
    assert np.isfinite(reach).all()
    assert points_of(path)[:, :2].tolist() == [[700.0, 2.0], [701.0, 2.0], [702.0, 2.0]]


def test_given_others_on_the_ground_then_each_is_where_it_is_at_that_time():
    scene = Scenario(traffic=load_traffic([
        {'kind': 'cone', 'x_m': 430, 'y_m': 2, 'heading_deg': 90},
        {'kind': 'vehicle', 'x_m': 450, 'y_m': -10,
         'path': [{'x_m': 450, 'y_m': 30, 'speed_mps': 10}]},
        {'kind': 'patch', 'x_m': 460, 'y_m': 0, 'length_m': 6, 'width_m': 2},
    ]))
    cone, patch = [one for one in ground_markers(scene).markers if one.ns == 'others']
    assert (cone.pose.position.x, cone.pose.position.y, cone.id) == (430, 2, 0)
    assert np.ptp(points_of(cone)[:, 2]) == pytest.approx(0.75)
    assert np.ptp(points_of(patch), axis=0) == pytest.approx([6, 2, 0])

    moving = MovingMarkers()
    assert len(moving.markers(odometry(state(), 0)).markers) == 2
    moving.change(scene)
    cleared, _, _, van = moving.markers(odometry(state(), 0)).markers
    assert cleared.action == Marker.DELETEALL
    assert (van.id, van.pose.position.y) == (1, -10)
    _, _, van = moving.markers(odometry(state(), 2_000_000_000)).markers
    assert van.pose.position.y == pytest.approx(10)
    assert van.header.stamp.sec == 2


def test_given_others_that_react_then_they_are_drawn_where_they_are_and_not_where_nobody_knows():
    scene = Scenario(traffic=load_traffic([
        {'kind': 'vehicle', 'x_m': 705, 'y_m': -10, 'stands_within_m': 10,
         'path': [{'x_m': 705, 'y_m': 30, 'speed_mps': 10}]},
        {'kind': 'vehicle', 'x_m': 450, 'y_m': -10,
         'path': [{'x_m': 450, 'y_m': 30, 'speed_mps': 10}]},
    ]))
    moving = MovingMarkers()
    moving.change(scene)
    at_m, drawn = {}, []
    for step in (*range(8), 9, 10, 0):
        *_, shy, van = moving.markers(odometry(state(), step * 100_000_000)).markers
        assert (shy.ns, shy.id, van.action) == ('others', 0, Marker.ADD)
        drawn.append(shy.action == Marker.ADD)
        at_m.setdefault(step, shy.pose.position.y)
    assert [at_m[step] for step in range(8)] == pytest.approx([-10, -9, -8, -7, -6, -6, -6, -6])
    assert drawn == [True] * 8 + [False] * 2 + [True]


def test_given_an_airport_then_its_pavements_and_lines_are_outlined():
    place = {**json.loads(find_place('bikf_10').document), 'name': 'own'}
    square = [[0, 100], [50, 100], [50, 150], [0, 150]]
    place['pavements'] = [{'surface': 'asphalt', 'outline_m': square}]
    place['lines'] = [{'style': 1, 'points_m': [[0, 50], [100, 50]]}]
    *_, pavements, lines = ground_markers(Scenario(place=json.dumps(place))).markers
    assert len(points_of(pavements)) == 8
    assert points_of(lines)[:, :2].tolist() == [[0, 50], [100, 50]]


def test_given_time_that_goes_back_then_another_path_begins():
    aircraft = MovingMarkers()
    aircraft.markers(odometry(state(), 100_000_000))
    _, path = aircraft.markers(odometry(state(x_m=10.0), 0)).markers
    assert points_of(path)[:, 0].tolist() == [10.0]


@pytest.mark.ros
def test_given_a_simulator_that_counts_its_listeners_then_an_onlooker_comes_after_the_start():
    with on_own_domain() as spinning:
        simulator = Node(interface.SIMULATOR, context=spinning.context)
        odometry, status = (
            simulator.create_publisher(topic.type, topic.name, topic.qos)
            for topic in (interface.ODOMETRY, interface.RUN_STATUS)
        )
        spinning.add(simulator)
        spinning.add(SceneMarkers(context=spinning.context))
        spin(spinning.executor, lambda: status.get_subscription_count() == 1)
        looks = iter(range(10))
        spin(spinning.executor, lambda: next(looks, None) is None)
        assert odometry.get_subscription_count() == 0
        status.publish(RunStatus(state=RunStatus.PREPARING))
        status.publish(RunStatus(state=RunStatus.RUNNING))
        spin(spinning.executor, lambda: odometry.get_subscription_count() == 1)


@pytest.mark.ros
def test_given_a_bag_that_is_played_then_the_scene_follows_it(bag):
    heard: dict[str, list] = {topic.name: [] for topic in interface.SCENE}
    with on_own_domain() as spinning:
        context, executor = spinning.context, spinning.executor
        listener = Node('listener', context=context)
        for topic in interface.SCENE:
            qos = QoSProfile(depth=100, durability=topic.qos.durability)
            listener.create_subscription(topic.type, topic.name, heard[topic.name].append, qos)
        for node in (listener, SceneMarkers(context=context)):
            spinning.add(node)
        with playing(
            context, executor, bag, rate=2.0, wait_for=['ground_truth/odom'],
            exclude=['camera/image_raw'],
        ) as player:
            assert player.play(executor) == 0
        spin(executor, lambda: len(heard['scene/aircraft']) == STEPS)
    assert len(heard['scene/runway']) == 1
    trace = open_recording(bag).columns
    path = heard['scene/aircraft'][-1].markers[1]
    assert points_of(path)[:, 1].tolist() == trace['cte_m'].tolist()
