"""Lookup of named documents in scenarios: places, aircraft, cameras, others on the ground.

A scenario contains a shipped name or the whole document as JSON, so messages, bags and other
processes need no file. Tables contain the short reference ``NAME@DIGEST``; the whole document is
stored once in the campaign's record, and the reference resolves after that has been read.
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

from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.files.plain_values import Section, dump_yaml, load_json
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_text

NAME = re.compile(r'[a-z][a-z0-9_]{0,39}')
_REFERENCE = re.compile(r'[a-z0-9][a-z0-9_]*@[0-9a-f]{12}')
_DIGEST_SIGNS = 12
_SUFFIXES = ('.yaml', '.yml')


@dataclass(frozen=True, kw_only=True)
class NamedDocument:
    """Base of values with a name, which can be recreated from their document.

    Attributes:
        name: lower-case identifier, used on the command line and in tables.
        title: display name.
        document: the whole value as canonical JSON.
        shipped: whether it is shipped with the package and identified by its name.
    """

    name: str
    title: str
    document: str
    shipped: bool = False

    @property
    def text(self) -> str:
        """Self-contained text for scenarios: a shipped name, or the document."""
        return self.name if self.shipped else self.document

    @property
    def yaml(self) -> str:
        """Text of a YAML file of it, from which it is read again, to be changed."""
        return dump_yaml(json.loads(self.document), inline=True)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the document."""
        return hashlib.sha256(self.document.encode()).hexdigest()

    @property
    def reference(self) -> str:
        """Short text for tables: a shipped name, or ``NAME@DIGEST`` with 12 hex digits."""
        return self.name if self.shipped else f'{self.name}@{self.digest[:_DIGEST_SIGNS]}'


_T = TypeVar('_T', bound=NamedDocument)


class Catalogue(Generic[_T]):
    """Documents of one kind: shipped ones, ones from files, and ones already loaded.

    Attributes:
        key: scenario key of the documents.
        shipped: names of the shipped ones, the default first.
    """

    def __init__(
        self, key: str, *, shipped: tuple[str, ...], read: Callable[[Path, bool], _T],
        make: Callable[[object, Path], _T], folder: Path, one: str = '',
    ) -> None:
        """Initialise with the readers.

        Args:
            key: scenario key of the documents.
            shipped: names of the shipped ones, the default first.
            read: reads a YAML file; its second argument is whether it is a shipped one.
            make: builds a document from plain values; the path is for error messages.
            folder: folder of the shipped YAML files.
            one: what a file holds, for error messages; the key with its article if empty.
        """
        self.key = key
        self.shipped = shipped
        self._one = one or f'{"an" if key[0] in "aeiou" else "a"} {key}'
        self._read, self._make, self._folder = read, make, folder
        # By reference; references are content hashes, so entries never change.
        self._known: dict[str, _T] = {}
        self.find: Callable[[str], _T] = lru_cache(maxsize=64)(self._find)
        """Find the document of a scenario by a shipped name or by its JSON.

        Raises ``UsageError``: unknown name, or invalid JSON.
        """

    @property
    def default(self) -> str:
        """Name of the default document."""
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
            f'{near_miss(text, self.shipped)}'
        )

    def typed(self, text: str) -> _T:
        """Find the document given by a user.

        Args:
            text: a shipped name, a YAML file, JSON or a file of it, or a reference from a table.

        Raises:
            UsageError: none of these, or an invalid file.
        """
        if text.lower().endswith('.json') and not text.startswith('{'):
            try:
                return self.find(read_text(Path(text), MAX_TEXT_BYTES))
            except (OSError, UnicodeDecodeError) as error:
                why = error.strerror if isinstance(error, OSError) else 'not UTF-8'
                raise UsageError(f'{self.key} {text}: cannot be read: {why}') from None
        if text.lower().endswith(_SUFFIXES):
            return self.find(self._read(Path(text), False).text)
        if _REFERENCE.fullmatch(text):
            if text not in self._known:
                raise UsageError(
                    f'scenario: {self.key} {text} is known by its digest only; the whole of it is '
                    'in the record of its campaign, and in the bags of its runs'
                )
            return self._known[text]
        return self.find(text)

    def is_reference(self, text: str) -> bool:
        """Whether a text is a :attr:`NamedDocument.reference`."""
        return text in self.shipped or _REFERENCE.fullmatch(text) is not None


def canonical(values: Mapping[str, Any]) -> str:
    """Canonical JSON of plain values: independent of the order of keys."""
    return json.dumps(values, sort_keys=True, separators=(',', ':'), ensure_ascii=False)


def document_name(section: Section, example: str) -> str:
    """Read the name under the key ``name``.

    Raises:
        UsageError: missing, or not a lower-case word.
    """
    return section.text('name', kind=f'a lower-case word, such as {example}', matching=NAME)
