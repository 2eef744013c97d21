"""Topic descriptions in a bag: type, quality of service, definition and type hash.

Definitions and hashes are read from the files of the installed interface packages; nothing is
imported. ``share/<package>/msg/`` contains the ``.msg`` text and, from Iron on, the ``.json`` type
description with the REP-2016 hashes. Without ROS, taxinet_msgs definitions come from this package
and those of ROS from rosbags (without comments), and hashes are computed; types, hashes and
messages are the same.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import dump_yaml, load_yaml

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_NAME = re.compile(r'(/[A-Za-z_][A-Za-z0-9_]*)+')
_TYPE = re.compile(r'[A-Za-z][A-Za-z0-9_]*/msg/[A-Za-z][A-Za-z0-9_]*')
_HASH = re.compile(r'RIHS01_[0-9a-f]{64}')
_OURS = Path(__file__).parent
"""Prefix of the definitions shipped with this package: ``share/taxinet_msgs/msg``."""
_INFINITE = {'sec': 9223372036, 'nsec': 854775807}
"""rosbag2's representation of an infinite duration (RMW_DURATION_INFINITE)."""


@dataclass(frozen=True, kw_only=True)
class TopicInfo:
    """One recorded topic.

    Attributes:
        name: absolute name, e.g. ``/camera/image_raw``.
        type: ROS name of its type, e.g. ``sensor_msgs/msg/Image``.
        qos: YAML text of the offered QoS profiles as in rosbag2's metadata version 9, see
            :func:`offered_qos`.
        definition: message definition including nested types, in MCAP's ``ros2msg`` format.
        type_hash: REP-2016 hash, ``RIHS01_…``.
        encoding: encoding of its messages; only ``cdr`` is ROS's.
    """

    name: str
    type: str
    qos: str
    definition: str
    type_hash: str
    encoding: str = 'cdr'


def offered_qos(*, history: str, depth: int, reliability: str, durability: str) -> str:
    """YAML text of one offered QoS profile; policies have lower-case names.

    Example: ``offered_qos(history='keep_last', depth=16, reliability='reliable',
    durability='volatile')``. Deadline, lifespan and lease are infinite, liveliness is automatic.
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
    """Parse the text of QoS profiles; the result is cached, do not modify it.

    Raises:
        ValueError: not a YAML list of mappings.
    """
    profiles = load_yaml(text, aliases=False)
    if not isinstance(profiles, list) or not all(isinstance(p, dict) for p in profiles):
        raise ValueError(f'not a list of mappings: {text!r}')
    return tuple(profiles)


def is_type_name(name: str) -> bool:
    """Whether ``name`` has the shape ``package/msg/Name``."""
    return _TYPE.fullmatch(name) is not None


def check_topics(topics: Sequence[TopicInfo]) -> None:
    """Check that topics can be stored in a bag.

    Raises:
        UsageError: a name is not absolute or repeated, or a field is malformed.
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


_BUILTIN = frozenset({
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16', 'int32',
    'uint32', 'int64', 'uint64', 'string', 'wstring',
})
_FIELD = re.compile(r'\s*([A-Za-z][A-Za-z0-9_/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]')
_SEPARATOR = '\n' + '=' * 80 + '\nMSG: '


def describe_topic(*, name: str, type_name: str, qos: str) -> TopicInfo:
    """Describe a topic with the installed definition and hash of its type."""
    return TopicInfo(
        name=name, type=type_name, qos=qos,
        definition=message_definition(type_name), type_hash=type_hash(type_name),
    )


def message_definition(type_name: str, prefixes: Sequence[Path] | None = None) -> str:
    """Definition of ``type_name`` and all nested types, in MCAP's ``ros2msg`` format.

    The order is that of rosbag2: depth first, nested types of one definition by name.

    Args:
        type_name: e.g. ``sensor_msgs/msg/Image``.
        prefixes: install prefixes to search; default ``AMENT_PREFIX_PATH``, ``sys.prefix``, and
            then the sources without ROS.

    Raises:
        UsageError: the type or a nested one is not found.
    """
    return _definition(type_name, _search_path(prefixes))


