"""A campaign's runs by the loop: results and bags are those of the graph, to the byte."""

from __future__ import annotations

import shutil
from pathlib import Path

import jsbsim
import pytest
import yaml
from graph_runs import run_in
from own_place import OWN_PLACE
from plugins import lay_down

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.pacing.timing import AT_ONCE, Timing, parse_latency
from taxinet_ros.core.rig.catalogue import load_aircraft, load_camera
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.sensing import Schedule
from taxinet_ros.core.system import System
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.world import find_world
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.trials.audit import bag_difference, result_difference
from taxinet_ros.trials.loop_run import Loop

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[3]
SPECS = ('phi_always', 'gentle=always(abs(steering) <= 15 deg)')
LENS = {'name': 'lens', 'offset_m': [3.0, 0, 0.9], 'pitch_deg': 8, 'size_px': [322, 241],
        'field_of_view_deg': 85}
VAN = {'kind': 'vehicle', 'x_m': 430, 'y_m': -9, 'heading_deg': 90,
       'path': [{'x_m': 430, 'y_m': 9, 'speed_mps': 5}]}
FAULTS = {
    'camera_dropout': 20, 'camera_freeze': 0.3, 'lens_dirt': 15, 'lens_drops': 15,
    'exposure_jump': -1, 'loop_delay': 0.1, 'loop_jitter': 0.2, 'steering_bias': 2,
    'steering_rate_limit': 8, 'fault_onset': 0.3, 'fault_seed': 11,
}
BAD = """
class Falling:
    needs_image = False
    def __init__(self):
        self.steps = 0
    def __call__(self, truth):
        self.steps += 1
        if self.steps == 6:
            raise ValueError('fell')
        return truth.cte_m, truth.he_rad

def steep():
    steps = []
    def steer(estimate):
        steps.append(estimate)
        return (float('nan') if len(steps) == 4 else 0.0), 5.0
    return steer
"""


def request(number: int, scene: Scenario, **judging: object) -> RunRequest:
    return RunRequest(
        run_id=f'run-{number}', index=number, program='test', seed=7, scenario=scene,
        judging=Judging(**{'specs': SPECS, **judging}), participants=PARTICIPANTS,
    )


def check_same(
    asked: list[RunRequest], tmp_path: Path, *, perception: str, controller: str = 'steering',
    gains: dict[str, float] | None = None, timing: Timing = AT_ONCE, images: str = 'none',
    world: str = 'kmwh',
) -> list[RunResult]:
    """Make runs with both engines, and compare results and both files of each bag."""
    graph = GraphOptions(
        perception=perception, controller=controller, out=tmp_path / 'graph', gains=gains or {},
        timing=timing, images=images, world=world,
    )
    theirs = run_in(composed_graph(graph), *asked)
    (tmp_path / 'loop').mkdir()
    system = System(
        perception=perception, controller=controller, gains=gains or {},
        controller_sha256=check_controller(controller), timing=timing, world=world,
        world_sha256=find_world(world).fingerprint,
    )
    loop = Loop(system, tmp_path / 'loop', images)
    ours = [loop.run(one) for one in asked]
    for one, mine, other in zip(asked, ours, theirs, strict=True):
        bags = tmp_path / 'loop' / one.run_id, tmp_path / 'graph' / one.run_id
        assert bag_difference(*bags) == ''
        if mine.outcome.judged:
            assert result_difference(mine, other) == ''
        else:
            told = [(x.outcome, x.kind, x.who, x.detail, x.last_seq) for x in (mine, other)]
            assert told[0] == told[1]
        assert sorted(file.name for file in bags[0].iterdir()) == [
            'metadata.yaml', f'{one.run_id}_0.mcap'
        ]
    return ours


@pytest.mark.parametrize('images', ['none', 'failures', 'all'])
def test_given_the_shipped_network_then_every_byte_is_the_same(images, tmp_path):
    scenes = [
        Scenario(cross_track_m=2.0, duration_s=1.0),
        scenario_from_human({**FAULTS, 'cross_track': 0.5, 'duration': 1, 'time_of_day': 7.5,
                             'clouds': 'overcast', 'rain': 40}),
    ]
    results = check_same(
        [request(number, scene) for number, scene in enumerate(scenes)], tmp_path,
        perception='taxinet', images=images,
    )
    assert {result.outcome for result in results} == {Outcome.PASS, Outcome.FAIL}


