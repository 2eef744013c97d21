"""What a topic carries and how it is offered, asked of the graph: any type that is installed."""

from __future__ import annotations

import importlib
import importlib.util
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from taxinet_ros.core.errors import UsageError

_DEPTH = 1000
_TYPE = re.compile(r'(?P<package>[a-z][a-z0-9_]*)(?:/msg)?/(?P<name>[A-Z][A-Za-z0-9]*)')


def message_class(type_name: str) -> type[Any]:
    """The class of a message type, ``package/msg/Name`` or ``package/Name``.

    A type's name comes from whoever is on the network, so nothing is imported but a package that
    the generators of ROS interfaces have made.

    Raises:
        UsageError: the name is no message's, or the package is not installed or lacks it.
    """
    match = _TYPE.fullmatch(type_name)
    if match is None:
        raise UsageError(f'{type_name} is not the name of a message type')
    package, name = match['package'], match['name']
    if not _is_interface_package(package):
        raise UsageError(
            f'type {type_name}: message package {package} is not installed here; '
            'source the workspace that has it'
        )
    found = getattr(importlib.import_module(f'{package}.msg'), name, None)
    if found is None or not hasattr(found, 'get_fields_and_field_types'):
        raise UsageError(f'type {type_name}: the {package} that is installed here has no {name}')
    return found


def fields_of(type_name: str) -> Mapping[str, str]:
    """Types of a message's fields by name, as the generators spell them."""
    return message_class(type_name).get_fields_and_field_types()


def offered_type(topic: str, publishers: Sequence[TopicEndpointInfo]) -> str:
    """The type that a topic's publishers agree on.

    Raises:
        UsageError: they do not.
    """
    types = sorted({info.topic_type for info in publishers})
    if len(types) != 1:
        raise UsageError(f'topic {topic} is published with {len(types)} types: {", ".join(types)}')
    return types[0]


def matching_qos(publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """The strictest quality of service with which every publisher is heard.

    Reliable where all are, else best effort; what latched publishers said before where all are
    latched. A reader that asks for more than a writer offers hears nothing of it.
    """
    offers = [info.qos_profile for info in publishers]
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def qos_words(qos: QoSProfile) -> str:
    """Reliability and durability for people."""
    reliable = qos.reliability == ReliabilityPolicy.RELIABLE
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return f'{"reliable" if reliable else "best effort"}, {"latched" if latched else "volatile"}'


def _is_interface_package(package: str) -> bool:
    spec = importlib.util.find_spec(package)  # of a top-level name: finds it, runs nothing of it
    folders = (spec.submodule_search_locations if spec else None) or []
    return any(
        Path(folder, 'msg', '__init__.py').is_file()
        and any(Path(folder).glob(f'{package}_s__rosidl_typesupport_c*'))
        for folder in folders
    )
