"""Serialised messages as Python objects, by the definitions in the bag itself.

Nothing that a bag names is ever imported. Arrays of numbers become numpy arrays; nested
messages become plain objects with the fields of the definition.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from taxinet_ros.bag.errors import BagCorrupt, BagForeign
from taxinet_ros.bag.topics import TopicInfo, is_type_name
from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS

MAX_DEFINITION_CHARS = 2**17
"""Longer than any of ROS's own; reading more would take seconds."""
MAX_FIXED_ARRAY = 4096
"""Elements of a fixed array, for each of which code is generated."""
MAX_PARTS = 10_000
"""Fields of a type with all within it; nested types could multiply without end."""

SCENARIO_TYPE = 'taxinet_msgs/msg/Scenario'
_RENAMED = {field.short: field.attribute for field in SCENARIO_FIELDS if field.short}
_BEFORE_UNITS = re.compile(rf'^(float64[ \t]+)({"|".join(_RENAMED)})\b', re.MULTILINE)

ABSENT = {
    field.attribute: field.absent for field in SCENARIO_FIELDS if field.absent is not None
}
"""What fields of the scenario message are worth that a recording of before does not have."""


def decode(topic: TopicInfo, cdr: bytes) -> Any:
    """The object that ``cdr`` on ``topic`` stands for.

    Raises:
        BagForeign: the bag carries no definition that could be used.
        BagCorrupt: the bytes do not fit the definition.
    """
    return decoder(topic)(cdr)


def decoder(topic: TopicInfo) -> Callable[[bytes], Any]:
    """From bytes on ``topic`` to the object that they stand for, for many messages.

    It raises BagCorrupt where the bytes do not fit the definition.

    Raises:
        BagForeign: the bag carries no definition that could be used.
    """
    store = typestore(topic)

    def decoded(cdr: bytes) -> Any:
        try:
            return store.deserialize_cdr(cdr, topic.type)
        except (SerdeError, TypesysError, ValueError, TypeError, LookupError, ArithmeticError,
                AssertionError, MemoryError, RecursionError) as error:
            raise BagCorrupt(f'topic {topic.name}: not a {topic.type}: {_line(error)}') from error

    return decoded


def definition_hash(topic: TopicInfo) -> str:
    """The REP-2016 hash of the definition that the bag carries for a topic, ``RIHS01_…``.

    Raises:
        BagForeign: there is no definition that could be used.
    """
    store = _typestore(topic.type, topic.definition)
    try:
        return str(store.hash_rihs01(topic.type))
    except Exception as error:  # As in _typestore.
        raise BagForeign(f'{topic.type}: definition not understood: {_line(error)}') from error


def typestore(topic: TopicInfo) -> Typestore:
    """A store that knows the topic's type, and what is within it, from its definition alone.

    Fields have the names of :func:`with_present_names`.

    Raises:
        BagForeign: there is no definition that could be used.
    """
    topic = with_present_names(topic)
    return _typestore(topic.type, topic.definition)


def with_present_names(topic: TopicInfo) -> TopicInfo:
    """The topic as it would be defined now, where fields have only been renamed since.

    Fields of the scenario message had no unit in their names before; the bytes are the same.
    """
    if topic.type != SCENARIO_TYPE:
        return topic
    return replace(topic, definition=_BEFORE_UNITS.sub(_present_name, topic.definition))


def present_bytes(topic: TopicInfo, definition: str) -> Callable[[bytes], bytes] | None:
    """From a message's bytes to those that it would have now; None where that cannot be told.

    Fields of the scenario message that have come since have the values of before there were any.

    Args:
        topic: as recorded.
        definition: of its type now.

    Raises:
        BagForeign: a definition could not be used.
    """
    if topic.type != SCENARIO_TYPE:
        return None
    now, read = _typestore(topic.type, definition), decoder(topic)
    old, new = (dict(store.fielddefs[topic.type][1]) for store in (typestore(topic), now))
    added = {name: value for name, value in ABSENT.items() if name in new.keys() - old.keys()}
    if not added or {name: kind for name, kind in new.items() if name not in added} != old:
        return None

    def converted(cdr: bytes) -> bytes:
        said = read(cdr)
        message = now.types[topic.type](**{name: getattr(said, name) for name in old}, **added)
        return bytes(now.serialize_cdr(message, topic.type))

    return converted


def _present_name(field: re.Match[str]) -> str:
    return f'{field[1]}{_RENAMED[field[2]]}'


@lru_cache(maxsize=64)
def _typestore(type_name: str, definition: str) -> Typestore:
    if not definition or len(definition) > MAX_DEFINITION_CHARS:
        raise BagForeign(f'{type_name}: the bag carries no ros2msg definition of it')
    if not is_type_name(type_name):
        raise BagForeign(f'{type_name!r} is not of the form package/msg/Name')
    store = get_typestore(Stores.EMPTY)
    try:
        types = get_types_from_msg(definition, type_name)
        _check_size(types, type_name)
        # Constants are left out: nobody needs them, and code is generated from what is registered.
        store.register({name: ([], fields) for name, (_, fields) in types.items()})
        store.get_msgdef(type_name)
    except Exception as error:  # A foreign parser on untrusted text: every failure is the bag's.
        raise BagForeign(f'{type_name}: definition not understood: {_line(error)}') from error
    return store


def _check_size(types: Mapping[str, Any], type_name: str) -> None:
    """Refuse what would grow beyond all bounds when code is made of it."""
    sizes: dict[str, int] = {}

    def parts(name: str) -> int:
        if name not in sizes:
            sizes[name] = sum(size(field) for _, field in types[name][1])
        if sizes[name] > MAX_PARTS:
            raise ValueError(f'more than {MAX_PARTS} fields')
        return sizes[name]

    def size(field: Any) -> int:
        kind, inner = field
        if kind == Nodetype.NAME:
            return parts(inner) if inner in types else 1
        if kind == Nodetype.BASE:
            return 1
        element, length = inner
        each = size(element)
        if kind == Nodetype.SEQUENCE:
            return each
        numbers = element[0] == Nodetype.BASE and element[1][0] not in ('string', 'wstring')
        if length > MAX_FIXED_ARRAY and not numbers:
            raise ValueError(f'a fixed array of {length}')
        return each if numbers else each * length

    parts(type_name)


def _line(error: BaseException) -> str:
    """The first line of an error's text, or its kind."""
    return next(iter(str(error).splitlines()), '') or type(error).__name__