@pytest.mark.filterwarnings('ignore:.* no effect, as the perception needs no picture')
def test_given_documents_wind_tracks_and_rules_then_every_byte_is_the_same(tmp_path):
    rig = tmp_path / 'rig'
    shutil.copytree(Path(jsbsim.__file__).parent / 'aircraft' / 'J3Cub', rig / 'J3Cub')
    (rig / 'a.yaml').write_text(yaml.safe_dump({'name': 'cub', 'model': './J3Cub'}))
    (rig / 'c.yaml').write_text(yaml.safe_dump(LENS))
    own = Scenario(
        aircraft=load_aircraft(rig / 'a.yaml'), camera=load_camera(rig / 'c.yaml'),
        cross_track_m=2.0, duration_s=1.0,
    )
    asked = [
        request(0, own),
        request(1, Scenario(place=OWN_PLACE, cross_track_m=20.0, duration_s=1.0)),
        request(2, Scenario(traffic=load_traffic([VAN]), duration_s=1.0),
                specs=(*SPECS, 'no_collision', 'keep_clear')),
        request(3, scenario_from_human({
            'wind_speed': 9, 'wind_direction': 300, 'gust': 3, 'gust_seed': 7,
            'runway_state': 'auto', 'speed': 7.5, 'duration': 1,
        }), stop_on=StopOn.DECIDED, bounds=('cte=-25:25',), rates=('cte=3',)),
        request(4, scenario_from_human({
            'track': 'exit_left', 'cross_track': -2.5, 'distance': 240, 'duration': 1,
        }), stop_on=StopOn.VIOLATED),
    ]
    results = check_same(asked, tmp_path, perception='truth', images='all',
                         gains={'heading_gain': 1.0})
    assert results[4].stopped_early


def test_given_latency_and_functions_of_a_file_then_every_byte_is_the_same(tmp_path):
    results = check_same(
        [request(number, Scenario(cross_track_m=2.0, duration_s=1.0)) for number in (0, 5)],
        tmp_path, perception=f'{ROOT}/examples/perception_function.py:bright_paint',
        timing=parse_latency(['perception=normal(0.15,0.05)', 'controller=uniform(0,0.2)']),
    )
    assert results[0].robustness != results[1].robustness, 'latencies are drawn for each run'


SENSING = """
class Fused:
    def __init__(self):
        self.cte_m, self.he_rad = None, 0.0
    def __call__(self, image, sensors):
        for turned in sensors.imu:
            self.he_rad += turned.yaw_rate_radps / 100
        for fix in sensors.gnss:
            self.cte_m = fix.cte_m
        return None if self.cte_m is None else (self.cte_m, self.he_rad)

def steer(estimate, sensors):
    fast = bool(sensors.wheel) and sensors.wheel[-1].speed_mps > 4.9
    steering = -0.03 * estimate.cte_m if estimate.usable else 0.0
    return steering + 1e-3 * len(sensors.gnss), 4.5 if fast else 5.0
"""
SENSORS = """
gnss: {rate_hz: 5, noise_m: 0.5, correlation_s: 3, delay_s: 0.13, loss_percent: 20}
imu: {rate_hz: 100, yaw_rate_noise_degps: 0.5, dropouts: [{start_s: 0.6, length_s: 0.35}]}
wheel: {rate_hz: 20, noise_mps: 0.1, bias_percent: 2}
"""


@pytest.mark.parametrize('images', ['none', 'all'])
def test_given_sensors_and_functions_that_ask_for_them_then_every_byte_is_the_same(
    images, tmp_path
):
    (tmp_path / 'mine.py').write_text(SENSING)
    (tmp_path / 'mine.yaml').write_text(SENSORS)
    scene = scenario_from_human({
        'cross_track_m': 2.0, 'duration_s': 2, 'sensors': f'{tmp_path}/mine.yaml',
        'gnss_dropout_start_s': 1.2, 'gnss_dropout_s': 0.4, 'fault_seed': 5,
    })
    asked = [request(0, scene), request(1, Scenario(duration_s=1.0)), request(2, scene)]
    results = check_same(
        asked, tmp_path, perception=f'{tmp_path}/mine.py:Fused',
        controller=f'{tmp_path}/mine.py:steer', images=images,
    )
    assert [result.outcome.judged for result in results] == [True, False, True]
    assert 'mine.py: Fused has a parameter sensors' in results[1].detail
    recording = open_recording(tmp_path / 'graph' / 'run-0')
    counts = recording.info.counts
    assert (counts['/wheel/twist'], counts['/imu/data']) == (41, 201 - 35)
    assert 0 < counts['/gnss/fix'] < 11 - 2
    checks = check_bag(tmp_path / 'graph' / 'run-0').checks
    assert [check.findings for check in checks] == [()] * 4
    assert recording.run.request.scenario == scene
    assert not any('gnss' in topic or 'imu' in topic for topic in open_recording(
        tmp_path / 'graph' / 'run-1').info.counts)


