"""Parameters with a description and a range, and a refusal of those that nobody declared."""

from __future__ import annotations

import difflib
from collections.abc import Collection
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node

from taxinet_ros.core.errors import UsageError

_OF_RCLPY = ('use_sim_time', 'start_type_description_service')


def declare(
    node: Node, name: str, default: Any, description: str, limits: tuple[Any, Any] | None = None
) -> Any:
    """Declare one read-only parameter and return its value.

    Args:
        node: the node that it belongs to.
        name: parameter name, lower_snake_case.
        default: value where nobody set one; its type is the parameter's.
        description: one line with the unit.
        limits: lowest and highest value, both allowed, for numbers.

    Raises:
        UsageError: the value given is of another type or out of range.
    """
    descriptor = ParameterDescriptor(description=description, read_only=True)
    if limits is not None and isinstance(default, float):
        span = FloatingPointRange(from_value=float(limits[0]), to_value=float(limits[1]), step=0.0)
        descriptor.floating_point_range = [span]
    elif limits is not None:
        descriptor.integer_range = [IntegerRange(from_value=limits[0], to_value=limits[1], step=1)]
    try:
        return node.declare_parameter(name, default, descriptor).value
    except ParameterException as error:
        span_text = f'; allowed: {limits[0]}..{limits[1]}' if limits else ''
        reason = ' '.join(str(error).split())
        raise UsageError(f'{node.get_name()}: parameter {name}: {reason}{span_text}') from error


def refuse_unknown(node: Node) -> None:
    """Refuse parameter overrides that the node has not declared; rclpy would ignore them silently.

    Raises:
        UsageError: names the parameter, and the nearest known one.
    """
    known = list(node._parameters)
    for name in _given(node):
        if name in known:
            continue
        near = difflib.get_close_matches(name, known, 1)
        own = sorted(set(known) - set(_OF_RCLPY))
        hint = f'did you mean {near[0]}?' if near else f'known: {", ".join(own) or "none"}'
        raise UsageError(f'{node.get_name()}: unknown parameter {name!r}; {hint}')


def any_given(name: str, besides: Collection[str] = ()) -> bool:
    """Whether the command line sets parameters, but for some, of a node that is yet to be made."""
    probe = Node(name, start_parameter_services=False, enable_rosout=False)
    try:
        return not set(_given(probe)) <= set(besides)
    finally:
        probe.destroy_node()


def _given(node: Node) -> list[str]:
    """Names of the parameters that somebody set for a node, those of every node left out."""
    return [
        name for name in node._parameter_overrides
        if name not in _OF_RCLPY and not name.startswith('qos_overrides.')
    ]
