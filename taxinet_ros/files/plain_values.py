"""Plain values of JSON and YAML: results as JSON, and strict parsing of untrusted texts.

Parsing rejects texts that would grow when parsed (YAML aliases and merge keys), are nested deeper
than Python's stack, or would take minutes. Any error in a user's file gives one line with file, key
and expected value.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import json
import math
import re
import reprlib
import sys
import types
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import (
    Any,
    TypeGuard,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

import yaml

from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.files.reading import read_file

_Typed = TypeVar('_Typed')
MAX_DEPTH = 100
"""Limit of nested lists and mappings in YAML."""
MAX_BYTES = 1 << 20
"""Size limit of user files."""
MAX_CHARS = 2**22
"""Size limit of texts in bags."""
YAML_TROUBLES = (
    yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, OverflowError,
    RecursionError,
)
"""Exceptions of PyYAML: its own, and those of its constructors."""
_WITH_UNIT = re.compile(r'[-+]?[0-9]+(\.[0-9]+)?\s*[a-zA-Zµ°%/²]*[a-df-zA-DF-Zµ°%]')
"""A number with a unit: ``75 ft``, ``10m/s``."""


@overload
def plain(value: Mapping[str, Any]) -> dict[str, Any]: ...
@overload
def plain(value: object) -> Any: ...
def plain(value: Any) -> Any:
    """A result as values of JSON.

    Dataclasses and named tuples are objects; an enum is its value, a path its text; a number that
    is not finite is null.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name) for one in dataclasses.fields(value)}
    elif hasattr(value, '_asdict'):
        value = value._asdict()
    elif hasattr(value, 'tolist'):  # of numpy
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, enum.Enum):
        value = value.value
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def typed(kind: type[_Typed], values: Mapping[str, Any]) -> _Typed:
    """A dataclass from what :func:`dataclasses.asdict` gives of it, also by way of JSON.

    Args:
        kind: the dataclass; of the fields' types, tuples, named tuples, sets, mappings, enums,
            paths and dataclasses are known, each perhaps None; other values stay as they are.
        values: its fields.

    Raises:
        TypeError, ValueError, LookupError: a field is missing, unknown or of another form.
    """
    hints = _hints(cast(Any, kind))
    if not isinstance(values, Mapping):
        raise TypeError(f'{kind.__name__}: {type(values).__name__} in place of its fields')
    return kind(**{name: _typed(hints.get(name), value) for name, value in values.items()})


@functools.cache
def _hints(kind: type) -> Mapping[str, Any]:
    return get_type_hints(kind)


def _typed(hint: Any, value: Any) -> Any:
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return None if value is None else _typed(parts[0], value)
    if origin is tuple:
        kinds = parts[:1] * len(value) if parts[1:] == (...,) else parts
        return tuple(_typed(kind, one) for kind, one in zip(kinds, value, strict=True))
    if origin is Mapping:
        if not isinstance(value, Mapping):
            raise TypeError(f'{type(value).__name__} in place of a mapping')
        return {key: _typed(parts[1], one) for key, one in value.items()}
    if dataclasses.is_dataclass(hint):
        return typed(cast('type[Any]', hint), value)
    if hasattr(hint, '_fields'):
        return hint(*map(_typed, _hints(hint).values(), value))
    found = origin or hint
    plain_types = isinstance(found, type) and issubclass(found, enum.Enum | Path | frozenset)
    return found(value) if plain_types else value


def json_text(value: Any) -> str:
    """A result as an indented JSON document, by :func:`plain`."""
    return json.dumps(plain(value), indent=2, allow_nan=False)


def load_json(data: bytes | str) -> Any:
    """Parse a JSON text.

    Raises:
        ValueError: it is not JSON, or nested too deeply.
    """
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError('nested too deeply') from None