LOOKING = """
def look(image, sensors):
    parts = [image, *(one.image for one in sensors.camera)]
    return sum(float(one.mean()) for one in parts) / 1e3, 1e-3 * len(sensors.camera)

def steer(estimate, sensors):
    bright = sum(float(one.image[:9].mean()) for one in sensors.camera)
    return -0.03 * estimate.cte_m + 1e-4 * bright, 5.0
"""


@pytest.mark.parametrize('images', [
    'none', *(pytest.param(word, marks=pytest.mark.nightly) for word in ('failures', 'all')),
])
def test_given_a_second_camera_then_every_byte_is_the_same(images, tmp_path):
    (tmp_path / 'mine.py').write_text(LOOKING)
    (tmp_path / 'mine.yaml').write_text(
        'camera: {mount: nose, rate_hz: 5, delay_s: 0.1, loss_percent: 20}\n' + SENSORS)
    values = {**FAULTS, 'duration_s': 1.5, 'clouds': 'overcast', 'rain_percent': 30}
    scene = scenario_from_human({**values, 'sensors': f'{tmp_path}/mine.yaml'})
    alone = scenario_from_human({**values, 'sensors': 'standard'})
    never = ('never=always(cte > 99)',)
    asked = [
        request(0, scene, specs=never), request(1, alone, specs=never),
        request(2, scene, specs=never),
    ]
    results = check_same(
        asked, tmp_path, perception=f'{tmp_path}/mine.py:look',
        controller=f'{tmp_path}/mine.py:steer', images=images,
    )
    assert [result.outcome for result in results] == [Outcome.FAIL] * 3
    recordings = [open_recording(tmp_path / 'graph' / f'run-{number}') for number in range(3)]
    found = [recording.info.counts.get('/camera2/image_raw') for recording in recordings]
    schedule = Schedule(scene, scene.period_ns)
    due = sum(schedule.counts(seq)['camera2/image_raw'] for seq in range(16))
    assert 3 < due < 8
    assert found == ([due, None, due] if images != 'none' else [None] * 3)
    for number in range(3):
        checks = check_bag(tmp_path / 'graph' / f'run-{number}').checks
        assert [check.findings for check in checks] == [()] * 4


MONITORS = """
class Late:
    def __init__(self):
        self.steps = 0
    def __call__(self, seen):
        self.steps += 1
        return float(self.steps > 4 and seen.image.mean() > 0 and seen.command.speed_mps > 0)

def falls(seen):
    raise ValueError('fell')
"""


@pytest.mark.parametrize(('rate_hz', 'images'), [
    pytest.param(5, 'none', marks=pytest.mark.nightly), (20, 'all'),
    pytest.param(30, 'failures', marks=pytest.mark.nightly),
])
def test_given_another_control_rate_then_every_byte_is_the_same(rate_hz, images, tmp_path):
    (tmp_path / 'mine.py').write_text(SENSING + MONITORS)
    (tmp_path / 'mine.yaml').write_text(SENSORS)
    scene = scenario_from_human({
        **FAULTS, 'cross_track_m': 2.0, 'duration_s': 2, 'sensors': f'{tmp_path}/mine.yaml',
        'wind_speed_mps': 5, 'wind_direction_deg': 90, 'gust_mps': 1, 'control_rate_hz': rate_hz,
    })
    asked = [request(0, scene), request(1, scene, stop_on=StopOn.VIOLATED)]
    results = check_same(
        asked, tmp_path, perception=f'{tmp_path}/mine.py:Fused', images=images,
        controller=f'{tmp_path}/mine.py:steer+{tmp_path}/mine.py:Late+slow',
        timing=parse_latency(['perception=normal(0.15,0.05)']),
    )
    assert all(result.outcome.judged for result in results)
    assert results[0].last_seq == 2 * rate_hz
    folder = tmp_path / 'graph' / 'run-0'
    recording = open_recording(folder)
    assert recording.run.request.scenario == scene
    counts = recording.info.counts
    assert (counts['/taxi_command'], counts['/wheel/twist']) == (2 * rate_hz + 1, 41)
    checks = check_bag(folder).checks
    assert [check.findings for check in checks] == [()] * 4


