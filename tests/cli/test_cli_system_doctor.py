"""``taxinet doctor`` without a folder: what is here, what is missing, and its fix."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

import taxinet_ros
import taxinet_ros.nodes
from taxinet_ros.cli.main import main
from taxinet_ros.machine import Check, system_checks

TAXINET = Path(sys.executable).with_name('taxinet')


def doctor(*words, **options):
    """Exit code, standard output and error of a process."""
    done = subprocess.run(
        [TAXINET, 'doctor', *words], capture_output=True, text=True, check=False, **options,
    )
    return done.returncode, done.stdout, done.stderr


def found(name):
    """The checks of a name, on this machine as it is."""
    return [check for check in system_checks() if check.name == name]


@pytest.mark.ros
def test_given_a_machine_that_passes_these_tests_then_nothing_is_broken_and_all_is_told():
    code, out, err = doctor('--json')
    checks = [Check(**values) for values in json.loads(out)]
    assert (code, [check for check in checks if check.state == 'broken']) == (0, [])
    assert {check.name for check in checks} >= {
        'python', 'processor', 'camera', 'compiler', 'packages', 'ros', 'messages', 'domain',
        'discovery', 'memory', 'shared memory', 'limits', 'disk', 'run',
    }
    assert all(check.fix for check in checks if check.state != 'ok')
    assert all(check.found in err for check in checks)  # the lines for people, as they come


@pytest.mark.parametrize(('module', 'name', 'words'), [
    ('rclpy', 'ros', 'no ROS 2 in this Python'), ('taxinet_msgs.msg', 'messages', 'not built'),
    ('taxinet_ros.core.camera.pixels', 'camera', 'cannot be imported'),
])
def test_given_something_that_cannot_be_imported_then_its_line_says_how_to_fix_it(
    module, name, words, monkeypatch
):
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr('taxinet_ros.machine._CHECKS', {
        name: getattr(__import__('taxinet_ros.machine', fromlist=['_']), {
            'ros': '_ros', 'messages': '_messages', 'camera': '_compiled',
        }[name]),
    })
    (check,) = found(name)
    assert check.state == 'broken'
    assert words in check.found
    assert 'make' in check.fix


@pytest.mark.nightly
@pytest.mark.ros
@pytest.mark.parametrize(('environment', 'limits', 'name', 'words'), [
    ({'TAXINET_DOMAIN_ID': '999'}, None, 'domain', 'is an integer from 0 to 232'),
    ({}, (resource.RLIMIT_NOFILE, 200), 'limits', 'ulimit -n 4096'),
    ({'PATH': '/nowhere'}, None, '', ''),
])
def test_given_a_poor_surrounding_then_what_is_broken_is_named_and_the_code_is_4(
    environment, limits, name, words, tmp_path
):
    def limit():
        if limits:
            resource.setrlimit(limits[0], (limits[1], limits[1]))

    done = subprocess.run(
        [sys.executable, '-c', 'from taxinet_ros.cli.main import main; main()', 'doctor'],
        capture_output=True, text=True, check=False, cwd=tmp_path, preexec_fn=limit,
        env={**os.environ, **environment},
    )
    broken = [line for line in done.stdout.splitlines() if line.startswith('broken ')]
    if not name:  # without any program: only what some commands need is missing
        assert (done.returncode, broken) == (0, [])
        assert 'apt install g++' in done.stdout
        return
    assert done.returncode == 4, done.stdout + done.stderr
    assert all(line.split()[1] == name and words in line for line in broken)
    assert done.stdout.splitlines()[-1] == f'broken: {name}'


NO_MIDDLEWARE = {'RMW_IMPLEMENTATION': 'rmw_nowhere_cpp'}
NO_RANGE = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'NEAR'}
ALONE = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'}
RECORDER = Path(sys.prefix, 'lib', 'taxinet_ros', 'recorder')
CHECK_ROS = (
    'from taxinet_ros import machine; machine._CHECKS = {"ros": machine._ros}; '
    'raise SystemExit("".join(one.state + one.found for one in machine.system_checks()))'
)


@pytest.mark.one_in(3)
@pytest.mark.ros
@pytest.mark.parametrize(('given', 'command', 'code', 'says'), [
    (NO_MIDDLEWARE, [TAXINET, 'run', 'nominal'], 2, 'taxinet: error: RMW_IMPLEMENTATION=rmw_nowhe'),
    (NO_MIDDLEWARE, [RECORDER], 2, 'error: RMW_IMPLEMENTATION=rmw_nowhere_cpp: this ROS 2 has no'),
    (NO_MIDDLEWARE, [sys.executable, '-c', CHECK_ROS], 1, 'brokenRMW_IMPLEMENTATION=rmw_nowhere'),
    (NO_RANGE, [TAXINET, 'up'], 2, 'taxinet: error: ROS_AUTOMATIC_DISCOVERY_RANGE=NEAR: unknown; '),
    (ALONE, [RECORDER], 2, 'error: ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: nodes in processes of their'),
    (ALONE, [TAXINET, 'check-node', 'true'], 2, 'taxinet: error: ROS_AUTOMATIC_DISCOVERY_RANGE=OF'),
], ids=['run', 'node', 'doctor', 'range', 'no discovery', 'no discovery of a node'])
def test_variables_of_ros_that_cannot_work_are_named_in_one_line_before_anything_else(
    given, command, code, says, tmp_path
):
    done = subprocess.run(
        command, env={**os.environ, **given}, cwd=tmp_path, capture_output=True, text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (code, ''), done.stderr
    (line,) = done.stderr.splitlines()
    assert line.startswith(says)
    assert list(tmp_path.iterdir()) == []


def test_given_no_ros_when_a_graph_is_asked_for_then_one_line_says_what_to_do(
    monkeypatch, capsys
):
    monkeypatch.setattr(sys, 'argv', ['taxinet', 'node', 'recorder'])
    for name in [name for name in sys.modules if name.split('.')[0] == 'rclpy']:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.startswith('taxinet_ros.nodes')]:
        monkeypatch.delitem(sys.modules, name)
    # What the parent knows is put back too: it would keep the modules that are imported here.
    monkeypatch.setattr(taxinet_ros, 'nodes', taxinet_ros.nodes)
    monkeypatch.setattr(sys, 'meta_path', [_WithoutRos(), *sys.meta_path])
    with pytest.raises(SystemExit) as end:
        main()
    err = capsys.readouterr().err
    assert (end.value.code, err.count('\n')) == (2, 1)
    assert err.startswith('taxinet: error: no rclpy')
    assert 'taxinet doctor says what is here' in err


class _WithoutRos:
    """Finds no ROS, as in a Python where it is not installed."""

    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] == 'rclpy':
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
        return