def load_yaml(text: str, *, aliases: bool = True) -> Any:
    """Parse an untrusted YAML text of a bag into plain values.

    Args:
        text: the text.
        aliases: whether aliases are allowed. Written out again, a few lines with aliases of aliases
            could be many gigabytes.

    Raises:
        ValueError: it is not YAML of plain values, has merge keys, or is too long or too deep.
    """
    if len(text) > MAX_CHARS:
        raise ValueError(f'{len(text)} characters, more than the {MAX_CHARS} allowed')
    try:
        return _load(text, aliases=aliases)
    except YAML_TROUBLES as error:
        raise ValueError(f'not YAML of plain values: {text[:60]!r}') from error


def dump_yaml(value: Any, *, inline: bool = False) -> str:
    """Dump ``value`` as YAML in the given order, without aliases, for rosbag2's readers.

    Args:
        value: plain values.
        inline: whether lists of numbers are in one line, for people.
    """
    return yaml.dump(
        value, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True,
        default_flow_style=None if inline else False,
    )


# mypy cannot know the type of a base class chosen at run time.
class _PlainDumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """YAML dumper without anchors and aliases; libyaml, if available, is faster with equal text."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write every value in full, even if it is repeated."""
        return True


def read_yaml(path: Path, *, option: str = '', fix: str = '') -> object:
    """Read a user's YAML file as plain values.

    Args:
        path: the file, UTF-8.
        option: prefix of the error if the file cannot be read, as in ``specs``.
        fix: advice appended to syntax errors.

    Raises:
        UsageError: it cannot be read, is not YAML, or repeats a key.
    """
    try:
        return parse_yaml(path, read_file(path, MAX_BYTES), fix=fix)
    except OSError as error:
        where = f'{option} {path}'.strip()
        raise UsageError(f'{where}: cannot be read: {error.strerror}') from error


def parse_yaml(path: Path, data: bytes, *, about: str = '', fix: str = '') -> object:
    """Parse ``data``, the bytes of a user's YAML file.

    Args:
        path: the file, for the message.
        data: its content.
        about: prefix of every error.
        fix: as for :func:`read_yaml`.

    Raises:
        UsageError: it is not YAML of plain values, or repeats a key.
    """
    try:
        return _load(data.decode('utf-8-sig'), aliases=False)
    except UnicodeDecodeError:
        raise UsageError(f'{about}{path}: is not text in UTF-8; write it as YAML') from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f'line {mark.line + 1}, column {mark.column + 1}: ' if mark else ''
        syntax = not isinstance(error, yaml.constructor.ConstructorError)
        text = f'{about}{path}: {place}{error.problem}{fix if syntax else ""}'
        raise UsageError(text) from None
    except YAML_TROUBLES as error:
        text = ' '.join(str(error).split())[:120]
        raise UsageError(f'{about}{path}: is not YAML: {text}') from None