@pytest.mark.parametrize('fallback', ['stop', 'second:taxinet'])
def test_given_a_monitor_that_switches_then_every_byte_is_the_same(fallback, tmp_path):
    (tmp_path / 'mon.py').write_text(MONITORS)
    scene = Scenario(cross_track_m=2.0, duration_s=1.5)
    (result,) = check_same(
        [request(0, scene)], tmp_path, perception='original',
        controller=f'steering+{tmp_path}/mon.py:Late+{fallback}',
    )
    assert result.outcome.judged
    folder = tmp_path / 'loop' / 'run-0'
    recorded = open_recording(folder).messages(('taxi_command',))
    commands = [message.speed for _, _, message in recorded]
    assert len(commands) == 16
    assert commands[:4] == [5.0] * 4
    assert commands[4:] == [0.0 if fallback == 'stop' else 5.0] * 12


@pytest.mark.parametrize(('perception', 'controller', 'images', 'last_seq'), [
    ('bad.py:Falling', 'steering', 'all', 5), ('truth', 'bad.py:steep', 'none', 3),
    ('truth', 'steering+mon.py:falls+stop', 'none', 0),
])
def test_given_a_function_that_fails_amid_a_run_then_both_engines_name_it_alike(
    perception, controller, images, last_seq, tmp_path, monkeypatch
):
    (tmp_path / 'bad.py').write_text(BAD)
    (tmp_path / 'mon.py').write_text(MONITORS)
    monkeypatch.chdir(tmp_path)
    (result,) = check_same(
        [request(0, Scenario(cross_track_m=2.0, duration_s=1.0))], tmp_path, images=images,
        perception=perception, controller=controller,
    )
    assert (result.outcome, result.kind, result.last_seq) == (
        Outcome.INFRA_ERROR, 'node_error', last_seq
    )
    assert result.who == ('perception' if perception != 'truth' else 'steering_controller')


PACKAGE = """
from functools import partial
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.rig.catalogue import find_aircraft
from taxinet_ros.core.world import SimulatedWorld

LIGHT = partial(SimulatedWorld, aircraft=partial(Aircraft, model=find_aircraft('c172p')))

def shaky(truth):
    return truth.cte_m + 0.1, truth.he_rad

shaky.needs_image = False

def steer(estimate):
    return -0.05 * estimate.cte_m, 5.0
"""


def test_given_parts_of_a_package_then_every_byte_is_the_same(tmp_path, monkeypatch):
    with monkeypatch.context() as installed:
        installed.syspath_prepend(str(tmp_path / 'site'))
        lay_down(
            tmp_path / 'site', 'parts-of-mine', PACKAGE, worlds='dim = LIGHT',
            perceptions='shaky = shaky', controllers='bent = steer',
        )
        check_same(
            [request(0, Scenario(cross_track_m=2.0, duration_s=1.0))], tmp_path,
            perception='shaky', controller='bent', world='dim',
        )


def test_given_a_sample_that_cannot_be_judged_then_both_engines_say_so_alike(tmp_path):
    (tmp_path / 'blind.py').write_text('def eyes(frame):\n    return None\n')
    (result,) = check_same(
        [request(0, Scenario(duration_s=0.5), specs=('always(abs(cte_estimate) <= 9)',))],
        tmp_path, perception=f'{tmp_path}/blind.py:eyes',
    )
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'invalid_run')


def test_given_an_interrupt_then_the_run_ends_at_its_next_step_and_its_bag_is_complete(tmp_path):
    loop = Loop(System(perception='truth'), tmp_path)

    def stop(seq: int) -> None:
        loop.interrupted = seq == 12

    result = loop.run(request(0, Scenario(duration_s=600.0)), stop)
    assert (result.outcome, result.last_seq) == (Outcome.INTERRUPTED, 12)
    assert (tmp_path / 'run-0' / 'metadata.yaml').is_file()
