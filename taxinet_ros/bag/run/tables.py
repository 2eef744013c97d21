"""Topics of a bag as flat pandas tables with units, without ROS.

A row is a message. Nested fields become dotted columns (``pose.pose.position.x``), short arrays one
column per element (``k.0`` … ``k.8``), long arrays, such as images, only their length
(``data.length``). Units by column are in ``table.attrs['units']``; Parquet files keep them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from rosbags.interfaces import Nodetype

from taxinet_ros.bag.cdr.decode import decode, typestore
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.topics import is_topic
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.run.recording import Recording

LONGEST_ARRAY = 40
"""Maximum length of an array with a column per element; a 6 x 6 covariance fits."""

_SECTION = re.compile(r'^=+\s*MSG:\s*(\S+)\s*$', re.MULTILINE)
_COMMENTED = re.compile(r'^\s*\S+\s+(\w+)\s*#\s*\[([^\]]+)\]', re.MULTILINE)

_BY_TYPE = {
    'builtin_interfaces/msg/Time': {'sec': 's', 'nanosec': 'ns'},
    'builtin_interfaces/msg/Duration': {'sec': 's', 'nanosec': 'ns'},
    'geometry_msgs/msg/Point': dict.fromkeys('xyz', 'm'),
    'geometry_msgs/msg/Quaternion': dict.fromkeys('xyzw', '1'),
    'geometry_msgs/msg/Twist': {
        **{f'linear.{axis}': 'm/s' for axis in 'xyz'},
        **{f'angular.{axis}': 'rad/s' for axis in 'xyz'},
    },
    'sensor_msgs/msg/CameraInfo': {'height': 'px', 'width': 'px'},
    'sensor_msgs/msg/Image': {'height': 'px', 'width': 'px', 'step': 'bytes'},
}
"""Units of standard messages, from REP-103 and their definitions."""

_SUFFIXES = {'m': 'm', 'mps': 'm/s', 'rad': 'rad', 'ns': 'ns', 's': 's'}
"""Units by suffix of taxinet_ros names."""


def topic_tables(
    recording: Recording, topics: Collection[str] | None
) -> dict[str, pd.DataFrame]:
    """See :meth:`.recording.Recording.tables`."""
    chosen = _chosen(recording, topics)
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in chosen}
    for stored in recording.whole_messages(chosen.__contains__):
        message = decode(stored.topic, stored.cdr)
        row = {'t_s': stored.stamp_ns / 1e9, 'stamp_ns': stored.stamp_ns, **dict(flat(message))}
        rows[stored.topic.name].append(row)
    return {name: _table(rows[name], topic) for name, topic in chosen.items()}


def units_of(topic: TopicInfo) -> Mapping[str, str]:
    """Units of a topic's columns, as far as defined by its definition or a standard.

    In a definition, the unit is in brackets at the start of a field's comment: ``# [rad] left
    positive``.
    """
    return _units_within(topic.type, topic.definition)


def titles(table: pd.DataFrame) -> dict[str, str]:
    """Column names with units, ``steering_angle [rad]``, unless the name contains the unit."""
    units = table.attrs['units']
    return {
        name: f'{name} [{unit}]' for name, unit in units.items() if _told_by_name(name) != unit
    }


def flat(message: Any) -> Iterator[tuple[str, Any]]:
    """Yield columns and values of one decoded message, in the order of its fields."""
    yield from _flat('', message)


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if hasattr(value, '__msgtype__'):
        for field, inner in vars(value).items():
            if field != '__msgtype__':
                yield from _flat(f'{name}.{field}' if name else field, inner)
    elif isinstance(value, np.ndarray | list | tuple):
        if len(value) > LONGEST_ARRAY:
            yield f'{name}.length', len(value)
        else:
            for number, inner in enumerate(value):
                yield from _flat(f'{name}.{number}', inner)
    else:
        yield name, value.item() if isinstance(value, np.generic) else value


def _chosen(recording: Recording, wanted: Collection[str] | None) -> dict[str, TopicInfo]:
    """Selected topics by name, in the order of the file."""
    path, known = recording.path, recording.topics
    if wanted is None:
        return {topic.name: topic for topic in known}
    for word in wanted:
        if not any(is_topic(topic.name, word) for topic in known):
            names = ', '.join(topic.name for topic in known) or 'none'
            raise UsageError(f'{path}: no topic {word!r}; it has {names}')
    return {t.name: t for t in known if any(is_topic(t.name, word) for word in wanted)}


def _table(rows: list[dict[str, Any]], topic: TopicInfo) -> pd.DataFrame:
    columns = list(dict.fromkeys(name for row in rows for name in row)) or ['t_s', 'stamp_ns']
    table = pd.DataFrame(rows, columns=columns)
    units = {'t_s': 's', 'stamp_ns': 'ns', **units_of(topic)}
    table.attrs['units'] = {name: unit for name, unit in units.items() if name in table.columns}
    return table


@lru_cache(maxsize=64)
def _units_within(type_name: str, definition: str) -> Mapping[str, str]:
    topic = TopicInfo(name='/x', type=type_name, qos='', definition=definition, type_hash='')
    try:
        # The store rejects types with very many parts, so this walk is short.
        return dict(_walk(typestore(topic).fielddefs, type_name, _commented(topic)))
    except (BagError, LookupError, RecursionError):
        return {}


def _walk(
    types: Mapping[str, Any], name: str, commented: Mapping[str, Mapping[str, str]]
) -> Iterator[tuple[str, str]]:
    """Yield column and unit of all (nested) fields of a type."""
    known = {**_BY_TYPE.get(name, {}), **commented.get(name, {})}
    yield from known.items()
    for field, (kind, inner) in types[name][1]:
        if kind == Nodetype.NAME:
            for column, unit in _walk(types, inner, commented):
                if f'{field}.{column}' not in known:
                    yield f'{field}.{column}', unit
        elif kind == Nodetype.SEQUENCE and inner[0][0] == Nodetype.NAME:
            for column, unit in _walk(types, inner[0][1], commented):
                for number in range(LONGEST_ARRAY):
                    yield f'{field}.{number}.{column}', unit


def _commented(topic: TopicInfo) -> dict[str, dict[str, str]]:
    """Units in the comments of definitions, by type and field."""
    parts = _SECTION.split(topic.definition)
    names = [topic.type, *(part.replace('/', '/msg/') for part in parts[1::2])]
    texts = parts[0::2]
    return {
        name: dict(_COMMENTED.findall(text)) for name, text in zip(names, texts, strict=True)
    }


def _told_by_name(column: str) -> str:
    return _SUFFIXES.get(column.rpartition('_')[2], '') if '_' in column else ''
