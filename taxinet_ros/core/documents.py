"""Named documents: values of their own that a scenario carries, such as its place or its camera.

A scenario says one by a shipped name, or carries the whole of it as JSON, so that messages, bags
and other processes need no file. Tables have the short reference ``NAME@DIGEST``; what it stands
for is in the campaign's ledger, once, and known here to whoever has read that.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, load_json

NAME = re.compile(r'[a-z][a-z0-9_]{0,39}')
_REFERENCE = re.compile(r'[a-z][a-z0-9_]*@[0-9a-f]{12}')
_DIGEST_SIGNS = 12
_SUFFIXES = ('.yaml', '.yml')


@dataclass(frozen=True, kw_only=True)
class NamedDocument:
    """A value that is known by its name, and can be made again from its document.

    Attributes:
        name: lower-case identifier, used on the command line and in tables.
        title: display name.
        document: all of it as canonical JSON.
        shipped: whether it came with the program, so that its name says it all.
    """

    name: str
    title: str
    document: str
    shipped: bool = False

    @property
    def text(self) -> str:
        """What a scenario has of it, enough to find it anywhere: a shipped name, or everything."""
        return self.name if self.shipped else self.document

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the document."""
        return hashlib.sha256(self.document.encode()).hexdigest()

    @property
    def reference(self) -> str:
        """What tables have of it: a shipped name, or ``NAME@DIGEST`` with 12 digits of it."""
        return self.name if self.shipped else f'{self.name}@{self.digest[:_DIGEST_SIGNS]}'


_T = TypeVar('_T', bound=NamedDocument)


class Catalogue(Generic[_T]):
    """The documents of one kind: those shipped, those of files, and those this process has seen.

    Attributes:
        key: the scenario's key that has them.
        shipped: names of those that come with the program, the usual one first.
    """

    def __init__(
        self, key: str, *, shipped: tuple[str, ...], read: Callable[[Path, bool], _T],
        make: Callable[[object, Path], _T], folder: Path,
    ) -> None:
        """Take the readers.

        Args:
            key: the scenario's key.
            shipped: names of those that come with the program.
            read: makes one of a YAML file; told whether it is a shipped one.
            make: makes one of plain values; the path is for messages.
            folder: of the shipped YAML files.
        """
        self.key = key
        self.shipped = shipped
        self._one = f'{"an" if key[0] in "aeiou" else "a"} {key}'
        self._read, self._make, self._folder = read, make, folder
        # What a reference stands for never changes, so it does not matter who told.
        self._known: dict[str, _T] = {}
        self.find: Callable[[str], _T] = lru_cache(maxsize=64)(self._find)
        """The document of a scenario: of a shipped name, or of the JSON that it carries.

        Raises ``UsageError``: there is none of that name, or the JSON is not as it should be.
        """

    @property
    def default(self) -> str:
        """Name of the usual one."""
        return self.shipped[0]

    def _find(self, text: str) -> _T:
        if text.startswith('{'):
            try:
                values = load_json(text)
            except ValueError as error:
                raise UsageError(
                    f'{self.key}: neither a name nor JSON of {self._one}: {error}'
                ) from None
            found = self._make(values, Path(self.key))
            self._known[found.reference] = found
            return found
        if text in self.shipped:
            return self._read(self._folder / f'{text}.yaml', True)
        raise UsageError(
            f'scenario: {self.key} is {text!r:.60}, not one of {", ".join(self.shipped)}, '
            f'nor a YAML file of {self._one} (in Python: load_{self.key})'
        )

    def typed(self, text: str) -> _T:
        """Find the document given by a user.

        Args:
            text: a shipped name, a YAML file, JSON, or a reference out of a table.

        Raises:
            UsageError: it is none of these, or the file is not as it should be.
        """
        if text.lower().endswith(_SUFFIXES):
            return self.find(self._read(Path(text), False).text)
        if _REFERENCE.fullmatch(text):
            if text not in self._known:
                raise UsageError(
                    f'scenario: {self.key} {text} is known by its digest only; the whole of it is '
                    'in the ledger of its campaign, and in the bags of its runs'
                )
            return self._known[text]
        return self.find(text)

    def is_reference(self, text: str) -> bool:
        """Whether a text is what tables have of a document."""
        return text in self.shipped or _REFERENCE.fullmatch(text) is not None


def canonical(values: Mapping[str, Any]) -> str:
    """Plain values as JSON, the same text for the same values whatever their order."""
    return json.dumps(values, sort_keys=True, separators=(',', ':'), ensure_ascii=False)


def document_name(section: Section, example: str) -> str:
    """The name under the key ``name``.

    Raises:
        UsageError: it is missing, or no lower-case word.
    """
    kind = f'a lower-case word, such as {example}'
    name = section.text('name', kind=kind)
    if not NAME.fullmatch(name):
        raise section.wrong(f'expected {kind}, got {name!r:.60}', 'name')
    return name
