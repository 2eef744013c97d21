"""What the launch file starts, and what it ends with: all of it that needs no library of launch.

``ros2 launch`` may run in another Python than the nodes do, one that has ROS and nothing else. So
only that is needed here, and what takes more is checked by the nodes: one that refuses what it was
given ends the launch at once.
"""

from __future__ import annotations

import difflib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from taxinet_ros.core import topics
from taxinet_ros.core.controller import STEERING
from taxinet_ros.core.user_code import (
    COMMAND,
    find_user_code,
    is_node_elsewhere,
    names_user_code,
    node_command,
)
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.nodes.names import perception_executable
from taxinet_ros.nodes.running.domain import domain_number
from taxinet_ros.registry import KMWH

ARGUMENTS = {
    'perception': ('taxinet', 'who sees: truth, taxinet, original, …; a .safetensors or .onnx '
                   'file; FILE.py:NAME; external, a node started elsewhere; or cmd:COMMAND'),
    'perception_cmd': ('', 'command of a perception of your own: short for perception:=cmd:…'),
    'controller': (STEERING, 'who steers: steering; FILE.py:NAME; external; or cmd:COMMAND'),
    'controller_cmd': ('', 'command of a controller of your own: short for controller:=cmd:…'),
    'world': (KMWH, 'where runs take place: kmwh, the simulated airport, or a name that a package '
              'adds'),
    'scenario': ('s_falsif', 'Scenic program to draw scenes from: a shipped name or a file'),
    'program': ('', 'the same, by its older name'),
    'runs': ('10', 'number of runs'),
    'seed': ('0', 'seed of the scenes'),
    'sampler': ('', 'ce, random, …: searches for failures; empty: what the program draws'),
    'until': ('', 'a search stops early: failures=K or half-width=W'),
    'budget': ('0.0', 'a search begins no run after so long [min]; 0: ever'),
    'resume': ('false', 'continues the search that was interrupted in out'),
    'out': ('', 'folder for table and bags, which must be new; one below bags/ where empty'),
    'images': ('all', 'runs whose camera frames go into the bags: all, failures or none'),
    'latency': ('', 'how late answers take effect, such as perception=0.15 [s]'),
    'lockstep': ('true', 'simulated time waits for every answer; false: it goes by the wall clock'),
    'real_time_factor': ('1.0', 'simulated seconds per second where lockstep is false; 0: as fast '
                         'as it goes'),
    'namespace': ('', 'prefix of every name of the graph, its clock included: two graphs with '
                  'namespaces of their own run side by side on one domain'),
    'domain': ('', 'ROS domain of the nodes; empty: that of the environment'),
    'params': ('', "file with the nodes' parameters; empty: the shipped one"),
}
"""Default and description of every launch argument."""

_EITHER = (
    ('perception', 'perception_cmd'), ('controller', 'controller_cmd'), ('scenario', 'program'),
)

RENAMED = {'weights': 'perception'}
"""Arguments of older launch files, with the one that takes their value now."""

CLOCK_REMAP = (topics.CLOCK.name, topics.CLOCK.name.lstrip('/'))
"""Puts the clock into the node's namespace, where it has one."""

NOT_STARTED = (ExitCode.USAGE, 127)
"""Exit codes of a node that does not take what it was given, or of a command that is none."""

_OF_LAUNCH = ('launch-prefix', 'launch-prefix-filter')


@dataclass(frozen=True, kw_only=True)
class NodePlan:
    """One node that is to be started.

    Attributes:
        name: of the node.
        executable: of this package; '' where it is somebody's command.
        parameters: that it is given, over those of the parameter file.
        command: program and arguments of somebody's command; empty for a node of ours.
    """

    name: str
    executable: str = ''
    parameters: Mapping[str, Any] = field(default_factory=dict)
    command: tuple[str, ...] = ()


def check_names(given: Sequence[str]) -> None:
    """See that each of the arguments that a person typed is one; launch would say nothing.

    Args:
        given: ``NAME:=VALUE`` each.

    Raises:
        UsageError: names the first that is none, and the nearest that is; or two that say the same.
    """
    typed = {name: value for name, _, value in (text.partition(':=') for text in given) if value}
    for one, other in _EITHER:
        if one in typed and other in typed:
            raise UsageError(_one_of_two(one, other, typed))
    for text in given:
        name = text.partition(':=')[0]
        if name in RENAMED:
            raise UsageError(f'{text}: say {RENAMED[name]}:={text.partition(":=")[2]}')
        if name not in ARGUMENTS and name not in _OF_LAUNCH:
            near = difflib.get_close_matches(name, ARGUMENTS, 1)
            hint = f'did you mean {near[0]}?' if near else f'known: {", ".join(ARGUMENTS)}'
            raise UsageError(f'{text}: unknown launch argument; {hint}')


