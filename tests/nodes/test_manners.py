"""Manners of the executables: help, words that are none, and a line on who is up and waits."""

from __future__ import annotations

import math
import re
import signal
import subprocess
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest
from graph_runs import class_of, on_own_domain, parameters, start_node
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.srv import DescribeParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter as Given
from waiting import wait_for

from taxinet_ros.cli.run.node import NODES
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.executor import NodeExecutor
from taxinet_ros.nodes.running.parameters import Usage, declare_all

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

OF_RCLPY = {'use_sim_time', 'start_type_description_service'}
def usage_of(executable: str) -> Usage:
    usage: Usage = import_module(f'taxinet_ros.nodes.{executable}').USAGE
    return usage


def ends_of(commands: dict[str, tuple[str, ...]]) -> dict[str, tuple[int, str, str]]:
    """Exit code and output of executables that were started side by side, by their label."""
    with own_domain() as domain:
        running = {
            label: start_node(name, domain, *words, stdout=subprocess.PIPE)
            for label, (name, *words) in commands.items()
        }
        said = {label: process.communicate() for label, process in running.items()}
    return {label: (process.returncode, *said[label]) for label, process in running.items()}


def test_r15_given_help_then_each_executable_tells_its_parameters_and_topics_and_leaves():
    for name, (code, told, errors) in ends_of({name: (name, '--help') for name in NODES}).items():
        assert (code, errors) == (0, ''), name
        usage = usage_of(name)
        assert told.rstrip() == usage.text
        assert told.startswith(f'usage: ros2 run taxinet_ros {name} ')
        assert max(map(len, told.splitlines())) <= 100
        for one in usage.parameters:
            assert f'  {one.name} = ' in told
        for topic in (*usage.publishes, *usage.subscribes):
            assert topic in told


def test_r15_given_an_argument_that_is_none_then_each_executable_refuses_it_in_one_line():
    found = ends_of({name: (name, '--bogus') for name in NODES})
    for name, (code, told, errors) in found.items():
        assert (code, told) == (2, ''), errors
        (line,) = errors.splitlines()
        assert line.startswith(f"error: {name}: unknown argument '--bogus'; ")


def test_r15_given_arguments_that_ros_cannot_read_then_one_line_says_so(tmp_path):
    wrong = ('--bogus', '-p x', '-r foo', '--params-file gone.yaml')
    found = ends_of({
        text: ('ground_truth_perception', '--ros-args', *text.split()) for text in wrong
    })
    for text, (code, told, errors) in found.items():
        assert (code, told) == (2, ''), errors
        (line,) = errors.splitlines()
        assert line.startswith('error: ')
        assert text.split()[-1] in line


@pytest.mark.parametrize('executable', ['simulator', 'scene_markers', 'mtl_monitor'])
def test_given_an_override_of_the_quality_of_service_then_it_is_refused_by_name(
    executable, tmp_path
):
    file = tmp_path / 'qos.yaml'
    file.write_text(
        '/**: {ros__parameters: {qos_overrides: {/clock: {publisher: {depth: 1}}}}}\n'
    )
    words = (executable, '--ros-args', '--params-file', str(file))
    code, _, errors = ends_of({'x': words})['x']
    assert code == 2, errors
    (line,) = errors.splitlines()
    assert 'parameter qos_overrides./clock.publisher.depth: the quality of service' in line


def test_given_the_truth_as_a_network_then_it_is_refused_and_the_node_for_it_is_named():
    words = ('taxinet_perception', '--ros-args', '-p', 'weights:=truth')
    code, _, errors = ends_of({'x': words})['x']
    assert code == 2, errors
    assert errors.splitlines() == [
        'error: taxinet_perception: parameter weights: truth uses no camera image; start '
        'ground_truth_perception instead'
    ]


