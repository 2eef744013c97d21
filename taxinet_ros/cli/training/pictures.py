"""Pictures and documents that commands write, errors of writing, and lists of numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from taxinet_ros.cli.checked import check_new_file
from taxinet_ros.core.documents import NamedDocument
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import known_programs
from taxinet_ros.trials.options import DEFAULT_ROOT
from taxinet_ros.trials.requirements import SUFFIXES

SUFFIX = '.png'
_T = TypeVar('_T')


def new_picture(out: Path | None, stem: str) -> Path:
    """Path of a new picture: ``out``, or one below ``bags/`` named ``stem``.

    Raises:
        UsageError: ``out`` exists, is not a PNG name, or its folder does not exist.
    """
    if out is None:
        return _next_free(DEFAULT_ROOT / f'{stem}{SUFFIX}')
    if out.suffix.lower() != SUFFIX:
        raise UsageError(f'--out {out}: pictures are PNG files; use {out.stem}{SUFFIX}')
    check_new_file(out)
    return out


def _next_free(wanted: Path) -> Path:
    """First path of ``wanted``, ``NAME-2.png``, ``NAME-3.png``, … that does not exist."""
    candidate, number = wanted, 1
    while candidate.exists() or candidate.is_symlink():
        number += 1
        candidate = wanted.with_stem(f'{wanted.stem}-{number}')
    return candidate


def write_picture(path: Path, save: Callable[[], _T]) -> _T:
    """What ``save`` gives, which writes ``path``; the default folder is made first.

    Raises:
        UsageError: the file cannot be written.
    """
    try:
        if path.parent == DEFAULT_ROOT:
            path.parent.mkdir(exist_ok=True)
        return save()
    except OSError as error:
        raise UsageError(f'{path}: cannot be written: {error.strerror or error}') from error


def write_document(document: NamedDocument, path: Path) -> None:
    """Write the YAML file of a place or camera.

    Raises:
        UsageError: the name is not one of a YAML file, or it cannot be written.
    """
    if path.suffix not in SUFFIXES:
        raise UsageError(f'--yaml {path}: such files end in .yaml; use {path.stem}.yaml')
    try:
        with path.open('x', encoding='utf-8') as file:
            file.write(document.yaml)
    except OSError as error:
        raise UsageError(f'--yaml {path}: cannot be written: {error.strerror}') from error


def picture_sources(words: Sequence[str]) -> tuple[str | None, tuple[Path, ...]]:
    """The program that one word names, or the folders of labelled images; shipped names first."""
    if len(words) == 1 and (words[0] in known_programs() or not Path(words[0]).is_dir()):
        return words[0], ()
    return None, tuple(map(Path, words))


def words(text: str) -> tuple[str, ...]:
    """The words of a comma-separated list."""
    return tuple(word.strip() for word in text.split(',') if word.strip())


def numbers(option: str, text: str) -> tuple[float, ...]:
    """The numbers of a comma-separated list, which an option has.

    Raises:
        UsageError: one is no number.
    """
    try:
        return tuple(float(word) for word in words(text))
    except ValueError:
        raise UsageError(
            f'{option} {text!r}: expected comma-separated numbers, e.g. 6,6.5,7'
        ) from None