def type_hash(type_name: str, prefixes: Sequence[Path] | None = None) -> str:
    """REP-2016 hash of ``type_name``, ``RIHS01_…``; see :func:`message_definition`."""
    return _hash(type_name, _search_path(prefixes))


# Parsing takes a third of the time that a graph takes to start in a process that had one before.
@lru_cache(maxsize=64)
def types_of(definition: str, type_name: str) -> Mapping[str, Any]:
    """Constants and fields of a type and those nested in it, by name, as rosbags has them."""
    own, *nested = definition.split(_SEPARATOR)
    parts = [(type_name, own), *(part.split('\n', 1) for part in nested)]
    return {name: kind for each in parts for name, kind in _types_in(*each).items()}


@lru_cache(maxsize=256)  # a stamp is nested in nearly all
def _types_in(type_name: str, definition: str = '') -> Mapping[str, Any]:
    from rosbags.typesys import get_types_from_msg

    return get_types_from_msg(definition, type_name)


def _search_path(prefixes: Sequence[Path] | None) -> tuple[Path, ...]:
    if prefixes is not None:
        return tuple(prefixes)
    named = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return (*(Path(text) for text in [*filter(None, named), sys.prefix]), _OURS)


@lru_cache(maxsize=256)
def _definition(type_name: str, prefixes: tuple[Path, ...]) -> str:
    seen = {type_name.replace('/msg/', '/')}

    def expand(name: str) -> str:
        text = _read(name, '.msg', prefixes)
        parts = [text]
        for inner in sorted(_inner_types(text, name.split('/')[0])):
            if inner not in seen:
                seen.add(inner)
                package, short = inner.split('/')
                parts += [_SEPARATOR, inner, '\n', expand(f'{package}/msg/{short}')]
        return ''.join(parts)

    return expand(type_name)


@lru_cache(maxsize=256)
def _hash(type_name: str, prefixes: tuple[Path, ...]) -> str:
    if _OURS in prefixes and _found(type_name, '.json', prefixes) is None:
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.EMPTY)
        store.register(dict(types_of(_definition(type_name, prefixes), type_name)))
        return str(store.hash_rihs01(type_name))
    try:
        entries = json.loads(_read(type_name, '.json', prefixes))['type_hashes']
        return next(str(e['hash_string']) for e in entries if e['type_name'] == type_name)
    except (ValueError, KeyError, TypeError, StopIteration):
        raise UsageError(
            f'{type_name}: the installed .json names no type hash; reinstall its package'
        ) from None


def _inner_types(text: str, package: str) -> set[str]:
    """Types used in a definition, each as ``package/Name``."""
    inner: set[str] = set()
    for line in text.splitlines():
        match = _FIELD.match(line.partition('#')[0])
        if match is None or match.group(1) in _BUILTIN:
            continue
        parts = match.group(1).split('/')
        inner.add(f'{parts[0]}/{parts[-1]}' if len(parts) > 1 else f'{package}/{parts[0]}')
    return inner


def _read(type_name: str, suffix: str, prefixes: tuple[Path, ...]) -> str:
    file = _found(type_name, suffix, prefixes)
    if file is not None:
        return file.read_text(encoding='utf-8')
    if _OURS in prefixes and type_name in _ros_types().fielddefs:
        text, _ = _ros_types().generate_msgdef(type_name, ros_version=2)
        return text.partition(_SEPARATOR.strip().partition('\n')[0])[0].rstrip('\n') + '\n'
    package, _, name = type_name.split('/')
    searched = os.pathsep.join(str(prefix) for prefix in prefixes if prefix is not _OURS)
    raise UsageError(
        f'{type_name}: share/{package}/msg/{name}{suffix} is under none of {searched}; '
        f'install package {package} or source its workspace'
    )


def _found(type_name: str, suffix: str, prefixes: tuple[Path, ...]) -> Path | None:
    if not is_type_name(type_name):
        raise UsageError(f'{type_name!r} is not of the form package/msg/Name')
    package, _, name = type_name.split('/')
    files = (prefix / 'share' / package / 'msg' / (name + suffix) for prefix in prefixes)
    return next(filter(Path.is_file, files), None)


@lru_cache(maxsize=1)
def _ros_types() -> Typestore:
    # Imported lazily: generating the types takes 0.1 s, and ROS graphs do not need them.
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)
