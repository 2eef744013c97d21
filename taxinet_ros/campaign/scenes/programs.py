"""Find Scenic programs, read their text with all imports, and write a scenario as a program."""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import taxinet_ros
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import CATALOGUES, PARAMETERS, PLANE_KEYS, SCENARIO_FIELDS
from taxinet_ros.errors import UsageError
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_text

MODEL = 'runway_world'
"""The world model: a module imported by the programs, not a program itself."""
SUFFIX = '.scenic'
_SHARE = Path('share', 'taxinet_ros', 'scenarios')
_IMPORT = re.compile(
    r'^[ \t]*(?:(?:model|from)[ \t]+([\w.]+)|import[ \t]+([\w., \t]+))', re.MULTILINE
)
_DATA = ('.yaml', '.yml', '.json')
NAMED_FILE = re.compile(r'(["\'])([^"\'\n]+\.(?:ya?ml|json))\1', re.IGNORECASE)
"""A file of a document as a program names it, in quotes; its path is the second group."""


def shipped_folder() -> Path:
    """Folder of the shipped programs: the source checkout's, else the installed copy's.

    An installed copy is searched for in ``AMENT_PREFIX_PATH``, then in the prefixes that hold this
    package, then in the running Python's.

    Raises:
        UsageError: no folder holds the world model.
    """
    for folder in _candidates():
        if (folder / f'{MODEL}{SUFFIX}').is_file():
            return folder
    raise UsageError(
        f'scenarios: no {_SHARE} with {MODEL}{SUFFIX} found; install the package again, or source '
        'its workspace so that AMENT_PREFIX_PATH names it'
    )


def _candidates() -> Iterator[Path]:
    package = Path(taxinet_ros.__file__).resolve().parent
    yield package.parent / 'scenarios'
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        if prefix:
            yield Path(prefix) / _SHARE
    for parent in package.parents:
        yield parent / _SHARE
    yield Path(sys.prefix) / _SHARE


def known_programs() -> tuple[str, ...]:
    """Sorted names of the shipped programs."""
    names = (path.stem for path in shipped_folder().glob(f'*{SUFFIX}'))
    return tuple(sorted(name for name in names if name != MODEL))


def find_program(word_or_path: str | Path) -> Path:
    """Find the Scenic file of a shipped program's name, such as ``s_falsif``, or of a path.

    Raises:
        UsageError: it is neither a known name nor a ``.scenic`` file; the known names are listed.
    """
    text = str(word_or_path)
    if text in known_programs():
        return shipped_folder() / f'{text}{SUFFIX}'
    path = Path(text)
    if path.is_file() and path.suffix == SUFFIX:
        return path
    if path.is_file():
        raise UsageError(f'program {text!r}: not a {SUFFIX} file')
    raise UsageError(
        f'program {text!r}: no such file, and no shipped program; known: '
        f'{", ".join(known_programs())}'
    )


def program_text(path: Path) -> str:
    """Source of a program, of its modules, and of the YAML files it names.

    Modules are those that it imports from its own or the shipped folder; YAML files hold places,
    aircraft, cameras, others on the ground. Stored in the campaign record. Each file is headed by
    its name, not its path, so that a checkout and an installed copy give the same text. Imports
    made at run time are not included.

    Raises:
        UsageError: a file cannot be read.
    """
    sources = _with_imports(path)
    return ''.join(f'# --- {name} ---\n{text.rstrip()}\n' for name, text in sources.items())


def program_digest(path: Path) -> str:
    """SHA-256 of :func:`program_text`, in hexadecimal: equal digests draw equal scenes."""
    return hashlib.sha256(program_text(path).encode()).hexdigest()


def _with_imports(path: Path) -> dict[str, str]:
    folders = (path.resolve().parent, shipped_folder())
    sources: dict[str, str] = {}
    waiting = [(path.name, path)]
    while waiting:
        name, file = waiting.pop(0)
        if name in sources:
            continue
        sources[name] = _read(file)
        if file.suffix.lower() not in _DATA:
            waiting += _imports(sources[name], folders)
            waiting += _documents(sources[name])
    return sources


def _documents(text: str) -> Iterator[tuple[str, Path]]:
    """The YAML files that a program names, from the current folder as in its parameters."""
    for match in NAMED_FILE.finditer(text):
        path = Path(match[2]).expanduser()
        if path.is_file():
            yield match[2], path


def _imports(text: str, folders: tuple[Path, ...]) -> Iterator[tuple[str, Path]]:
    for match in _IMPORT.finditer(text):
        names = (match[1] or match[2]).split(',')
        yield from _modules([name.split()[0] for name in names if name.strip()], folders)


def _modules(names: list[str], folders: tuple[Path, ...]) -> Iterator[tuple[str, Path]]:
    for name in names:
        stem = name.replace('.', '/')
        for folder in folders:
            files = (f'{stem}{SUFFIX}', f'{stem}.py')
            found = [file for file in files if (folder / file).is_file()]
            if found:
                yield found[0], folder / found[0]
                break


def _read(path: Path) -> str:
    try:
        return read_text(path, MAX_TEXT_BYTES)
    except UnicodeDecodeError as error:
        raise UsageError(f'{path}: not UTF-8 ({error.reason}, byte {error.start})') from error
    except OSError as error:
        raise UsageError(f'{path}: {error.strerror}') from error


def scenario_program(scenario: Scenario, about: str, remarks: Mapping[str, str]) -> str:
    """Source of a program that always draws ``scenario``.

    Args:
        scenario: the scenario; reading it back is exact except for the last bit of an angle.
        about: header comment: purpose and origin of the program.
        remarks: comments by key of the scenario.
    """
    # Whole documents: a reference is meaningful only within its campaign.
    documents = {key: getattr(scenario, key) for key in CATALOGUES}
    values = {**scenario.to_human(), **_exact(scenario), **documents}
    lines = [f'"""{_quotable(about)}"""', f'model {MODEL}', '']
    lines += [
        f'param {key} = {_literal(values[key])}{_comment(remarks, key)}' for key in PARAMETERS
    ]
    lines += ['', *(f'# {key} {remarks[key]}' for key in PLANE_KEYS if key in remarks)]
    right, along = _literal(0 - values['cross_track_m']), _literal(values['distance_m'])
    nose_left = _literal(values['heading_deg'])
    lines.append(f'ego = new Plane at ({right}, {along}), facing {nose_left} deg')
    return '\n'.join(lines) + '\n'


def _exact(scenario: Scenario) -> dict[str, Any]:
    """Values that rounding for display would change."""
    read = scenario_from_human(scenario.to_human())
    values = {
        field: (getattr(scenario, field.attribute), getattr(read, field.attribute))
        for field in SCENARIO_FIELDS
    }
    return {
        field.key: value / field.si
        for field, (value, back) in values.items() if value != back
    }


def _literal(value: float | str | bool) -> str:
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return repr(value)


def _comment(remarks: Mapping[str, str], key: str) -> str:
    return f'  # {remarks[key]}' if key in remarks else ''


def _quotable(text: str) -> str:
    return text.strip().replace('\\', '\\\\').replace('"""', "'''") + '\n'
