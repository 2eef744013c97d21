"""The launch file: what it starts for which word, what it refuses, and what it ends with.

What it decides is tested without launch, which does not come as a wheel; what ``ros2 launch`` makes
of it where launch and launch_ros are installed.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.graph.launch_plan import (
    ARGUMENTS,
    Ending,
    NodePlan,
    check_names,
    environment,
    namespace,
    parameter_file,
    plan,
)
from taxinet_ros.nodes.running.domain import own_domain

REPOSITORY = Path(__file__).parents[3]
FILE = REPOSITORY / 'launch' / 'taxinet.launch.py'
PERCEPTION = REPOSITORY / 'examples/my_perception_package/my_perception_package/perception.py'
NODES = Path(sys.prefix, 'lib', 'taxinet_ros')
SERVICE = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
service = LaunchService(argv=sys.argv[2:])
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(
    PythonLaunchDescriptionSource(sys.argv[1]),
    launch_arguments=[word.split(':=', 1) for word in sys.argv[2:]],
)]))
sys.exit(service.run())
"""
SHORT = '/**/scenario_sampler: {ros__parameters: {set: ["duration=1"]}}'

with_launch = pytest.mark.skipif(
    importlib.util.find_spec('launch_ros') is None,
    reason='launch_ros is not installed, and does not come as a wheel',
)


def test_given_the_docs_then_their_table_of_launch_arguments_is_that_of_the_launch_file():
    section = (REPOSITORY / 'docs' / 'ros.md').read_text().partition('\n## Launch\n')[2]
    rows = [line for line in section.partition('\n## ')[0].splitlines() if line.startswith('| `')]
    assert rows == [
        f'| `{name}` | {default} | {text} |' for name, (default, text) in ARGUMENTS.items()
    ]


def words(**given: str) -> dict[str, str]:
    return {name: given.get(name, default) for name, (default, _) in ARGUMENTS.items()}


def planned(**given: str) -> dict[str, NodePlan]:
    return {node.name: node for node in plan(words(**given))}


def test_r11_given_no_word_then_every_node_of_the_graph_is_started_with_the_usual_parts():
    assert [(node.name, node.executable) for node in planned(out='somewhere').values()] == [
        ('simulator', 'simulator'),
        ('perception', 'taxinet_perception'),
        ('steering_controller', 'steering_controller'),
        ('mtl_monitor', 'mtl_monitor'),
        ('recorder', 'recorder'),
        ('scenario_sampler', 'scenario_sampler'),
    ]


FUNCTION = {'perception': 'own.py:look', 'controller': 'own.py:steer'}


