"""Decode serialised messages to Python objects, using the definitions in the bag.

Nothing named in a bag is imported. Arrays of numbers become numpy arrays; nested messages become
plain objects with the fields of the definition.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.serde.cdr import (
    generate_deserialize_cdr,
    generate_getsize_cdr,
    generate_serialize_cdr,
)
from rosbags.typesys import TypesysError
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore
from rosbags.typesys.stores import empty

from taxinet_ros.bag.errors import BagCorrupt, BagForeign
from taxinet_ros.bag.topics import (
    TopicInfo,
    is_type_name,
    message_definition,
    type_hash,
    types_of,
)
from taxinet_ros.errors import UsageError

MAX_DEFINITION_CHARS = 2**17
"""Maximum length of a definition, more than any in ROS; longer ones would take seconds."""
MAX_FIXED_ARRAY = 4096
"""Maximum elements of a fixed array; code is generated for each element."""
MAX_PARTS = 10_000
"""Maximum number of fields of a type including nested ones, which could grow exponentially."""


def decode(topic: TopicInfo, cdr: bytes) -> Any:
    """Decode one message of ``topic``.

    Raises:
        BagForeign: the bag has no usable definition.
        BagCorrupt: the bytes do not match the definition.
    """
    return decoder(topic)(cdr)


def decoder(topic: TopicInfo) -> Callable[[bytes], Any]:
    """Create a decoder of messages on ``topic``.

    The decoder raises BagCorrupt if the bytes do not match the definition.

    Raises:
        BagForeign: the bag has no usable definition.
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
    """REP-2016 hash of a topic's definition in the bag, ``RIHS01_…``.

    Raises:
        BagForeign: no usable definition.
    """
    store = typestore(topic)
    try:
        return str(store.hash_rihs01(topic.type))
    except Exception as error:  # As in _typestore.
        raise BagForeign(f'{topic.type}: definition not understood: {_line(error)}') from error


def typestore(topic: TopicInfo) -> Typestore:
    """Type store with the topic's type and nested types, from the topic's definition.

    An empty definition is that of a type without fields, such as ``std_msgs/msg/Empty``; a
    recorder that found no definition leaves it empty, too. Then it is the installed one of the
    same type hash.

    Raises:
        BagForeign: no usable definition.
    """
    if topic.encoding != 'cdr':
        raise BagForeign(f'topic {topic.name}: messages are {topic.encoding!r}, not cdr')
    return _typestore(topic.type, topic.definition or _installed(topic.type, topic.type_hash))


@lru_cache(maxsize=64)
def _installed(type_name: str, hash_: str) -> str:
    """The installed definition of a type whose definition is empty in the bag."""
    try:
        text = message_definition(type_name)
        if hash_ == type_hash(type_name) or not (hash_ or text):
            return text
    except UsageError:
        pass
    raise BagForeign(f'{type_name}: the bag carries no ros2msg definition of it')


@lru_cache(maxsize=64)
def _typestore(type_name: str, definition: str) -> Typestore:
    if len(definition) > MAX_DEFINITION_CHARS:
        raise BagForeign(f'{type_name}: its definition has {len(definition)} characters')
    if not is_type_name(type_name):
        raise BagForeign(f'{type_name!r} is not of the form package/msg/Name')
    store = _Store()
    try:
        types = types_of(definition.replace('\r\n', '\n'), type_name)
        _check_size(types, type_name)
        # Without constants: they are not needed, and code is generated from registered types.
        store.register({name: ([], fields) for name, (_, fields) in types.items()})
        store.get_msgdef(type_name)
    except Exception as error:  # Third-party parser on untrusted text: any failure is the bag's.
        raise BagForeign(f'{type_name}: definition not understood: {_line(error)}') from error
    return store


class _Store(Typestore):
    """Generates of each type what decodes little-endian messages, in a tenth of rosbags' time."""

    def __init__(self) -> None:
        super().__init__(empty)
        self._made: dict[str, _Type] = {}

    def get_msgdef(self, typename: str) -> Any:
        """The code of a type; what writes it or reads other formats is generated when used."""
        found = self._made.get(typename)
        if found is None:
            found = self._made[typename] = _Type(
                self, typename, partial(super().get_msgdef, typename))
            found.deserialize_cdr_le = generate_deserialize_cdr(found.fields, self, 'le')
            for _, kind in found.fields:
                node, inner = kind if kind[0] in (Nodetype.BASE, Nodetype.NAME) else kind[1][0]
                if node == Nodetype.NAME:
                    self.get_msgdef(inner)
        return found


class _Type:
    """As :class:`rosbags.interfaces.Msgdef`."""

    deserialize_cdr_le: Any

    def __init__(self, store: Typestore, name: str, whole: Callable[[], Any]) -> None:
        self.fields: Any = [
            (normalize_fieldname(field), kind) for field, kind in store.fielddefs[name][1]
        ]
        self.cls = store.types[name]
        self._store, self._whole = store, whole

    def __getattr__(self, name: str) -> Any:
        made = vars(self)
        if name in ('getsize_cdr', 'size_cdr'):
            made['getsize_cdr'], made['size_cdr'] = generate_getsize_cdr(self.fields, self._store)
        elif name == 'serialize_cdr_le':
            made[name] = generate_serialize_cdr(self.fields, self._store, 'le')
        else:
            made[name] = getattr(self._whole(), name)
        return made[name]


def _check_size(types: Mapping[str, Any], type_name: str) -> None:
    """Reject types for which the generated code would be too large."""
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
    """An error's text in one line, or its type."""
    return ' '.join(str(error).split())[:200] or type(error).__name__
