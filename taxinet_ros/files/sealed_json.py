"""JSON file with a checksum of itself and of other files in or below its folder.

Besides the values, the key ``seal`` holds digests of files; the last line, with the key
``checksum``, holds the SHA-256 of all preceding text.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import load_json
from taxinet_ros.files.reading import open_regular, read_file

_SEAL, _CHECKSUM = 'seal', 'checksum'
_END = re.compile(rb',\n  "checksum": "([0-9a-f]{64})"\n\}\n\Z')


@dataclass(frozen=True, kw_only=True, slots=True)
class SealedJson:
    """Content of a sealed file.

    Attributes:
        values: content without seal and checksum.
        files: SHA-256 of files in the same folder or below, by relative path.
    """

    values: dict[str, Any]
    files: Mapping[str, str] = field(default_factory=dict)

    def check_file(self, path: Path, fix: str) -> bool:
        """Check a file against its checksum; return whether it has one.

        Args:
            path: path of the file, in the same folder.
            fix: what to do if it differs, for the message.

        Raises:
            UsageError: it differs.
            OSError: it cannot be read.
        """
        if path.name not in self.files:
            return False
        if file_sha256(path) != self.files[path.name]:
            raise UsageError(f'{path}: was modified (its SHA-256 differs); {fix}')
        return True


def sealed_text(values: Mapping[str, Any], files: Mapping[str, str] | None = None) -> str:
    """Text of a sealed file; ``values`` has no keys ``seal`` and ``checksum``."""
    seal = {'files': dict(files or {})}
    text = json.dumps({**values, _SEAL: seal}, indent=2, default=str).removesuffix('\n}')
    checksum = hashlib.sha256(text.encode()).hexdigest()
    return f'{text},\n  "{_CHECKSUM}": "{checksum}"\n}}\n'


def write_sealed(path: Path, values: Mapping[str, Any], files: Iterable[Path] = ()) -> None:
    """Write a sealed file with checksums of files in and below its folder.

    Raises:
        OSError: it cannot be written, or one of them cannot be read.
    """
    write_atomically(path, sealed_text(
        values, {str(one.relative_to(path.parent)): file_sha256(one) for one in files}
    ))


def read_sealed(path: Path) -> SealedJson:
    """Read a sealed file.

    Raises:
        OSError: it cannot be read.
        UsageError: it is damaged, or was edited.
    """
    data = read_file(path)
    found = _END.search(data)
    if found is None:
        raise _damaged(path, 'it has no checksum; was it written by another version?')
    if hashlib.sha256(data[:found.start()]).hexdigest().encode() != found[1]:
        raise _damaged(path, 'its checksum differs')
    try:
        values = load_json(data)
        if not isinstance(values, dict):
            raise TypeError('it is no object')
        del values[_CHECKSUM]
        seal = values.pop(_SEAL)
        files = dict(seal['files'])
        paths = [Path(name) for name in files]
        if any(path.is_absolute() or '..' in path.parts for path in paths):
            raise ValueError('it lists files outside its folder')
        return SealedJson(values=values, files=files)
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise _damaged(path, str(error)) from error


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal digits."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, 'sha256').hexdigest()


def _damaged(path: Path, why: str) -> UsageError:
    return UsageError(
        f'{path}: damaged or edited ({why}); restore it, or resume to make it anew; see '
        f'taxinet doctor {path.parent}'
    )