def plan(words: Mapping[str, str]) -> list[NodePlan]:
    """Every node of the graph, the sampler last.

    Args:
        words: value of each of :data:`ARGUMENTS`.

    Raises:
        UsageError: one line on the first that is wrong, as far as it can be told here.
    """
    out = words['out'] or f'bags/launch-{datetime.now():%Y%m%d-%H%M%S}'
    perception = _word_or_command(words, 'perception')
    controller = _word_or_command(words, 'controller')
    seeing, weights = perception_executable(perception)
    there = {} if words['world'] == KMWH else {'world': words['world']}
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
    """The namespace of the graph, absolute; ``/`` for none.

    Raises:
        UsageError: it is none.
    """
    return absolute_namespace(words['namespace'], 'namespace:=')


def absolute_namespace(text: str, where: str) -> str:
    """A namespace that somebody typed, absolute; ``/`` for none.

    Args:
        text: what was typed.
        where: option or argument, for the complaint.

    Raises:
        UsageError: it is none.
    """
    absolute = '/' + text.strip('/')
    try:
        validate_namespace(absolute)
    except InvalidNamespaceException as error:
        reason = str(error).splitlines()[0].removeprefix('Invalid namespace: ')
        raise UsageError(f'{where}{text}: {reason}') from None
    return absolute


def namespace_remaps(absolute: str) -> tuple[str, ...]:
    """What puts a node into a namespace, its clock too."""
    return f'__ns:={absolute}', ':='.join(CLOCK_REMAP)


def environment(words: Mapping[str, str]) -> dict[str, str]:
    """What the nodes find in their environment beside what launch finds there.

    Raises:
        UsageError: there is no such domain.
    """
    found = {'PYTHONUNBUFFERED': '1'}
    if words['domain']:
        found['ROS_DOMAIN_ID'] = str(domain_number(words['domain'], 'domain:='))
    return found


def parameter_file(words: Mapping[str, str], share: Path) -> str:
    """The file with the nodes' parameters.

    Args:
        words: as of :func:`plan`.
        share: folder with what this package has installed.

    Raises:
        UsageError: there is none.
    """
    path = Path(words['params']) if words['params'] else share / 'config' / 'nodes.yaml'
    if not path.is_file():
        raise UsageError(f'params:={path}: no such file')
    return str(path)


class Ending:
    """When a launch is over, and with which exit code.

    Attributes:
        code: of the campaign, or of the node that has refused what it was given; None as long as
            nothing has ended it.
        why: the same in words.
    """

    def __init__(self, nodes: Sequence[NodePlan]) -> None:
        """``nodes``: those that are started."""
        self.code: int | None = None
        self.why = ''
        self._names = [node.name for node in nodes]
        self._running: set[int] = set()

    def begun(self, pid: int) -> None:
        """Take that a process has been started, whoever's it is."""
        self._running.add(pid)

    def over(self, pid: int, name: str, code: int) -> bool:
        """Take that a process has ended.

        Args:
            pid: of the process.
            name: of the node, if it is one of the graph's.
            code: its exit code; negative: the signal.

        Returns:
            Whether the whole launch is to end for it.
        """
        self._running.discard(pid)
        if self.code is not None or name not in self._names:
            return False
        if name == topics.SCENARIO_SAMPLER:
            self.code = code if code >= 0 else ExitCode.INFRA
            self.why = f'the campaign has ended: exit code {code}'
        elif code in NOT_STARTED:
            self.code = ExitCode.USAGE
            self.why = f'{name} has refused what it was given'
        return self.code is not None

    @property
    def exit_code(self) -> int | None:
        """What to leave with, once nothing runs any more; None before, and where all is well."""
        return None if self._running else self.code or None


def _word_or_command(words: Mapping[str, str], role: str) -> str:
    """The word for one part of the loop.

    Raises:
        UsageError: there are two, it is no command, or no function of a file.
    """
    word, command = words[role], words[f'{role}_cmd']
    if command and word != ARGUMENTS[role][0]:
        raise UsageError(_one_of_two(role, f'{role}_cmd', words))
    word = f'{COMMAND}{command}' if command else word
    if names_user_code(word):
        find_user_code(word, role)
    return word


def _one_of_two(one: str, other: str, words: Mapping[str, str]) -> str:
    return f'{one}:={words[one]} and {other}:={words[other]}: give one of the two'


def _ours(name: str, **parameters: Any) -> NodePlan:
    return NodePlan(name=name, executable=name, parameters=parameters)


def _elsewhere(name: str, word: str, words: Mapping[str, str]) -> NodePlan | None:
    """Somebody's command as a node; None where he starts it.

    Raises:
        UsageError: there is no such program.
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
        UsageError: a number is none, or the program is named twice.
    """
    scenario = words['scenario']
    if words['program']:
        if scenario not in (ARGUMENTS['scenario'][0], words['program']):
            raise UsageError(_one_of_two('scenario', 'program', words))
        scenario = words['program']
    return {
        'program': scenario,
        'runs': _number(words, 'runs', int),
        'seed': _number(words, 'seed', int),
        'sampler': words['sampler'],
        'until': words['until'],
        'budget': _number(words, 'budget', float),
        'resume': _flag(words, 'resume'),
        'out': out,
    }


def _timing(words: Mapping[str, str]) -> dict[str, Any]:
    """Parameters of the simulator that were asked for; it refuses those that have no effect.

    Raises:
        UsageError: a number or a flag is none.
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
