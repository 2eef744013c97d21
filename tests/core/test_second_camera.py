"""A second camera among the sensors: its pictures against those of a run that has it as its own."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.fork import Fork, ForkedWorld
from taxinet_ros.core.renderer import find_renderer
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.sensors import load_sensors
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.world import SimulatedWorld, _PluginWorld, _SeenWorld
from taxinet_ros.errors import UsageError
from taxinet_ros.recordings.reader import Recording
from taxinet_ros.recordings.score import ScoreOptions, make_setup
from taxinet_ros.recordings.truth import TruthSource
from taxinet_ros.registry import WORLDS, Extension
from taxinet_ros.scenes.overrides import apply_overrides, check_overrides

OTHERS = Extension(
    kind=WORLDS, name='others', target='others:Others', distribution='others', version='1',
)
RAINY = {'clouds': 'overcast', 'rain_percent': 40, 'heading_deg': 4.0, 'cross_track_m': 2.0}
LATE = {'mount': 'nose', 'rate_hz': 5, 'delay_s': 0.12, 'dropouts': [
    {'start_s': 0.4, 'length_s': 0.3}]}
MINE = {'name': 'mine', 'offset_m': [0.5, 1.0, 1.0], 'size_px': [64, 48], 'field_of_view_deg': 60}
# Starts when the aircraft, from 400 m at 5 m/s, has gone some metres.
VAN = {'kind': 'vehicle', 'x_m': 425, 'y_m': -4, 'starts_within_m': 22.5,
       'path': [{'x_m': 425, 'y_m': 30, 'speed_mps': 12}]}


def scene(camera: dict[str, Any], **human: Any) -> Scenario:
    return scenario_from_human({
        'duration_s': 1.5, 'sensors': load_sensors({'camera': camera}), **human})


def told(scenario: Scenario, make: Any = SimulatedWorld) -> dict[int, list[tuple[int, Any]]]:
    """Stamps and pictures by the step at which they arrive, in a bend."""
    world, found = make(scenario), {}
    for seq in range(world.last_seq + 1):
        measured = world.observe(picture=False).measured
        found[seq] = [(one.stamp_ns, one.image) for one in measured.camera]
        if seq < world.last_seq:
            world.advance(TaxiCommand(steering_rad=0.1, speed_mps=5.0))
    return {seq: pictures for seq, pictures in found.items() if pictures}


def test_given_a_delay_and_a_drop_out_then_pictures_arrive_when_they_should():
    found = told(scene(LATE))
    assert {seq: [stamp // 100_000_000 for stamp, _ in one] for seq, one in found.items()} == {
        2: [0], 4: [2], 10: [8], 12: [10], 14: [12]}
    assert {image.shape for one in found.values() for _, image in one} == {(400, 640, 3)}
    with pytest.raises(ValueError, match='read-only'):
        found[2][0][1][0, 0, 0] = 1
    assert told(scene({**LATE, 'loss_percent': 100})) == {}
    often = told(scene({'mount': 'nose', 'rate_hz': 15}, control_rate_hz=30))
    assert [*often] == [*range(0, 46, 2)]
    assert [one[0][0] for one in often.values()][:3] == [0, 66_666_666, 133_333_333]


@pytest.mark.one_in(2)
@pytest.mark.parametrize('mount', ['nose', 'strut', MINE, {'base': 'wing', 'dpitch_deg': 3}])
def test_given_a_mount_then_its_pictures_are_those_of_a_run_with_this_camera(mount):
    spoiled = {**RAINY, 'lens_dirt_percent': 20, 'camera_freeze_s': 1.0, 'camera_dz_m': 0.2,
               'traffic': tx.load_traffic([{'kind': 'cone', 'x_m': 430, 'y_m': 5}, VAN])}
    found = told(scene({'mount': mount, 'rate_hz': 10, 'delay_s': 0.3}, **spoiled))
    assert [*found] == [*range(3, 16)]
    text = mount if isinstance(mount, str) else json.dumps(mount)
    plain = {key: spoiled[key] for key in (*RAINY, 'traffic')}
    world = SimulatedWorld(scenario_from_human({**plain, 'camera': text, 'duration_s': 1.5}))
    for seq in range(13):
        now = world.observe()
        ((stamp_ns, image),) = found[seq + 3]
        assert stamp_ns == now.stamp_ns
        assert np.array_equal(image, now.image)
        world.advance(TaxiCommand(steering_rad=0.1, speed_mps=5.0))


def test_given_nobody_who_looks_then_nothing_is_rendered(monkeypatch):
    def render(*_: object, **__: object) -> None:
        raise AssertionError('rendered')

    monkeypatch.setattr(Camera, 'render', render)
    run = tx.run(scene(LATE), perception='truth', controller=lambda estimate, sensors: (
        0.01 * sum(one.stamp_ns > 0 for one in sensors.camera), 5.0))
    assert len(run.steps) == 16
    assert max(step.command.steering_rad for step in run.steps) == pytest.approx(0.01)
    with pytest.raises(AssertionError, match='rendered'):
        told(scene(LATE))


def test_given_a_fork_then_pictures_of_before_are_of_the_scene_before():
    before = scene(LATE)
    dark = dataclasses.replace(before, clouds='stratus')
    how = Fork(
        run_id='run', sha256='', step=9, scenario=dark, placed=None, perception='truth',
        controller='steering',
    )
    bright, changed, stormy = told(before), told(
        before, lambda one: ForkedWorld(one, how)), told(dark)
    assert [*bright] == [*changed] == [*stormy] == [2, 4, 10, 12, 14]
    for seq in (2, 4, 10):  # that of step 10 was exposed at step 8
        assert np.array_equal(changed[seq][0][1], bright[seq][0][1])
    for seq in (12, 14):
        assert np.array_equal(changed[seq][0][1], stormy[seq][0][1])
        assert not np.array_equal(changed[seq][0][1], bright[seq][0][1])


def test_given_a_file_beside_then_the_scenario_holds_the_whole_camera(tmp_path):
    (tmp_path / 'mine.yaml').write_text(json.dumps(MINE))
    (tmp_path / 's.yaml').write_text('camera: {mount: mine.yaml, rate_hz: 5}\n')
    found = scenario_from_human({'sensors': f'{tmp_path}/s.yaml'})
    (tmp_path / 'mine.yaml').unlink()
    assert found == scene({'mount': MINE, 'rate_hz': 5}, duration_s=found.duration_s)
    assert Scenario(**found.recorded()) == found
    assert found.sensor_set.camera.mount.shape == (48, 64, 3)


@pytest.mark.parametrize(('camera', 'words'), [
    ({'rate_hz': 5}, "camera: the key 'mount' is missing; expected one of wing, strut, nose"),
    ({'mount': 3, 'rate_hz': 5}, 'camera.mount: expected one of wing, strut, nose, tail, the YAML'),
    ({'mount': 'noes', 'rate_hz': 5}, "camera is 'noes', not one of.*did you mean nose"),
    ({'mount': {**MINE, 'size_px': [1, 1]}, 'rate_hz': 5}, 'size_px'),
    ({'mount': 'nose', 'rate_hz': 20}, r'camera.rate_hz is 20, not a divisor of control_rate_hz, '),
    ({'mount': 'nose', 'rate_hz': 8}, 'camera.rate_hz is 8, not a divisor'),
    ({'mount': {**MINE, 'offset_m': [0, 0, -1.5]}, 'rate_hz': 5}, 'camera mine on .* ground'),
    ({'mount': 'nose', 'rate_hz': 5, 'noise_m': 1}, 'camera.noise_m: unknown key'),
])
def test_given_a_camera_that_cannot_be_then_one_line_says_so(camera, words):
    with pytest.raises(UsageError, match=words):
        scene(camera)


def test_given_who_cannot_take_its_pictures_then_it_is_refused_by_name(tmp_path):
    (tmp_path / 'cam.py').write_text(
        'class Grey:\n    def __init__(self, scenario):\n        pass\n')
    renderer = find_renderer(f'{tmp_path}/cam.py:Grey')
    refused = r'cam\.py:Grey does not take the pictures of a second'
    for make in (lambda one: _SeenWorld(SimulatedWorld, renderer, one), renderer.check):
        with pytest.raises(UsageError, match=refused):
            make(scene(LATE))
    with pytest.raises(UsageError, match=r'others.* does not take the pictures of a second'):
        _PluginWorld(OTHERS, lambda scenario, pictures=True: None, scene(LATE))


def test_given_a_second_camera_when_set_beside_its_control_rate_then_each_is_possible(tmp_path):
    path = tmp_path / 'six.yaml'
    path.write_text('camera: {mount: nose, rate_hz: 6}\n')
    given = {'control_rate_hz': '30', 'sensors': str(path)}
    check_overrides(given)
    assert apply_overrides({}, given, 'mine').sensor_set.camera.rate_hz == 6
    with pytest.raises(UsageError, match='not a divisor of control_rate_hz'):
        apply_overrides({}, {'sensors': str(path)}, 'mine')


def test_given_a_second_camera_when_its_pictures_are_scored_then_its_mounting_counts(tmp_path):
    scenario = scene({'mount': {'base': 'wing', 'dyaw_deg': 8}, 'rate_hz': 5}, duration_s=0.4)
    bag = tx.run(scenario, perception='truth').save_bag(tmp_path / 'ours')
    for image, camera in (('', scenario.cameras[0]), ('/camera2/image_raw', scenario.cameras[1])):
        options = ScoreOptions(
            bags=(bag,), source=TruthSource(topic='/ground_truth/odom'), perception='original',
            image=image)
        assert make_setup(options, Recording(bag), scenario).rig.camera == camera
