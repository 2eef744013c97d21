"""A client of simulation_interfaces drives the graph, and not a bit of a run is changed by it.

The wheels of ROS 2 lack the package: TAXINET_SIMULATION_INTERFACES names a prefix that it is built
into (docs/ros.md). Graph and client are processes of their own, since a process finds libraries
only where it was told to as it started.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from graph_runs import files, request, run
from rclpy.task import Future

from taxinet_ros.core.pacing.timing import timing_of
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.running.node_main import spin_for

PREFIX = os.environ.get('TAXINET_SIMULATION_INTERFACES', '')
CLIENT = Path(__file__).with_name('simulation_client.py')
FEATURES = {
    'SIMULATION_STATE_GETTING', 'SIMULATION_STATE_SETTING', 'SIMULATION_RESET', 'ENTITY_CATEGORIES',
    'ENTITY_STATE_GETTING', 'ENTITY_INFO_GETTING', 'WORLD_INFO_GETTING',
}
PAUSING = {
    'SIMULATION_STATE_PAUSE', 'STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE',
    'STEP_SIMULATION_ACTION',
}
SERVICES = [
    'get_current_world', 'get_entities', 'get_entities_states', 'get_entity_info',
    'get_entity_state', 'get_simulation_state', 'get_simulator_features', 'reset_simulation',
    'set_simulation_state',
]
VAN = {
    'kind': 'vehicle', 'x_m': 730, 'y_m': -12, 'heading_deg': 90,
    'path': [{'x_m': 730, 'y_m': 12, 'speed_mps': 4}],
}
SCENE = scenario_from_human({
    'cross_track': 4.0, 'heading': -12, 'distance': 700, 'time_of_day': 9.5, 'duration': 20,
    'traffic': load_traffic([VAN, {'kind': 'cone', 'x_m': 900, 'y_m': 9}]),
})
STOPPED, PLAYING, PAUSED = 0, 1, 2
UNSUPPORTED, OK, NOT_FOUND, FAILED = 0, 1, 2, 4
ALREADY, NOT_PLAYED, NOT_PAUSED = 101, 102, 103

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(
        not PREFIX and importlib.util.find_spec('simulation_interfaces') is None,
        reason='no simulation_interfaces: TAXINET_SIMULATION_INTERFACES names no prefix',
    ),
]


def leave_with(client: subprocess.Popen[str]) -> None:
    """End this process if its client fails, whose runs would wait for it."""
    if client.wait():
        os._exit(1)


def drive(part: str, out: str) -> None:
    """Run a graph while a client has its way with it; print what it and the runs say."""
    free = part == 'free'
    options = GraphOptions(
        perception='truth', out=Path(out), timing=timing_of('', lockstep=not free, factor=1.0),
        timeouts={'answer_timeout': 1.0},
    )
    Path(out).mkdir(exist_ok=True)
    begin = Path(out, 'begin')
    with composed_graph(options) as graph:
        client = subprocess.Popen(
            [sys.executable, CLIENT, part, begin], stdout=subprocess.PIPE, text=True,
            env={**os.environ, 'ROS_DOMAIN_ID': str(graph.domain)},
        )
        threading.Thread(target=leave_with, args=[client], daemon=True).start()
        while not begin.exists():
            spin_for(graph.nodes[0].executor, Future(), 0.02)
        asked = ['played', 'stopped', 'reset', 'stepped']
        results = [
            result for name in asked[:1 if free else None]
            for result in run(graph, request(name, scenario=SCENE))
        ]
        while client.poll() is None:  # it may still ask
            spin_for(graph.nodes[0].executor, Future(), 0.02)
        said, _ = client.communicate()
    print(said, json.dumps([(one.outcome, one.last_seq) for one in results]), sep='')


def driven(part: str, out: Path) -> tuple[dict, list]:
    packages = next(Path(PREFIX).glob('lib/python3*/site-packages')) if PREFIX else ''
    paths = {
        'PYTHONPATH': [packages, *map(Path, sys.path)], 'LD_LIBRARY_PATH': [Path(PREFIX, 'lib')],
        'AMENT_PREFIX_PATH': [PREFIX],
    }
    more = {
        name: os.pathsep.join([*map(str, found), os.environ.get(name, '')])
        for name, found in paths.items()
    }
    done = subprocess.run(
        [sys.executable, __file__, part, out], capture_output=True, text=True, timeout=120,
        env={**os.environ, **more}, check=False,
    )
    assert done.returncode == 0, done.stderr
    assert 'serves simulation_interfaces: ' in done.stderr
    said, results = map(json.loads, done.stdout.splitlines()[-2:])
    return said, results


def test_given_a_client_when_it_pauses_steps_and_stops_runs_then_each_does_so_to_the_bit(tmp_path):
    said, results = driven('lockstep', tmp_path / 'driven')

    assert set(said['features']) == FEATURES | PAUSING
    assert said['offered'] == sorted([*SERVICES, 'step_simulation'])
    assert said['idle'] == STOPPED
    assert said['refused'] == [ALREADY, NOT_PLAYED, NOT_PAUSED, UNSUPPORTED]
    assert (said['nobody'], said['unpaused']) == ([], FAILED)
    assert said['world'] == 'kmwh'

    assert said['paused'] == [PAUSED, ALREADY]
    result, at_s = said['stepped']
    assert result == OK
    assert said['held'] == [PAUSED, at_s], 'time went on in a pause'
    status, result, feedback, then_s, state = said['simulated']
    assert (status, result, state) == (4, OK, PAUSED)
    assert feedback == [[1, 3], [2, 2], [3, 1], [4, 0]]
    assert then_s == pytest.approx(at_s + 0.4)
    assert said['cancelled'] == [5, FAILED]
    assert said['again'] == PAUSED
    assert said['played'] == [OK, ALREADY]
    assert said['stopped'] == [OK, STOPPED]
    assert said['reset'] == [UNSUPPORTED, UNSUPPORTED, OK]
    assert said['too many'].endswith(' of 1000 steps taken: the run ended as FAIL')
    assert [outcome for outcome, _ in results] == ['FAIL', 'INTERRUPTED', 'INTERRUPTED', 'FAIL']

    alone = GraphOptions(perception='truth', out=tmp_path / 'alone')
    with composed_graph(alone) as graph:
        run(graph, *(request(name, scenario=SCENE) for name in ('played', 'stepped')))
    for name in ('played', 'stepped'):
        assert files(tmp_path / 'driven' / name) == files(tmp_path / 'alone' / name)

    seen, moment_s = said['look'], at_s
    assert seen['entities'] == ['ego', 'vehicle_0', 'cone_1']
    assert (seen['vehicles'], seen['robots']) == (['vehicle_0'], ['ego'])
    assert (seen['tags'], seen['box'], seen['nonsense']) == (UNSUPPORTED, UNSUPPORTED, FAILED)
    assert seen['unknown'] == NOT_FOUND
    assert (seen['frame'], seen['accelerates']) == ('map', 'nan')
    assert seen['both'] == [['ego', 'vehicle_0'], True]
    assert seen['van'] == pytest.approx([730, -12 + 4 * moment_s, 4])
    assert seen['category'] == 1
    assert 'Caravan' in seen['about']


def test_given_a_free_run_then_a_pause_is_refused_and_not_offered(tmp_path):
    said, results = driven('free', tmp_path)
    assert set(said['features']) == FEATURES
    assert said['offered'] == SERVICES
    assert said['paused'] == UNSUPPORTED
    assert said['stopped'] == [OK, STOPPED]
    assert [outcome for outcome, _ in results] == ['INTERRUPTED']


if __name__ == '__main__':
    drive(*sys.argv[1:])
