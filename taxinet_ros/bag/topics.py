"""What a bag says of each topic: its type, quality of service, definition and type hash."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from taxinet_ros.bag.yaml_text import dump_yaml, load_yaml
from taxinet_ros.core.errors import UsageError

_NAME = re.compile(r'(/[A-Za-z_][A-Za-z0-9_]*)+')
_TYPE = re.compile(r'[A-Za-z][A-Za-z0-9_]*/msg/[A-Za-z][A-Za-z0-9_]*')
_HASH = re.compile(r'RIHS01_[0-9a-f]{64}')

_INFINITE = {'sec': 9223372036, 'nsec': 854775807}
"""How rosbag2 spells a duration without bound (RMW_DURATION_INFINITE)."""


@dataclass(frozen=True, kw_only=True)
class TopicInfo:
    """One recorded topic.

    Attributes:
        name: absolute name, e.g. ``/camera/image_raw``.
        type: ROS name of its type, e.g. ``sensor_msgs/msg/Image``.
        qos: YAML text of the offered QoS profiles as rosbag2's metadata version 9 writes it, see
            :func:`offered_qos`.
        definition: message definition with all that it refers to, in MCAP's ``ros2msg`` form.
        type_hash: REP-2016 hash, ``RIHS01_…``.
    """

    name: str
    type: str
    qos: str
    definition: str
    type_hash: str


def offered_qos(*, history: str, depth: int, reliability: str, durability: str) -> str:
    """YAML text of one offered QoS profile, policies by their lower-case names.

    Example: ``offered_qos(history='keep_last', depth=16, reliability='reliable',
    durability='volatile')``. Deadline, lifespan and lease are without bound, liveliness automatic.
    """
    profile: dict[str, Any] = {
        'history': history,
        'depth': depth,
        'reliability': reliability,
        'durability': durability,
        'deadline': dict(_INFINITE),
        'lifespan': dict(_INFINITE),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(_INFINITE),
        'avoid_ros_namespace_conventions': False,
    }
    return dump_yaml([profile])


@lru_cache(maxsize=64)
def qos_profiles(text: str) -> tuple[dict[str, Any], ...]:
    """The profiles that such a text stands for; to be read only, for they are shared.

    Raises:
        ValueError: it is not a YAML list of mappings.
    """
    profiles = load_yaml(text, aliases=False)
    if not isinstance(profiles, list) or not all(isinstance(p, dict) for p in profiles):
        raise ValueError(f'not a list of mappings: {text!r}')
    return tuple(profiles)


def is_type_name(name: str) -> bool:
    """Whether ``name`` has the shape ``package/msg/Name``."""
    return _TYPE.fullmatch(name) is not None


def check_topics(topics: Sequence[TopicInfo]) -> None:
    """Refuse topics that a bag cannot hold.

    Raises:
        UsageError: a name is not absolute or occurs twice, or a field is malformed.
    """
    if not topics:
        raise UsageError('bag: no topics given; name at least one to record')
    seen: set[str] = set()
    for topic in topics:
        if topic.name in seen:
            raise UsageError(f'topic {topic.name!r} is given twice; name each topic once')
        seen.add(topic.name)
        _check(topic)


def _check(topic: TopicInfo) -> None:
    name = topic.name
    if not _NAME.fullmatch(name):
        raise UsageError(f'topic {name!r}: not an absolute ROS name such as /camera/image_raw')
    if not is_type_name(topic.type):
        raise UsageError(f'topic {name!r}: type {topic.type!r} is not of the form package/msg/Name')
    if not _HASH.fullmatch(topic.type_hash):
        raise UsageError(f'topic {name!r}: type hash {topic.type_hash!r} is not RIHS01_ and 64 hex')
    try:
        qos_profiles(topic.qos)
    except ValueError:
        raise UsageError(
            f'topic {name!r}: qos is not a YAML list of profiles; make it with offered_qos()'
        ) from None
