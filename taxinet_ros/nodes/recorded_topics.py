"""What it takes to speak on a recorded topic again: its message class and quality of service."""

from __future__ import annotations

import importlib
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from taxinet_ros.bag.definitions import type_hash
from taxinet_ros.bag.topics import TopicInfo, qos_profiles
from taxinet_ros.core.errors import UsageError

_MOST_HELD = 1000
"""Depth of history that a bag may ask for at most: it is memory of this process."""

_POLICIES: dict[str, Any] = {
    'history': HistoryPolicy, 'reliability': ReliabilityPolicy, 'durability': DurabilityPolicy,
}


def message_class(topic: TopicInfo) -> type[Any] | None:
    """Class of a topic's messages, or None where its package is not installed here.

    Nothing is imported but packages that lay down this message definition.

    Raises:
        UsageError: the installed message is of another version than the recorded one.
    """
    try:
        installed = type_hash(topic.type)
    except UsageError:
        return None
    if topic.type_hash and topic.type_hash != installed:
        raise UsageError(
            f'{topic.name}: {topic.type} is of another version than the installed one; leave it '
            f'out: exclude:=["{topic.name}"]'
        )
    package, _, name = topic.type.split('/')
    return getattr(importlib.import_module(f'{package}.msg'), name)


def recorded_qos(topic: TopicInfo) -> QoSProfile:
    """What the first recorded publisher offered; what is not told is reliable and volatile."""
    try:
        told = next(iter(qos_profiles(topic.qos)), {})
    except ValueError:
        told = {}
    depth = told.get('depth')
    policies = {name: _policy(kind, told.get(name)) for name, kind in _POLICIES.items()}
    return QoSProfile(
        depth=min(max(depth, 1), _MOST_HELD) if isinstance(depth, int) else 10,
        **{name: policy for name, policy in policies.items() if policy is not None},
    )


def is_latched(qos: QoSProfile) -> bool:
    """Whether those who come late get what was said before."""
    return bool(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)


def _policy(kind: Any, told: object) -> Any:
    """A policy by name (rosbag2's metadata from version 9 on) or by number (before)."""
    for policy in kind:
        if told in (policy.name.lower(), int(policy)) and policy.name not in (
            'UNKNOWN', 'SYSTEM_DEFAULT', 'BEST_AVAILABLE',
        ):
            return policy
    return None
