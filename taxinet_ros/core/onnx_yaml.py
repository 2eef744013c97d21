"""YAML written by people, read strictly: every complaint is one line with file, key and mend."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import TypeGuard

import yaml

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.plain_values import YAML_TROUBLES, load_strict_yaml


def bad(path: Path, what: str) -> UsageError:
    """An error about a file of an ONNX network."""
    return UsageError(f'onnx: {path}: {what}')


def load(path: Path, data: bytes) -> object:
    """What the YAML in ``data``, the bytes of ``path``, says.

    Raises:
        UsageError: it is not YAML, or has a key twice.
    """
    try:
        return load_strict_yaml(data.decode('utf-8-sig'))
    except UnicodeDecodeError:
        raise bad(path, 'is not text in UTF-8; write it as YAML') from None
    except yaml.MarkedYAMLError as error:
        line = f'line {error.problem_mark.line + 1}: ' if error.problem_mark else ''
        raise bad(path, f'is not YAML: {line}{error.problem}; mend it there') from None
    except YAML_TROUBLES as error:
        raise bad(path, f'is not YAML: {" ".join(str(error).split())[:120]}; mend it') from None


class Section:
    """A mapping of the description; hands out its values, each checked."""

    def __init__(self, path: Path, name: str, value: object, known: Sequence[str]) -> None:
        self._path, self._name = path, name
        if not isinstance(value, dict):
            raise bad(path, f'{name or "the description"} is {_shown(value)}; write the keys '
                            f'{", ".join(known)}')
        self._values = value
        for key in value:
            if key not in known:
                raise self.wrong(f'has an unknown key {_shown(key)}; known: {", ".join(known)}')

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def wrong(self, what: str, key: str = '') -> UsageError:
        """An error about a key, or about the section."""
        where = '.'.join(part for part in (self._name, key) if part)
        return bad(self._path, f'{where or "the description"} {what}')

    def take(self, key: str, mend: str) -> object:
        """Any value; ``mend`` says what to write where there is none."""
        if key not in self._values:
            raise self.wrong(f'is missing; write {mend}', key)
        return self._values[key]

    def section(self, key: str, known: Sequence[str]) -> Section:
        """A mapping inside this one."""
        value = self.take(key, f'the keys {", ".join(known)}')
        return Section(self._path, f'{self._name}.{key}'.lstrip('.'), value, known)

    def sections(self, key: str, known: Sequence[str]) -> list[Section]:
        """A list of mappings."""
        mend = f'a list of entries with the keys {", ".join(known)}'
        value = self.take(key, mend)
        if not isinstance(value, list) or not value:
            raise self.wrong(f'is {_shown(value)}; write {mend}', key)
        return [
            Section(self._path, f'{key}[{index}]', entry, known)
            for index, entry in enumerate(value)
        ]

    def word(self, key: str, choices: Sequence[str], default: str | None = None) -> str:
        """One of some words."""
        if default is not None and key not in self:
            return default
        value = self.take(key, ' or '.join(choices))
        if not isinstance(value, str) or value not in choices:
            raise self.wrong(f'is {_shown(value)}; write {" or ".join(choices)}', key)
        return value

    def text(self, key: str) -> str | None:
        """Any text, None where there is none."""
        if key not in self:
            return None
        value = self._values[key]
        if not isinstance(value, str) or not value:
            raise self.wrong(f'is {_shown(value)}; write text, in quotes, or leave it out', key)
        return value

    def whole(self, key: str, low: int, high: int) -> int:
        """A whole number in a range."""
        mend = f'a whole number {low}..{high}'
        value = self.take(key, mend)
        if not _is_number(value, low, high) or not isinstance(value, int):
            raise self.wrong(f'is {_shown(value)}; write {mend}', key)
        return value

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """A number in a range."""
        if default is not None and key not in self:
            return default
        mend = f'a number {low:g}..{high:g}'
        value = self.take(key, mend)
        if not _is_number(value, low, high):
            raise self.wrong(f'is {_shown(value)}; write {mend}, such as 0.5 or 1.0e-3', key)
        return float(value)

    def numbers(self, key: str, count: int, low: float, high: float) -> tuple[float, ...]:
        """A list of ``count`` numbers, all in a range."""
        mend = f'a list of {count} number{"s" if count > 1 else ""} {low:g}..{high:g}'
        value = self.take(key, mend)
        if (
            not isinstance(value, list)
            or len(value) != count
            or not all(_is_number(item, low, high) for item in value)
        ):
            raise self.wrong(f'is {_shown(value)}; write {mend}', key)
        return tuple(map(float, value))


_FEW_WORDS = reprlib.Repr()
_FEW_WORDS.maxlevel = 2


def _shown(value: object) -> str:
    """A value in a few words; even where it is endless, or nested without end."""
    try:
        return _FEW_WORDS.repr(value)
    except ValueError:
        return 'a number with too many digits'


def _is_number(value: object, low: float, high: float) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high