@pytest.mark.parametrize(('given', 'name', 'executable', 'parameters'), [
    ({}, 'simulator', 'simulator', {}),  # what the parameter file says
    ({'latency': 'perception=0.15'}, 'simulator', 'simulator', {'latency': 'perception=0.15'}),
    ({'lockstep': 'false', 'real_time_factor': '0.5'}, 'simulator', 'simulator',
     {'lockstep': False, 'real_time_factor': 0.5}),
    ({'out': 'x'}, 'recorder', 'recorder', {'out': 'x', 'images': 'all'}),
    ({'out': 'x'}, 'scenario_sampler', 'scenario_sampler', {
        'out': 'x', 'program': 's_falsif', 'runs': 10, 'seed': 0, 'sampler': '', 'until': '',
        'budget': 0.0, 'resume': False,
    }),
    ({'perception': 'truth'}, 'perception', 'ground_truth_perception', {}),
    *(({'perception': word}, 'perception', 'taxinet_perception', {'weights': word})
      for word in ('original', 'my.onnx', 'my.safetensors')),
    (FUNCTION, 'perception', 'taxinet_perception', {'weights': 'own.py:look'}),
    (FUNCTION, 'steering_controller', 'steering_controller', {'controller': 'own.py:steer'}),
])
def test_r11_given_words_then_a_node_is_started_with_these_parameters(
    given, name, executable, parameters, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path('own.py').write_text('def look(image): return 0, 0\ndef steer(estimate): return 0, 5\n')
    node = planned(**given)[name]
    assert (node.executable, node.parameters) == (executable, parameters)


def test_r11_given_nodes_of_somebody_s_own_then_they_are_awaited_or_started():
    outside = planned(perception='external', controller='external')
    assert set(outside) == {'simulator', 'mtl_monitor', 'recorder', 'scenario_sampler'}
    started = planned(
        perception='cmd:env my_node --fast', controller='cmd:env mine', namespace='a/b'
    )
    rules = ['-r', '__ns:=/a/b', '-r', '/clock:=clock']
    for name, words in (
        ('perception', ['env', 'my_node', '--fast']), ('steering_controller', ['env', 'mine']),
    ):
        assert list(started[name].command) == [
            *words, '--ros-args', '-r', f'__node:={name}', *rules,
        ]


@pytest.mark.parametrize(
    ('given', 'complaint'),
    [
        ({'runs': 'many'}, 'runs:=many: expected a whole number'),
        ({'budget': 'x'}, 'budget:=x: expected a number'),
        ({'lockstep': 'no'}, 'lockstep:=no: expected true or false'),
        ({'resume': 'perhaps'}, 'resume:=perhaps: expected true or false'),
        ({'perception': 'gone.py:look'}, 'gone.py: No such file'),
        ({'controller': 'cmd:no-such-program-anywhere'}, 'no such program'),
        ({'controller': 'cmd:'}, 'names no program'),
        ({'perception': 'external', 'namespace': '3x', 'controller': 'cmd:env x'}, 'namespace:=3x'),
    ],
)
def test_r11_given_a_bad_word_then_one_line_names_it_before_anything_starts(given, complaint):
    with pytest.raises(UsageError, match=re.escape(complaint)) as caught:
        plan(words(**given))
    assert '\n' not in str(caught.value)


def test_given_a_domain_or_a_parameter_file_that_is_none_then_one_line_names_it(tmp_path):
    assert environment(words(domain='7'))['ROS_DOMAIN_ID'] == '7'
    assert 'ROS_DOMAIN_ID' not in environment(words())
    with pytest.raises(UsageError, match='300'):
        environment(words(domain='300'))
    assert parameter_file(words(), REPOSITORY).endswith('config/nodes.yaml')
    with pytest.raises(UsageError, match='no such file'):
        parameter_file(words(params=str(tmp_path / 'gone.yaml')), REPOSITORY)
    with pytest.raises(UsageError, match='3x'):
        namespace(words(namespace='3x'))


def test_given_a_misspelled_argument_then_it_is_refused_and_not_ignored():
    check_names(['perception:=truth', 'launch-prefix:=nice'])
    with pytest.raises(UsageError, match=r'perceptoin:=truth.*did you mean perception\?'):
        check_names(['runs:=3', 'perceptoin:=truth'])


@pytest.mark.parametrize(('code', 'left_with'), [(0, None), (1, 1), (4, 4), (130, 130), (-9, 4)])
def test_given_the_end_of_the_campaign_then_all_ends_and_its_exit_code_is_that_of_the_launch(
    code, left_with
):
    ending = Ending([NodePlan(name='recorder'), NodePlan(name='scenario_sampler')])
    for pid in (1, 2, 3):
        ending.begun(pid)
    assert not ending.over(3, '', 1)  # of another launch file
    assert ending.over(2, 'scenario_sampler', code)
    assert ending.exit_code is None  # the recorder may still have to close a bag
    assert not ending.over(1, 'recorder', 0)
    assert ending.exit_code == left_with


@pytest.mark.parametrize(('code', 'ends'), [(2, True), (127, True), (0, False), (-11, False)])
def test_given_a_node_that_refuses_then_nothing_idles_and_one_that_dies_is_the_campaign_s_affair(
    code, ends
):
    ending = Ending([NodePlan(name='perception'), NodePlan(name='scenario_sampler')])
    ending.begun(1)
    assert ending.over(1, 'perception', code) == ends
    assert ending.exit_code == (2 if ends else None)


def launched(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """What ``ros2 launch`` does, on a domain that nobody else uses."""
    (folder / 'short.yaml').write_text(SHORT)
    with own_domain() as domain:
        return subprocess.run(
            [sys.executable, '-P', '-c', SERVICE, str(FILE), 'params:=short.yaml',
             f'domain:={domain}', *arguments],
            cwd=folder, capture_output=True, text=True,
            env={
                **os.environ, 'ROS_LOG_DIR': str(folder / 'log'),
                'AMENT_PREFIX_PATH': f'{sys.prefix}:{os.environ.get("AMENT_PREFIX_PATH", "")}',
            },
        )


@with_launch
@pytest.mark.ros
@pytest.mark.parametrize(
    ('arguments', 'code'),
    [
        (('perception:=truth', 'scenario:=nominal'), 0),
        (('perception:=original', 'controller:=own.py:straight', 'seed:=1', 'namespace:=n/m'), 1),
        (
            (
                f'perception:=cmd:{sys.executable} {PERCEPTION}',
                'scenario:=nominal', 'namespace:=n',
            ), 0,
        ),
    ],
)
def test_r11_given_ros2_launch_when_its_campaign_ends_then_its_exit_code_tells(
    arguments, code, tmp_path
):
    (tmp_path / 'own.py').write_text('def straight(estimate): return 0.0, 5.0\n')
    done = launched(tmp_path, 'runs:=2', 'out:=c', *arguments)
    assert done.returncode == code, done.stdout + done.stderr
    assert len(pd.read_csv(tmp_path / 'c' / 'runs.csv')) == 2


@with_launch
@pytest.mark.ros
@pytest.mark.parametrize(
    ('arguments', 'complaint'),
    [
        (('runs:=x',), 'error: runs:=x: expected a whole number'),
        (('perceptoin:=truth',), 'error: perceptoin:=truth: unknown launch argument'),
        (('perception:=nobody',), "error: perception: 'nobody' is unknown; known: truth"),
        (('controller:=nobody',), "error: controller: 'nobody' is unknown"),
        (('scenario:=nowhere', 'perception:=truth'), "error: program 'nowhere': no such file"),
    ],
)
def test_r13_given_ros2_launch_when_something_is_refused_then_it_ends_at_once_with_two(
    arguments, complaint, tmp_path
):
    done = launched(tmp_path, *arguments)
    assert done.returncode == 2, done.stdout + done.stderr
    assert (done.stdout + done.stderr).count('error: ') == 1
    assert complaint in done.stdout + done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ['log', 'short.yaml']
