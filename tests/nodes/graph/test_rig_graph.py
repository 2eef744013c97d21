"""An aircraft and a camera of one's own through a whole graph, its bag, and back out of it."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import jsbsim
import numpy as np
import pytest
import yaml
from graph_runs import judged_in
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo

from taxinet_ros.bag.cdr.image import frame_of_cdr
from taxinet_ros.bag.reader import stored_messages
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.transforms import camera_transform
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.rig.catalogue import load_aircraft, load_camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph

pytestmark = pytest.mark.ros

LENS = {
    'name': 'lens', 'offset_m': [3.0, 0, 0.9], 'pitch_deg': 8, 'size_px': [322, 241],
    'field_of_view_deg': 85, 'distortion': [-0.2, 0.04, 0.001, -0.001, 0], 'noise_codes': 3,
    'exposure_ev': -0.5,
}


@pytest.fixture
def scene(tmp_path) -> Scenario:
    folder = tmp_path / 'rig'
    shutil.copytree(Path(jsbsim.__file__).parent / 'aircraft' / 'J3Cub', folder / 'J3Cub')
    (folder / 'a.yaml').write_text(yaml.safe_dump({'name': 'cub', 'model': './J3Cub'}))
    (folder / 'c.yaml').write_text(yaml.safe_dump(LENS))
    found = Scenario(
        aircraft=load_aircraft(folder / 'a.yaml'), camera=load_camera(folder / 'c.yaml'),
        cross_track_m=2.0, duration_s=1.0,
    )
    shutil.rmtree(folder)
    return found


@pytest.mark.nightly
def test_given_ones_own_aircraft_and_camera_when_a_graph_runs_then_its_bag_has_all_of_them(
    tmp_path, scene, short_request
):
    # Runs of the usual ones before and after: cameras do not stay.
    usual = Scenario(duration_s=0.2)
    requests = [
        dataclasses.replace(short_request, run_id=f'run-{number}', scenario=one)
        for number, one in enumerate((usual, scene, usual))
    ]
    options = GraphOptions(perception='taxinet', out=tmp_path, images='all')
    judged_in(composed_graph(options), *requests)
    bag = tmp_path / 'run-1'
    recording = open_recording(bag)
    assert recording.scenario == scene
    told = [
        deserialize_message(message.cdr, CameraInfo)
        for message in stored_messages(bag) if message.topic.name == '/camera/camera_info'
    ]
    assert len(told) == 11
    camera = scene.camera_model
    assert (told[5].height, told[5].width) == (241, 322)
    np.testing.assert_array_equal(np.reshape(told[5].k, (3, 3)), camera.intrinsics)
    assert list(told[5].d) == LENS['distortion']
    (static,) = [m.cdr for m in stored_messages(bag) if m.topic.name == '/tf_static']
    assert bytes(static) == camera_transform(camera) != camera_transform()
    # The loop without ROS, and the bag without its pictures, give the same ones.
    seen = []
    run_closed_loop(
        scene, make_perception('taxinet'), specs=short_request.judging.parsed_specs,
        on_step=seen.append,
    )
    pictures = [
        frame_of_cdr(message.cdr)[1] for message in stored_messages(bag)
        if message.topic.name == '/camera/image_raw'
    ]
    assert len(pictures) == len(seen) == 11
    for picture, step in zip(pictures, seen, strict=True):
        np.testing.assert_array_equal(picture, step.observation.image)
    for now in recording.observations():
        np.testing.assert_array_equal(now.image, pictures[now.seq])
    human = json.loads(json.dumps(scene.to_human()))
    assert human['aircraft'].startswith('cub@')
    assert human['camera'].startswith('lens@')