def test_r15_given_a_graph_that_is_not_whole_then_who_is_up_says_whom_it_waits_for(tmp_path):
    """And once it has them; a Ctrl-C meanwhile is no reason for a complaint."""
    with own_domain() as domain:
        logs = {}

        def begin(name: str, *words: str) -> subprocess.Popen[str]:
            logs[name] = tmp_path / f'{name}.log'
            with logs[name].open('w') as log:
                return start_node(name, domain, *parameters(*words), stderr=log)

        def says(name: str, text: str) -> Callable[[], bool]:
            return lambda: text in logs[name].read_text()

        nodes = [
            begin('scenario_sampler', 'program:=nominal', 'set:=["duration=1"]',
                  f'out:={tmp_path}/c'),
        ]
        try:
            wait_for(says('scenario_sampler', 'waiting for: simulator'))
            nodes += [
                begin('simulator', 'ready_timeout:=600.0'),
                begin('ground_truth_perception'),
                begin('mtl_monitor'),
                begin('recorder', f'out:={tmp_path}/bags'),
            ]
            wait_for(says('simulator', 'waiting for: steering_controller'))
            nodes.append(begin('steering_controller'))
            assert nodes[0].wait() == 0, logs['scenario_sampler'].read_text()
            wait_for(says('simulator', 'no longer waiting for: '))
        finally:
            for node in nodes:
                node.send_signal(signal.SIGINT)
            codes = [node.wait() for node in nodes]
        assert codes == [0] * 6
        for name, log in logs.items():
            text = log.read_text()
            up = 'on the graph that runs' if name == 'scenario_sampler' else f'ROS domain {domain}'
            assert up in text, name
            assert not re.search('FATAL|Traceback|ERROR', text), text
        # Said when it lasts, and when it changes: not at every look.
        assert logs['simulator'].read_text().count('waiting for: ') <= 8


# Parameters ----------------------------------------------------------------------------------


@pytest.fixture(scope='module')
def described(bag: Path, tmp_path_factory) -> dict[str, list[ParameterDescriptor]]:
    """What each node tells of its own parameters."""
    given = {
        'bag_player': {'bag': str(bag)},
        'scenario_sampler': {'out': str(tmp_path_factory.mktemp('sampler') / 'c')},
        'foxglove_server': {'port': 0},
    }
    found = {}
    for name in NODES:
        with on_own_domain(SingleThreadedExecutor) as spinning:
            overrides = [Given(key, value=value) for key, value in given.get(name, {}).items()]
            node = class_of(name)(context=spinning.context, parameter_overrides=overrides)
            spinning.add(node)
            found[name] = described_by(node, spinning)
    return found


def described_by(node: Node, spinning: NodeExecutor) -> list[ParameterDescriptor]:
    """What ``ros2 param describe`` asks a node for: by the service, as anybody would."""
    asker = Node('asker', context=node.context)
    spinning.add(asker)
    client = asker.create_client(DescribeParameters, f'{node.get_name()}/describe_parameters')
    assert client.wait_for_service()
    names = [name for name in node._parameters if name not in OF_RCLPY]
    answer = client.call_async(DescribeParameters.Request(names=names))
    spinning.executor.spin_until_future_complete(answer)
    return list(answer.result().descriptors)


def test_given_a_whole_number_for_a_double_then_every_executable_takes_it():
    taken = 0
    with on_own_domain() as spinning:
        for executable in NODES:
            doubles = [
                one for one in usage_of(executable).parameters if isinstance(one.default, float)
            ]
            whole = {one.name: math.ceil(one.limits[0]) for one in doubles if one.limits}
            given = [Given(name, value=value) for name, value in whole.items()]
            node = Node('taker', context=spinning.context, parameter_overrides=given)
            found = declare_all(node, doubles)
            assert found == whole
            assert all(type(value) is float for value in found.values())
            taken += len(found)
            spinning.add(node)
    assert taken > 20


def allowed(one: ParameterDescriptor) -> str:
    """What a value may be, as the node tells it."""
    for span in (*one.floating_point_range, *one.integer_range):
        return f'{round(span.from_value, 6)}..{round(span.to_value, 6)}'
    return one.additional_constraints


@pytest.mark.parametrize('executable', NODES)
def test_given_a_node_when_its_parameters_are_described_then_its_own_list_says_the_same(
    executable, described
):
    """``ros2 param describe`` and the executable's list, which ``--help`` and the site print."""
    parameters = {one.name: one for one in usage_of(executable).parameters}
    told = {one.name: one for one in described[executable]}
    assert told.keys() == parameters.keys()
    for name in parameters:
        one = told[name]
        assert one.description == parameters[name].description
        assert one.read_only
        assert allowed(one), f'{name}: neither a range nor words'
        assert allowed(one) == parameters[name].allowed
