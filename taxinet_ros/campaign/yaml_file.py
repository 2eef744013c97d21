"""YAML files that people write, read safely and with one line where something is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.plain_values import YAML_TROUBLES, load_strict_yaml

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
