"""What an executable says of itself: ``--help``, and the words that it does not take."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.utilities import remove_ros_args

from taxinet_ros.core.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.parameters import Parameter

_WIDTH = 100
_ENDS = (
    '0 asked to end, or done',
    '2 what it was given is wrong (one line says what)',
    '4 the test bench broke',
    '130, 143, 129 ended at once by the second Ctrl-C, SIGTERM or closed terminal',
)


@dataclass(frozen=True, kw_only=True)
class Usage:
    """One executable of the package.

    Attributes:
        executable: as ``ros2 run taxinet_ros`` knows it.
        does: what the node is for, a sentence or two.
        parameters: all that it declares.
        publishes, subscribes: names of its topics, relative to its namespace.
        other: services and actions, in words.
        ends: further exit codes, in words.
    """

    executable: str
    does: str
    parameters: tuple[Parameter, ...] = ()
    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    other: str = ''
    ends: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """What ``--help`` prints."""
        sections = [
            f'usage: ros2 run taxinet_ros {self.executable} [--ros-args [-p NAME:=VALUE] '
            '[-r FROM:=TO] ...]',
            '',
            *textwrap.wrap(self.does, _WIDTH),
            '',
            *_listed('publishes', self.publishes),
            *_listed('subscribes', self.subscribes),
            *(_listed('and', [self.other]) if self.other else ()),
            '',
            'parameters, which are read when it starts:' if self.parameters else 'no parameters',
            *(line for one in self.parameters for line in _parameter_lines(one)),
            '',
            'exit codes:',
            *(f'  {line}' for line in (*_ENDS, *self.ends)),
        ]
        return '\n'.join(sections)


def spoken(node: str) -> tuple[str, ...]:
    """Topics of the graph on which a node speaks."""
    topics = (
        *interface.TOPICS, interface.OBITUARY, *interface.TRANSFORMS, interface.DIAGNOSTICS,
        *interface.SCENE,
    )
    return tuple(topic.name for topic in topics if node in topic.publishers)


def heard(node: str, *but: str) -> tuple[str, ...]:
    """Topics of the graph that a node hears, some left out."""
    names = interface.PARTICIPANTS
    found = [topic.name for topic in interface.TOPICS if node in topic.listeners(names)]
    told = [interface.OBITUARY.name] if node in interface.OBITUARY.subscribers else []
    return tuple(name for name in (*found, *told) if name not in but)


def read_arguments(usage: Usage, arguments: Sequence[str]) -> bool:
    """See that there is nothing on a command line but arguments of ROS.

    Args:
        usage: of the executable.
        arguments: the command line, the program first.

    Returns:
        Whether help was asked for, and has been printed.

    Raises:
        UsageError: names the first word that is not known.
    """
    try:
        words = remove_ros_args(list(arguments))[1:]
    except rclpy_implementation.UnknownROSArgsError as error:
        raise UsageError(
            f'{usage.executable}: what follows --ros-args has words that ROS does not know: {error}'
        ) from None
    if {'-h', '--help'} & set(words):
        print(usage.text)
        sys.stdout.flush()
        return True
    if words:
        raise UsageError(
            f'{usage.executable}: unknown argument {words[0]!r}; parameters are given as '
            '--ros-args -p NAME:=VALUE; --help lists them'
        )
    return False


def _listed(what: str, names: Iterable[str]) -> list[str]:
    text = ', '.join(names)
    head = f'{what + ":":12}{text}'
    return textwrap.wrap(head, _WIDTH, subsequent_indent=12 * ' ') if text else []


def _parameter_lines(one: Parameter) -> list[str]:
    value = str(one.default).lower() if isinstance(one.default, bool) else repr(one.default)
    value = "['']" if one.default == [''] else value
    head = f'  {one.name} = {value}'
    body = f'{one.description}; {one.allowed}' if one.allowed else one.description
    return [head, *textwrap.wrap(body, _WIDTH, initial_indent=6 * ' ', subsequent_indent=6 * ' ')]
