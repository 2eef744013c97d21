"""Messages of a bag as Python objects, from the definitions in the bag itself.

Nothing that a bag names is ever imported. Arrays of numbers become numpy arrays; nested messages
become plain objects with the fields of the definition.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from taxinet_ros.bag.errors import BagCorrupt, BagError, BagForeign
from taxinet_ros.bag.reader import Wanted, stored_messages
from taxinet_ros.bag.topics import TopicInfo, is_type_name

MAX_DEFINITION_CHARS = 2**20


class DecodedMessage(NamedTuple):
    """One message: topic name, log time [ns] and the object with its fields."""

    topic: str
    stamp_ns: int
    message: Any


def decode(topic: TopicInfo, cdr: bytes) -> Any:
    """The object that ``cdr`` on ``topic`` stands for.

    Raises:
        BagForeign: the bag carries no definition that could be used.
        BagCorrupt: the bytes do not fit the definition.
    """
    store = _typestore(topic.type, topic.definition)
    try:
        return store.deserialize_cdr(cdr, topic.type)
    except (SerdeError, TypesysError, ValueError, TypeError, LookupError, ArithmeticError,
            AssertionError, MemoryError, RecursionError) as error:
        raise BagCorrupt(f'topic {topic.name}: not a {topic.type}: {_line(error)}') from error


def decoded_messages(path: Path, wanted: Wanted | None = None) -> Iterator[DecodedMessage]:
    """Yield the decoded messages of a bag; errors as ``reader.read_messages``."""
    for count, (topic, stamp_ns, cdr) in enumerate(stored_messages(path, wanted)):
        try:
            message = decode(topic, cdr)
        except BagError as error:
            text = f'{path}: at {stamp_ns} ns: {error}; {count} sound messages before'
            raise type(error)(text, path=path, recovered=count) from error
        yield DecodedMessage(topic.name, stamp_ns, message)


@lru_cache(maxsize=64)
def _typestore(type_name: str, definition: str) -> Typestore:
    """A store that knows ``type_name``, and what is within it, from its definition alone."""
    if not definition or len(definition) > MAX_DEFINITION_CHARS:
        raise BagForeign(f'{type_name}: the bag carries no ros2msg definition of it')
    if not is_type_name(type_name):
        raise BagForeign(f'{type_name!r} is not of the form package/msg/Name')
    store = get_typestore(Stores.EMPTY)
    try:
        types = get_types_from_msg(definition, type_name)
        # Constants are left out: nobody needs them, and code is generated from what is registered.
        store.register({name: ([], fields) for name, (_, fields) in types.items()})
        store.get_msgdef(type_name)
    except Exception as error:  # A foreign parser on untrusted text: every failure is the bag's.
        raise BagForeign(f'{type_name}: definition not understood: {_line(error)}') from error
    return store


def _line(error: BaseException) -> str:
    """The first line of an error's text, or its kind."""
    return next(iter(str(error).splitlines()), '') or type(error).__name__