def _load(text: str, *, aliases: bool) -> Any:
    """Look through the text before it is composed: of deep blocks libyaml overflows the stack."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                raise ValueError('nested too deeply')
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.AliasEvent) and not aliases:
            problem, mark = 'an alias (*) is not read; write it out', cast(Any, event.start_mark)
            raise yaml.constructor.ConstructorError(None, None, problem, mark)
    return yaml.load(text, Loader=_Loader)


# mypy cannot know the type of a base class chosen at run time.
class _Loader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):  # type: ignore[misc]
    """Refuses mappings that grow when parsed, or of whose values YAML would drop some.

    libyaml, if available, takes a tenth of the time.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return the mapping; reject repeated keys, of which YAML would keep the last."""
        seen = set()
        for key, _ in node.value:
            word = key.value if isinstance(key, yaml.ScalarNode) else None
            if key.tag == 'tag:yaml.org,2002:merge':  # nested merges double with every line
                problem = 'a merge key (<<) is not read; write it out'
            elif word is not None and word in seen:
                problem = f'{word[:60]} is given twice'
            else:
                seen.add(word)
                continue
            raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep)
        return mapping


class Section:
    """A mapping in a user's file with checked access to its values.

    Every error is one line: the file, the path of keys, and what is expected.
    """

    def __init__(
        self, path: Path, value: object, known: Sequence[str] | None = None, *, where: str = '',
        about: str = '',
    ) -> None:
        """Check that the value is a mapping with known keys.

        Args:
            path: path of the file.
            value: parsed value.
            known: allowed keys; None for any words.
            where: path of keys to it, joined by dots; '' for the whole file.
            about: prefix of every error.

        Raises:
            UsageError: it is not a mapping, or has an unknown key.
        """
        self.path = path
        self._where, self._about = where, about
        if not isinstance(value, dict):
            keys = f' with the keys {", ".join(known)}' if known else ''
            raise self.wrong(expected(f'KEY: VALUE pairs{keys}', value))
        for key in value:
            if not isinstance(key, str):  # YAML reads on, off, yes and no as booleans
                raise self.wrong(f"expected words as keys, got {shown(key)}; put it in '…' quotes")
        for key in value:
            if known is not None and key not in known:
                near = near_miss(str(key), known)
                raise self.wrong(f'unknown key; known: {", ".join(known)}{near}', key)
        self._values: dict[str, Any] = value

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def wrong(self, what: str, key: str = '') -> UsageError:
        """An error about a key, or about the section."""
        where = self._inner(key)
        return UsageError(f'{self._about}{self.path}: {where}: {what}' if where
                          else f'{self._about}{self.path}: {what}')

    def check(self, key: str, check: Callable[[], object]) -> None:
        """Call ``check``, and add the location of the value to its error."""
        try:
            check()
        except UsageError as error:
            raise self.wrong(str(error), key) from None

    def take(self, key: str, kind: str) -> object:
        """Any value; ``kind`` names the expected value if it is missing."""
        if key not in self._values:
            raise self.wrong(f'the key {key!r} is missing; expected {kind}')
        return self._values[key]

    def section(
        self, key: str, known: Sequence[str] | None = None, *, optional: bool = False
    ) -> Section:
        """A mapping inside this one; empty if it is optional and missing."""
        keys = f' with the keys {", ".join(known)}' if known else ''
        value = self._values.get(key) if optional else self.take(key, f'KEY: VALUE pairs{keys}')
        return self._within(key, {} if value is None and optional else value, known)

    def sections(
        self, key: str, known: Sequence[str], *, optional: bool = False, most: int | None = None
    ) -> list[Section]:
        """A non-empty list of mappings, at most ``most``; empty if it is optional and missing."""
        if optional and key not in self._values:
            return []
        kind = f'a list of entries with the keys {", ".join(known)}'
        value = self.take(key, kind)
        if not isinstance(value, list) or not value:
            raise self.wrong(expected(kind, value), key)
        if most is not None and len(value) > most:
            raise self.wrong(f'{len(value)} of them, more than {most}', key)
        return [self._within(f'{key}[{index}]', entry, known) for index, entry in enumerate(value)]

    def several(self, key: str) -> list[Section]:
        """One value or a list of distinct values; one section per value."""
        value = self.take(key, 'one or several')
        found = value if isinstance(value, list) else [value]
        if not found or any(one in found[:at] for at, one in enumerate(found)):
            raise self.wrong(expected('one or several, each once', value), key)
        return [
            Section(self.path, {key: one}, where=self._where, about=self._about) for one in found
        ]

    def text(
        self, key: str, default: str | None = None, *, kind: str = 'a word', empty: bool = False,
        matching: re.Pattern[str] | None = None,
    ) -> str:
        """Any text, or one ``matching`` a pattern; ``kind`` describes the expected value."""
        if default is not None and key not in self._values:
            return default
        value = self.take(key, kind)
        if not isinstance(value, str) or not (value or empty):
            fix = "; put it in '…' quotes" if isinstance(value, int | float) else ''
            raise self.wrong(expected(kind, value) + fix, key)
        if matching is not None and not matching.fullmatch(value):
            raise self.wrong(expected(kind, value), key)
        return value

    def word(self, key: str, choices: Sequence[str], default: str | None = None) -> str:
        """One of the words in ``choices``."""
        if default is not None and key not in self._values:
            return default
        kind = f'one of {", ".join(choices)}' if len(choices) > 1 else choices[0]
        value = self.take(key, kind)
        if not isinstance(value, str) or value not in choices:
            raise self.wrong(expected(kind, value), key)
        return value

    def switch(self, key: str, default: bool | None = None) -> bool:
        """True or false."""
        if default is not None and key not in self._values:
            return default
        value = self.take(key, 'true or false')
        if not isinstance(value, bool):
            raise self.wrong(expected('true or false', value), key)
        return value

    def whole(
        self, key: str, low: int, high: int | None = None, default: int | None = None
    ) -> int:
        """A whole number from ``low`` to ``high``."""
        if default is not None and key not in self._values:
            return default
        kind = f'a whole number, {low} {"or more" if high is None else f"to {high}"}'
        value = self.take(key, kind)
        if not is_number(value, low, high) or not isinstance(value, int):
            raise self.wrong(expected(kind, value), key)
        return value

    def number(
        self, key: str, low: float, high: float | None = None, default: float | None = None
    ) -> float:
        """A number from ``low`` to ``high``."""
        if default is not None and key not in self._values:
            return default
        kind = f'a number, {low:g} {"or more" if high is None else f"to {high:g}"}'
        value = self.take(key, kind)
        if not is_number(value, low, high):
            fix = '; write it as 0.5 or 1.0e-3' if isinstance(value, str) else ''
            if fix and _WITH_UNIT.fullmatch(str(value)):
                fix = '; without a unit: it is that of the key'
            raise self.wrong(expected(kind, value) + fix, key)
        return float(value)

    def numbers(
        self, key: str, count: int, low: float, high: float,
        default: tuple[float, ...] | None = None,
    ) -> tuple[float, ...]:
        """A list of ``count`` numbers, all from ``low`` to ``high``."""
        if default is not None and key not in self._values:
            return default
        kind = f'a list of {count} number{"s" if count > 1 else ""}, {low:g} to {high:g}'
        value = self.take(key, kind)
        if (
            not isinstance(value, list)
            or len(value) != count
            or not all(is_number(item, low, high) for item in value)
        ):
            raise self.wrong(expected(kind, value), key)
        return tuple(map(float, value))

    def rows(
        self, key: str, columns: str, reach_m: float, least: int, most: int | None = None
    ) -> list[tuple[float, ...]]:
        """A list of ``least`` to ``most`` lists of coordinates, ``x, y``, up to ``reach_m``."""
        count = len(columns.split(', '))
        kind = f'{least} or more lists [{columns}]'
        rows = self.take(key, kind)
        if not isinstance(rows, list) or not least <= len(rows) <= (most or len(rows)):
            raise self.wrong(expected(kind, rows), key)
        for row in rows:
            if not (
                isinstance(row, list) and len(row) == count
                and all(is_number(one, -reach_m, reach_m) for one in row)
            ):
                raise self.wrong(expected(f'[{columns}] in metres', row), key)
        return [tuple(map(float, row)) for row in rows]

    def _within(self, key: str, value: object, known: Sequence[str] | None) -> Section:
        return Section(self.path, value, known, where=self._inner(key), about=self._about)

    def _inner(self, key: str) -> str:
        return '.'.join(part for part in (self._where, key) if part)


def expected(kind: str, value: object) -> str:
    """Error text for an unexpected value."""
    return f'expected {kind}, got {shown(value)}'


_FEW_WORDS = reprlib.Repr()
_FEW_WORDS.maxlevel, _FEW_WORDS.maxstring = 2, 60


def shown(value: object) -> str:
    """Short text of a value, even of one that is huge or contains itself."""
    try:
        return _FEW_WORDS.repr(value)
    except ValueError:
        return 'a number with too many digits'


def is_number(value: object, low: float, high: float | None = None) -> TypeGuard[int | float]:
    """Whether a value is a finite number in a range."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return low <= value <= (sys.float_info.max if high is None else high)
