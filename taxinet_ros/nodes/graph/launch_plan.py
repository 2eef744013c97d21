"""Plan of the launch file: nodes to start and exit code; needs no launch library.

``ros2 launch`` may run in another Python than the nodes, with ROS but no other packages. So only
ROS is imported here, and further checks are left to the nodes: a node that refuses its parameters
ends the launch at once.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from taxinet_ros.core import topics
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.user_code import (
    find_user_code,
    is_node_elsewhere,
    names_user_code,
    node_command,
)
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import ExitCode, UsageError, near_miss
from taxinet_ros.nodes.names import perception_executable
from taxinet_ros.nodes.running.domain import domain_number
from taxinet_ros.registry import KMWH

ARGUMENTS = {
    'perception': ('taxinet', 'perception: truth, taxinet, original, …; a .safetensors or .onnx '
                   'file; FILE.py:NAME; external, a node started elsewhere; or cmd:COMMAND'),
    'controller': (STEERING, 'controller: steering; FILE.py:NAME; external; or cmd:COMMAND'),
    'world': (KMWH, 'world of the runs: kmwh, the simulated airport, or a name that a package '
              'adds; with +CAMERA, who takes its pictures, as kmwh+flightgear'),
    'scenario': ('s_falsif', 'Scenic program to draw scenes from: a shipped name or a file'),
    'runs': ('10', 'number of runs'),
    'seed': ('0', 'seed of the scenes'),
    'sampler': ('', 'ce, random, …: search for failures; empty: scenes drawn by the program'),
    'until': ('', 'stop a search early: a rule of taxinet falsify --until'),
    'budget': ('0.0', 'time budget: a search starts no new run after this [min]; 0: unlimited'),
    'resume': ('false', 'continue an interrupted search in out'),
    'out': ('', 'new folder for table and bags; empty: one below bags/'),
    'images': ('all', 'runs whose camera frames are recorded: all, failures or none'),
    'latency': ('', 'latency of answers, e.g. perception=0.15 [s]'),
    'lockstep': ('true', 'simulated time waits for every answer; false: it follows the wall clock'),
    'real_time_factor': ('1.0', 'real-time factor if lockstep is false; 0: as fast as possible'),
    'namespace': ('', 'prefix of every name in the graph, /clock included, so that several '
                  'graphs can share a domain'),
    'domain': ('', "ROS domain of the nodes; empty: the environment's"),
    'params': ('', 'parameter file of the nodes; empty: the shipped one'),
}
"""Default and description of every launch argument."""

CLOCK_REMAP = (topics.CLOCK.name, topics.CLOCK.name.lstrip('/'))
"""Moves the clock into the node's namespace, if it has one."""

NOT_STARTED = (ExitCode.USAGE, 127)
"""Exit codes of a node that refuses its parameters, or of an invalid command."""

_OF_LAUNCH = ('launch-prefix', 'launch-prefix-filter')


@dataclass(frozen=True, kw_only=True)
class NodePlan:
    """One node to start.

    Attributes:
        name: name of the node.
        executable: executable of this package; '' for a user's command.
        parameters: parameters that override the parameter file.
        command: program and arguments of a user's command; empty for a node of this package.
    """

    name: str
    executable: str = ''
    parameters: Mapping[str, Any] = field(default_factory=dict)
    command: tuple[str, ...] = ()


def check_names(given: Sequence[str]) -> None:
    """Check that every launch argument is known; launch ignores unknown ones silently.

    Args:
        given: arguments as ``NAME:=VALUE``.

    Raises:
        UsageError: an argument is unknown; the nearest known one is named.
    """
    for text in given:
        name = text.partition(':=')[0]
        if name not in ARGUMENTS and name not in _OF_LAUNCH:
            hint = near_miss(name, ARGUMENTS) or f'; known: {", ".join(ARGUMENTS)}'
            raise UsageError(f'{text}: unknown launch argument{hint}')


def plan(words: Mapping[str, str]) -> list[NodePlan]:
    """Every node of the graph, the sampler last.

    Args:
        words: value of each of :data:`ARGUMENTS`.

    Raises:
        UsageError: a value is invalid, as far as it can be checked here.
    """
    out = words['out'] or f'bags/launch-{datetime.now():%Y%m%d-%H%M%S}'
    perception, controller = words['perception'], words['controller']
    for role, word in (('perception', perception), ('controller', controller)):
        if names_user_code(word):
            find_user_code(word, role)
    seeing, weights = perception_executable(perception)
    there = {} if words['world'] == KMWH else {'world': words['world']}
    if there and (again := find_world(words['world']).again_words) and words['images'] != 'all':
        raise UsageError(f'images:={words["images"]}: {again}; use images:=all')
    own_law = {} if controller == STEERING else {'controller': controller}
    every = (
        _ours(topics.SIMULATOR, **_timing(words), **there),
        _elsewhere(topics.PERCEPTION, perception, words) if is_node_elsewhere(perception)
        else NodePlan(name=topics.PERCEPTION, executable=seeing, parameters=weights),
        _elsewhere(topics.STEERING_CONTROLLER, controller, words) if is_node_elsewhere(controller)
        else _ours(topics.STEERING_CONTROLLER, **own_law),
        _ours(topics.MTL_MONITOR),
        _ours(topics.RECORDER, out=out, images=words['images']),
        _ours(topics.SCENARIO_SAMPLER, **_campaign(words, out)),
    )
    return [node for node in every if node is not None]


