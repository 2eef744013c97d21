"""Strict JSON and YAML: plain values out of texts that may come from anywhere, and their kinds.

What such a text can do beyond being wrong is to grow when it is read (YAML's aliases and merge
keys), to be nested deeper than Python's stack, or to take minutes. None of it gets so far here.
A file that a person wrote gets one line with file, key and mend where something is wrong.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any

import yaml

from taxinet_ros.errors import UsageError

MAX_DEPTH = 100
"""Brackets within brackets; PyYAML takes seconds for a thousand."""
YAML_TROUBLES = (
    yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, OverflowError,
    RecursionError,
)
"""What PyYAML raises: its own errors, and whatever its constructors run into."""


def load_json(data: bytes | str) -> Any:
    """The values that a JSON text stands for.

    Raises:
        ValueError: it is no JSON, or nested too deeply to be read.
    """
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError('nested too deeply') from None


def load_strict_yaml(text: str) -> Any:
    """The plain values that a YAML text of a person's stands for.

    Raises:
        yaml.MarkedYAMLError: it is no YAML, gives a key twice, or has aliases or merge keys; for
            what is YAML and refused all the same, its ConstructorError.
        YAML_TROUBLES: it is no YAML of plain values.
    """
    check_depth(text)
    return yaml.load(text, _StrictLoader)  # safe: a SafeLoader


def check_depth(text: str) -> None:
    """Refuse brackets within brackets without end, of whatever they are part.

    Raises:
        ValueError: there are more than :data:`MAX_DEPTH`.
    """
    depth = 0
    for sign in text:
        if sign in '[{':
            depth += 1
            if depth > MAX_DEPTH:
                raise ValueError('nested too deeply')
        elif sign in ']}':
            depth = max(depth - 1, 0)


class _StrictLoader(yaml.SafeLoader):
    """Plain values, each where it stands."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """The next part, unless it is one from elsewhere."""
        if self.check_event(yaml.events.AliasEvent):
            problem = 'an alias (*) is not read; write it out'
            raise yaml.constructor.ConstructorError(None, None, problem, self.get_mark())
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """The mapping, unless it gives a key twice, of which YAML would keep the last."""
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.tag == 'tag:yaml.org,2002:merge':
                problem = 'a merge key (<<) is not read; write it out'
            elif key.value in seen:
                problem = f'{key.value[:60]} is given twice'
            else:
                seen.add(key.value)
                continue
            raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
        return super().construct_mapping(node, deep)


MAX_BYTES = 1 << 20
"""Longer files are not read: YAML takes a second for some ten thousand characters."""


def read_yaml(path: Path, *, option: str = '', mend: str = '') -> object:
    """What a file holds, as plain values.

    Args:
        path: the file, UTF-8.
        option: heads the line if the file cannot be read, as in ``--spec``.
        mend: what to say of a mistake in the syntax, on how it may be mended.

    Raises:
        UsageError: it cannot be read, is not YAML, or gives a key twice.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise UsageError(f'{path}: has more than {MAX_BYTES >> 20} MiB; is it the right file?')
        return load_strict_yaml(path.read_bytes().decode('utf-8-sig'))
    except OSError as error:
        where = f'{option} {path}'.strip()
        raise UsageError(f'{where}: cannot be read: {error.strerror}') from error
    except UnicodeDecodeError:
        raise UsageError(f'{path}: is not text in UTF-8; write it as YAML') from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f'line {mark.line + 1}, column {mark.column + 1}: ' if mark else ''
        syntax = not isinstance(error, yaml.constructor.ConstructorError)
        raise UsageError(f'{path}: {place}{error.problem}{mend if syntax else ""}') from None
    except YAML_TROUBLES as error:
        raise UsageError(f'{path}: is not YAML: {" ".join(str(error).split())[:120]}') from None


class YamlFile:
    """A file whose values are checked one by one; every complaint is headed by it."""

    def __init__(self, path: Path) -> None:
        """Read nothing yet."""
        self._path = path

    def _mapping(
        self, where: str, value: object, known: tuple[str, ...] | None = None
    ) -> dict[str, Any]:
        """KEY: VALUE pairs, of known keys only if these are given."""
        if not isinstance(value, dict):
            raise self._wrong(where, f'expected KEY: VALUE pairs, got {value!r:.60}')
        for key in value:
            if not isinstance(key, str):  # YAML reads on, off, yes and no as switches
                what = f"expected words as keys, got {key!r}; put it in '…' quotes"
                raise self._wrong(where, what)
        for key in value:
            if known is not None and key not in known:
                inner = f'{where}.{key}' if where else key
                raise self._wrong(inner, f'unknown key; known: {", ".join(known)}')
        return value

    def _checked(self, where: str, check: Callable[[], object]) -> None:
        """Have a value checked, and say in which place it is if it is wrong."""
        try:
            check()
        except UsageError as error:
            raise self._wrong(where, str(error)) from None

    def _wrong(self, where: str, what: str) -> UsageError:
        return UsageError(f'{self._path}: {where}: {what}' if where else f'{self._path}: {what}')


_OPTIONAL = ' | None'
_MOST = 2**63
"""Whole numbers beyond it fit into no table."""


def check_kind(name: str, kind: str, value: object) -> None:
    """See that a value is of a kind.

    Args:
        name: of the field, for the message.
        kind: the field's annotation as it is written: ``str``, ``int``, ``float`` (whole numbers
            too), ``bool``, one of these ``| None``, or ``Mapping[str, float]``; others pass.
        value: what JSON has given.

    Raises:
        ValueError: it is of another kind.
    """
    if not _fits(kind, value):
        raise ValueError(f'{name} is {str(value)[:40]!r}, not {kind}')


def _fits(kind: str, value: object) -> bool:
    if kind.endswith(_OPTIONAL):
        return value is None or _fits(kind.removesuffix(_OPTIONAL), value)
    if kind == 'Mapping[str, float]':
        return isinstance(value, dict) and all(
            _fits('str', name) and _fits('float', number) for name, number in value.items()
        )
    if kind == 'str':
        return isinstance(value, str) and _is_text(value)
    if kind == 'bool':
        return isinstance(value, bool)
    if kind == 'float' and isinstance(value, float):
        return True
    if kind in ('int', 'float'):
        return isinstance(value, int) and not isinstance(value, bool) and -_MOST <= value < _MOST
    return True


def _is_text(value: str) -> bool:
    """JSON may escape halves of characters, which no file takes."""
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True
