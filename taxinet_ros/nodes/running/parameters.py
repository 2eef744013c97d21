"""Node parameters with description and range, and the executable's ``--help``.

Undeclared parameters and non-ROS arguments are refused.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter as Given
from rclpy.utilities import remove_ros_args

from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.nodes import interface

_OF_RCLPY = ('use_sim_time', 'start_type_description_service')
_QOS = 'qos_overrides.'
_FIXED = (
    'the quality of service of these topics cannot be overridden, because messages could be lost '
    '(see docs/ros.md)'
)


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One parameter of a node.

    Attributes:
        name: lower_snake_case.
        default: default value, which also sets the type. An empty list would have no type, so one
            empty string stands for none.
        description: one line with the unit.
        limits: minimum and maximum of a number, both allowed.
        words: allowed values of a text.
        takes: description of other allowed texts.
    """

    name: str
    default: Any
    description: str
    limits: tuple[Any, Any] | None = None
    words: tuple[str, ...] = ()
    takes: str = ''

    @property
    def allowed(self) -> str:
        """Description of allowed values."""
        if self.limits:
            low, high = (round(limit, 6) for limit in self.limits)
            return f'{low}..{high}'
        if isinstance(self.default, bool):
            return 'true, false'
        return ', '.join(self.words) or self.takes

    @property
    def descriptor(self) -> ParameterDescriptor:
        """Descriptor for ``ros2 param describe``."""
        descriptor = ParameterDescriptor(description=self.description, read_only=True)
        if self.limits is None:
            descriptor.additional_constraints = self.allowed
        elif isinstance(self.default, float):
            low, high = map(float, self.limits)
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=low, to_value=high, step=0.0)
            ]
        else:
            low, high = self.limits
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        return descriptor


def declare(node: Node, parameter: Parameter) -> Any:
    """Declare one parameter and return its value; a whole number may stand for a double.

    Raises:
        UsageError: the value has the wrong type, is out of range or not an allowed word.
    """
    where = f'{node.get_name()}: parameter {parameter.name}'
    given = node._parameter_overrides.get(parameter.name)
    if given is not None and isinstance(parameter.default, float) and type(given.value) is int:
        # rclpy would refuse timeout:=5 and report a type error instead of asking for 5.0.
        double = Given(parameter.name, value=float(given.value))
        node._parameter_overrides[parameter.name] = double
    try:
        value = node.declare_parameter(
            parameter.name, parameter.default, parameter.descriptor
        ).value
    except ParameterException as error:
        span_text = f'; allowed: {parameter.allowed}' if parameter.limits else ''
        reason = ' '.join(str(error).split())
        raise UsageError(f'{where}: {reason}{span_text}') from error
    if value is None and isinstance(parameter.default, list):
        value = []  # an empty list has no type, so rclpy takes it for no value
    if parameter.words and value not in parameter.words:
        raise UsageError(f'{where}: {value!r} is unknown; known: {parameter.allowed}')
    return value


def declare_all(node: Node, parameters: Iterable[Parameter]) -> dict[str, Any]:
    """Declare parameters and return their values by name.

    Empty strings are removed from lists whose default is one empty string.

    Raises:
        UsageError: as :func:`declare`.
    """
    values = {}
    for one in parameters:
        value = declare(node, one)
        values[one.name] = [text for text in value if text] if one.default == [''] else value
    return values


def refuse_unknown(node: Node) -> None:
    """Refuse overrides of undeclared parameters, which rclpy would ignore silently.

    Raises:
        UsageError: a parameter is unknown; the message names the nearest known one.
    """
    known = list(node._parameters)
    for name in node._parameter_overrides:
        if name in known or name in _OF_RCLPY:  # these are set for all nodes
            continue
        if name.startswith(_QOS):
            raise UsageError(f'{node.get_name()}: parameter {name}: {_FIXED}')
        own = sorted(set(known) - set(_OF_RCLPY))
        hint = near_miss(name, known) or f'; known: {", ".join(own) or "none"}'
        raise UsageError(f'{node.get_name()}: unknown parameter {name!r}{hint}')


_WIDTH = 100
_ENDS = (
    '0 ended on request, or done',
    '2 invalid input (with a one-line message)',
    '4 infrastructure error',
    '130, 143, 129 ended at once by a second Ctrl-C, SIGTERM or closed terminal',
)


@dataclass(frozen=True, kw_only=True)
class Usage:
    """One executable of the package.

    Attributes:
        executable: name for ``ros2 run taxinet_ros``.
        does: purpose of the node in one or two sentences.
        parameters: all declared parameters.
        publishes, subscribes: topic names, relative to its namespace.
        other: services and actions, as text.
        ends: further exit codes, as text.
    """

    executable: str
    does: str
    parameters: tuple[Parameter, ...] = ()
    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    other: str = ''
    ends: tuple[str, ...] = ()

    @classmethod
    def of_node(cls, node: str, **what: Any) -> Usage:
        """Usage of a node of the graph, with its topics; ``what`` goes to :class:`Usage`."""
        return cls(
            executable=node, publishes=published_topics(node), subscribes=subscribed_topics(node),
            **what,
        )

    @property
    def text(self) -> str:
        """Text of ``--help``."""
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
            'parameters (read at start-up):' if self.parameters else 'no parameters',
            *(line for one in self.parameters for line in _parameter_lines(one)),
            '',
            'exit codes:',
            *(f'  {line}' for line in (*_ENDS, *self.ends)),
        ]
        return '\n'.join(sections)


def published_topics(node: str) -> tuple[str, ...]:
    """Topics of the graph published by a node."""
    topics = (
        *interface.TOPICS, interface.OBITUARY, *interface.TRANSFORMS, interface.DIAGNOSTICS,
        interface.ALARM, *interface.SCENE,
    )
    return tuple(topic.name for topic in topics if node in topic.publishers)


def subscribed_topics(node: str, *but: str) -> tuple[str, ...]:
    """Topics of the graph subscribed by a node, except some."""
    names = *interface.PARTICIPANTS, node
    found = [topic.name for topic in interface.TOPICS if node in topic.listeners(names)]
    told = [interface.OBITUARY.name] if node in interface.OBITUARY.subscribers else []
    return tuple(name for name in (*found, *told) if name not in but)


def read_arguments(usage: Usage, arguments: Sequence[str]) -> bool:
    """Check that a command line has only ROS arguments.

    Returns:
        Whether help was requested and printed.

    Raises:
        UsageError: an argument is unknown.
    """
    try:
        words = remove_ros_args(list(arguments))[1:]
    except rclpy_implementation.UnknownROSArgsError as error:
        raise UsageError(
            f'{usage.executable}: unknown ROS arguments after --ros-args: {error}'
        ) from None
    if {'-h', '--help'} & set(words):
        print(usage.text)
        sys.stdout.flush()
        return True
    if words:
        raise UsageError(
            f'{usage.executable}: unknown argument {words[0]!r}; set parameters with --ros-args -p '
            'NAME:=VALUE; see --help'
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