def namespace(words: Mapping[str, str]) -> str:
    """Absolute namespace of the graph; ``/`` for none.

    Raises:
        UsageError: it is invalid.
    """
    return absolute_namespace(words['namespace'], 'namespace:=')


def absolute_namespace(text: str, where: str) -> str:
    """Make a namespace given by the user absolute; ``/`` for none.

    Raises:
        UsageError: it is invalid.
    """
    absolute = '/' + text.strip('/')
    try:
        validate_namespace(absolute)
    except InvalidNamespaceException as error:
        reason = str(error).splitlines()[0].removeprefix('Invalid namespace: ')
        raise UsageError(f'{where}{text}: {reason}') from None
    return absolute


def namespace_remaps(absolute: str) -> tuple[str, ...]:
    """Remaps that move a node and its clock into a namespace."""
    return f'__ns:={absolute}', ':='.join(CLOCK_REMAP)


def environment(words: Mapping[str, str]) -> dict[str, str]:
    """Environment variables of the nodes, in addition to those of launch.

    Raises:
        UsageError: the domain is invalid.
    """
    found = {'PYTHONUNBUFFERED': '1'}
    if words['domain']:
        found['ROS_DOMAIN_ID'] = str(domain_number(words['domain'], 'domain:='))
    return found


def parameter_file(words: Mapping[str, str], share: Path) -> str:
    """The file with the nodes' parameters.

    Raises:
        UsageError: the file does not exist.
    """
    path = Path(words['params']) if words['params'] else share / 'config' / 'nodes.yaml'
    if not path.is_file():
        raise UsageError(f'params:={path}: no such file')
    return str(path)


class Ending:
    """Decides when a launch ends, and with which exit code.

    Attributes:
        code: exit code of the campaign, or of the node that refused its parameters; None until the
            launch ends.
        why: the reason as text.
    """

    def __init__(self, nodes: Sequence[NodePlan]) -> None:
        """``nodes``: the nodes to start."""
        self.code: int | None = None
        self.why = ''
        self._names = [node.name for node in nodes]
        self._running: set[int] = set()

    def begun(self, pid: int) -> None:
        """Record that a process was started."""
        self._running.add(pid)

    def over(self, pid: int, name: str, code: int) -> bool:
        """Record that a process has ended.

        Args:
            pid: id of the process.
            name: name of the node, if it belongs to the graph.
            code: its exit code; negative: the signal.

        Returns:
            Whether the whole launch must end.
        """
        self._running.discard(pid)
        if self.code is not None or name not in self._names:
            return False
        if name == topics.SCENARIO_SAMPLER:
            self.code = code if code >= 0 else ExitCode.INFRA
            self.why = f'the campaign has ended: exit code {code}'
        elif code in NOT_STARTED:
            self.code = ExitCode.USAGE
            self.why = f'{name} refused its parameters'
        return self.code is not None

    @property
    def exit_code(self) -> int | None:
        """Exit code once all processes have ended; None before that or on success."""
        return None if self._running else self.code or None


def _ours(name: str, **parameters: Any) -> NodePlan:
    return NodePlan(name=name, executable=name, parameters=parameters)


def _elsewhere(name: str, word: str, words: Mapping[str, str]) -> NodePlan | None:
    """A user's command as a node; None if the user starts it.

    Raises:
        UsageError: the program does not exist.
    """
    command = node_command(word, name, namespace_remaps(namespace(words)))
    if command is None:
        return None
    if shutil.which(command[0]) is None:
        raise UsageError(f'{name}: {command[0]}: no such program')
    return NodePlan(name=name, command=tuple(command))


def _campaign(words: Mapping[str, str], out: str) -> dict[str, Any]:
    """Parameters of the sampler.

    Raises:
        UsageError: a number is invalid.
    """
    return {
        'program': words['scenario'],
        'runs': _number(words, 'runs', int),
        'seed': _number(words, 'seed', int),
        'sampler': words['sampler'],
        'until': words['until'],
        'budget': _number(words, 'budget', float),
        'resume': _flag(words, 'resume'),
        'out': out,
    }


def _timing(words: Mapping[str, str]) -> dict[str, Any]:
    """Timing parameters given for the simulator; it refuses those without effect.

    Raises:
        UsageError: a number or a flag is invalid.
    """
    every = {
        'latency': words['latency'],
        'lockstep': _flag(words, 'lockstep'),
        'real_time_factor': _number(words, 'real_time_factor', float),
    }
    return {name: value for name, value in every.items() if words[name] != ARGUMENTS[name][0]}


def _number(words: Mapping[str, str], name: str, kind: type[int] | type[float]) -> int | float:
    try:
        return kind(words[name])
    except ValueError:
        what = 'a whole number' if kind is int else 'a number'
        raise UsageError(f'{name}:={words[name]}: expected {what}') from None


def _flag(words: Mapping[str, str], name: str) -> bool:
    if words[name].lower() not in ('true', 'false'):
        raise UsageError(f'{name}:={words[name]}: expected true or false')
    return words[name].lower() == 'true'
