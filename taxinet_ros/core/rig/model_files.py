"""Collects, checks and writes the XML files of a JSBSim model.

Scenarios contain them, and bags may come from anywhere, so they must not access anything outside
the model: outputs and inputs (files, sockets) are removed, and file names are plain.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section
from taxinet_ros.files.reading import read_file

MOST_CHARACTERS = 600_000
"""Limit for all files of a model together."""
_MOST_FILES = 64
_SUFFIX = '.xml'
_FOLDERS = ('', 'Engines', 'Engine', 'engines', 'Systems', 'systems')
"""Subfolders in which JSBSim and FlightGear look for included files."""
_MODEL_TAG, _REACHING_OUT = 'fdm_config', ('output', 'input')
"""Top-level elements that open files and sockets; in flight controls they are signals."""
_NAME = re.compile(r'[A-Za-z0-9_][A-Za-z0-9_. +-]*')
MODEL_NAME = re.compile(r'[A-Za-z0-9_][A-Za-z0-9_-]{0,63}')


def collect_model_files(top: Section, path: Path) -> tuple[str, dict[str, str]]:
    """Read a model and the files of its folder that it includes.

    Args:
        top: of the aircraft's file, for messages.
        path: of the model's XML file, or of its folder.

    Returns:
        Its name, and texts by path in its folder.

    Raises:
        UsageError: a file is missing, too large or no XML.
    """
    main = path / f'{path.name}{_SUFFIX}' if path.is_dir() else path
    folder, name = main.parent, main.stem
    texts: dict[str, str] = {}
    waiting = [main.name]
    while waiting:
        file = waiting.pop()
        texts[file] = text = _plain_text(top, folder / file)
        for wanted in _included(_parsed(top, file, text)):
            found = _found(folder, wanted)
            if found and found not in texts and found not in waiting:
                waiting.append(found)
        if len(texts) > _MOST_FILES:
            raise top.wrong(f'{main} includes more than {_MOST_FILES} files', 'model')
    if len(main.stem) and main.name in texts and not MODEL_NAME.fullmatch(name):
        raise top.wrong(f'{main}: {name!r} is no name of a model', 'model')
    return name, texts


def check_model_files(
    section: Section, name: str, texts: Mapping[str, str]
) -> tuple[str, dict[str, str]]:
    """Check the files of a model in a scenario.

    Raises:
        UsageError: invalid XML, access to anything outside the model, or too many files.
    """
    if not MODEL_NAME.fullmatch(name):
        raise section.wrong(f'{name!r:.60} is no name of a model', 'name')
    if f'{name}{_SUFFIX}' not in texts:
        raise section.wrong(f'{name}{_SUFFIX} is missing', 'files')
    characters = sum(map(len, texts.values()))
    if characters > MOST_CHARACTERS or len(texts) > _MOST_FILES:
        raise section.wrong(
            f'{len(texts)} files of {characters} characters, more than {_MOST_FILES} of '
            f'{MOST_CHARACTERS}', 'files',
        )
    for file, text in texts.items():
        parts = file.split('/')
        if len(parts) > 2 or not all(map(_NAME.fullmatch, parts)):
            raise section.wrong(f'{file!r:.60} is no plain name of a file', 'files')
        root = _parsed(section, file, text)
        if root.tag == _MODEL_TAG and any(one.tag in _REACHING_OUT for one in root):
            raise section.wrong(f'{file} has an output or input; leave it out', 'files')
        for wanted in _included(root):
            if not all(map(_NAME.fullmatch, wanted.split('/'))):
                raise section.wrong(f'{file} includes {wanted!r:.60}, no plain name', 'files')
    return name, dict(texts)


def write_model_files(folder: Path, name: str, texts: Iterable[tuple[str, str]]) -> Path:
    """Write a model for JSBSim below ``folder``; return the folder of model folders."""
    for file, text in texts:
        path = folder / name / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding='utf-8')
    return folder


def _plain_text(top: Section, path: Path) -> str:
    """Canonical XML of a file, without comments, outputs and inputs."""
    try:
        root = ET.fromstring(read_file(path, 4 * MOST_CHARACTERS))
    except OSError as error:
        raise top.wrong(f'{path}: cannot be read: {error.strerror}', 'model') from None
    except (ET.ParseError, ValueError) as error:
        raise top.wrong(f'{path}: no XML: {error}', 'model') from None
    for child in [one for one in root if one.tag in _REACHING_OUT and root.tag == _MODEL_TAG]:
        root.remove(child)
    return str(ET.canonicalize(ET.tostring(root, encoding='unicode'), strip_text=True))


def _parsed(section: Section, file: str, text: str) -> ET.Element:
    if '<!' in text:
        raise section.wrong(f'{file} has declarations or comments; leave them out', 'files')
    try:
        return ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise section.wrong(f'{file}: no XML: {error}', 'files') from None


def _included(root: ET.Element) -> Iterator[str]:
    """Names of files that a file includes."""
    for element in root.iter():
        if wanted := element.get('file'):
            yield wanted.strip()


def _found(folder: Path, wanted: str) -> str | None:
    """Path of an included file in the model's folder; None if it is one of JSBSim's."""
    if not all(map(_NAME.fullmatch, wanted.split('/'))):
        raise UsageError(f'aircraft: {folder} includes {wanted!r:.60}, no plain name of a file')
    for inner in _FOLDERS:
        for suffix in ('', _SUFFIX):
            path = Path(inner) / f'{wanted}{suffix}'
            if path.suffix == _SUFFIX and (folder / path).is_file():
                return path.as_posix()
    return None
