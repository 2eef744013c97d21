"""Find Scenic programs, keep them with all that they run, and write them.

A program is its file, the modules that it imports, the files that they read while it is compiled,
and the documents that its parameters name. Which these are, the process knows that compiles it
(:mod:`.source`); here they become one text with a digest, and files again. What the Scenic child
does not need is imported where it is used, as a command waits for the child.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import io
import os
import re
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import taxinet_ros
from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.files.atomic import make_folder, write_atomically
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file

if TYPE_CHECKING:
    from taxinet_ros.core.scenario import Scenario

MODEL = 'runway_world'
"""The world model: a module imported by the programs, not a program itself."""
SUFFIX = '.scenic'
_SHARE = Path('share', 'taxinet_ros', 'scenarios')
_SOURCES = (SUFFIX, '.py')
_LIBRARIES = (
    *(sysconfig.get_path(kind) + os.sep for kind in ('stdlib', 'platstdlib', 'purelib', 'platlib')),
    os.path.dirname(os.path.abspath(taxinet_ros.__file__)) + os.sep,
)
"""Folders of libraries and of this package, which are no part of a program that lies above."""
_STORED_BYTES = 1 << 20
"""Largest file that is stored whole, as every run's bag has the text; of others, the digest is."""
_HEAD = re.compile(r'^# --- (.+?)(?: \((base64|sha256)\))? ---\n', re.MULTILINE)
_LIKE_HEAD = re.compile(r'^#(\\*)( --- .+ ---)$', re.MULTILINE)
"""A line of a file that would be taken for a head; each backslash says that it is none."""
_BASE = re.compile(rb'\bbase["\']?\s*:')
"""What a document that names another as its base has: others are not parsed, which takes long."""
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
        f'program {text!r}: no such file, and no shipped program'
        f'{near_miss(text, known_programs())}; known: {", ".join(known_programs())}'
    )


def shipped_documents(folder: str, suffix: str) -> tuple[str, ...]:
    """Sorted names of the files that are shipped in a folder beside the programs."""
    return tuple(sorted(path.stem for path in (shipped_folder() / folder).glob(f'*{suffix}')))


def find_document(word_or_path: str, folder: str, suffix: str, unknown: str) -> Path:
    """Find the file of a shipped name, see :func:`shipped_documents`, or of a path.

    Raises:
        UsageError: it is neither: the text ``unknown``, with the known names.
    """
    known = shipped_documents(folder, suffix)
    if word_or_path in known:
        return shipped_folder() / folder / f'{word_or_path}{suffix}'
    path = Path(word_or_path)
    if not path.is_file():
        raise UsageError(f'{unknown}; known: {", ".join(known)}')
    return path


def is_document_file(text: str) -> bool:
    """Whether a parameter's text names a file of a place, camera, aircraft or others."""
    return text.lower().endswith(('.yaml', '.yml', '.json')) and not text.startswith('{')


def beside(program: Path, name: str) -> Path:
    """The file that a program names: beside the program, else in the current folder."""
    own = program.parent / name
    return own if os.path.isfile(own) else Path(name)


def shown_path(path: Path) -> str:
    """The path, relative to the working directory if that is shorter."""
    with contextlib.suppress(ValueError):
        return str(path.resolve().relative_to(Path.cwd()))
    return str(path)


def shown_place(file: str, line: int) -> str:
    """``file:line``, or the file where no line is known."""
    shown = shown_path(Path(file))
    return f'{shown}:{line}' if line else shown


def files_of_program(
    program: Path, loaded: Iterable[str], named: Iterable[str]
) -> dict[str, Path]:
    """Every file of a program by name: first its own, then the others in order of their names.

    Args:
        program: the program's file.
        loaded: paths of the modules and files that were read while it was compiled.
        named: names of documents, as its parameters have them.

    Returns:
        Names are relative to the program's or the shipped folder, so that they are the same
        wherever the program lies; a document from elsewhere has the name that the program gives.

    Raises:
        UsageError: a file cannot be read, or two have one name.
    """
    files = {_name(program, path): Path(path) for path in loaded if is_of_program(path)}
    sources = [path for path in (program, *files.values()) if path.suffix in _SOURCES]
    quoted = (match[2] for path in sources for match in NAMED_FILE.finditer(_stored(path)[1]))
    for name in sorted({*named, *quoted}):
        path = beside(program, name)
        if os.path.isfile(path):
            key = _name(program, path) or name
            _add_base(program, files, key, files.setdefault(key, path))
    others = {name: path for name, path in sorted(files.items()) if name}
    return {program.name: program, **others}


def _add_base(program: Path, files: dict[str, Path], name: str, document: Path) -> None:
    """Add the camera that a document moves, if it moves one."""
    base = _base(name, _content(document))
    path, key = document.parent / base, _beside(name, base)
    if base and os.path.isfile(path) and not files.setdefault(key, path).samefile(path):
        raise UsageError(
            f'{document}: its base has the name of another file of {program}, {key}; rename one'
        )


def _base(name: str, data: bytes) -> str:
    """The file that a document names as the camera that it moves; '' for none."""
    from taxinet_ros.files.plain_values import MAX_BYTES, parse_yaml

    if name.lower().endswith(('.yaml', '.yml')) and len(data) <= MAX_BYTES and _BASE.search(data):
        with contextlib.suppress(UsageError):  # said where it is read as a camera
            values = parse_yaml(Path(name), data)
            base = str(values.get('base', '')) if isinstance(values, Mapping) else ''
            return base if is_document_file(base) else ''
    return ''


def _beside(name: str, base: str) -> str:
    """Name of a document's base, which the document names from its own folder."""
    return os.path.normpath(os.path.join(os.path.dirname(name), base))


def is_of_program(path: str) -> bool:
    """Whether a file that was read is no library's, bytecode or gone."""
    return os.path.isfile(path) and not path.startswith(_LIBRARIES) and '__pycache__' not in path


def _name(program: Path, path: str | Path) -> str:
    """Path within the shipped folder or the program's own; '' if it is in neither."""
    for folder in (shipped_folder(), program.parent):
        for real in (os.path.abspath, os.path.realpath):
            if Path(real(path)).is_relative_to(real(folder)):
                return os.path.relpath(real(path), real(folder))
    return ''


def stored_text(files: Mapping[str, Path]) -> str:
    """One text of a program's files, each headed by its name; see :func:`stored_files`.

    Raises:
        UsageError: a file cannot be read.
    """
    parts = []
    for name, path in files.items():
        encoding, text = _stored(path)
        parts.append(f'# --- {name}{encoding and f" ({encoding})"} ---\n')
        parts.append(_LIKE_HEAD.sub(r'#\1\\\2', f'{text.rstrip()}\n'))
    return ''.join(parts)


def _stored(path: Path) -> tuple[str, str]:
    """How a file is stored, '' for as it is, and its text then."""
    data = _content(path)
    if len(data) > _STORED_BYTES and path.suffix not in _SOURCES:
        return 'sha256', hashlib.sha256(data).hexdigest()
    if b'\0' not in data:
        with contextlib.suppress(UnicodeDecodeError):
            text = io.StringIO(data.decode('utf-8-sig'), newline=None).read()
            # Of a source, line ends and the last ones say nothing; of data, every byte may.
            if path.suffix in _SOURCES or f'{text.rstrip()}\n'.encode() == data:
                return '', text
    return 'base64', base64.encodebytes(data).decode()


def _content(path: Path) -> bytes:
    try:
        return read_file(path, MAX_TEXT_BYTES if path.suffix in _SOURCES else None)
    except OSError as error:
        raise UsageError(f'{path}: {error.strerror}') from error


def stored_files(text: str) -> dict[str, bytes | None]:
    """The files in the text of a program by name, its own first; None for one that is too large."""
    return {
        name: None if how == 'sha256' else base64.decodebytes(data) if how else data
        for name, (how, data) in _parts(text).items()
    }


def _parts(text: str) -> dict[str, tuple[str | None, bytes]]:
    """Encoding and stored content of each file by name."""
    words = _HEAD.split(text)[1:]
    bodies = (_LIKE_HEAD.sub(_unmarked, body).encode() for body in words[2::3])
    return dict(zip(words[::3], zip(words[1::3], bodies, strict=True), strict=True))


def _unmarked(line: re.Match[str]) -> str:
    return f'#{line[1][1:]}{line[2]}'


def check_same_files(what: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Check that two facts with ``program`` and ``program_text`` have the same files.

    Args:
        what: the record of the first, for the error.
        before: facts of the record.
        now: facts of what is to continue it.

    Raises:
        UsageError: files of one program differ; all of them are named.
    """
    one, other = (_parts(str(facts.get('program_text', ''))) for facts in (before, now))
    changed = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    if changed and one and other and before.get('program') == now.get('program'):
        raise UsageError(
            f'{what} was begun with another text of {", ".join(changed)}; put that back, or choose '
            'another folder'
        )


def write_program(path: Path, source: str, text: str) -> None:
    """Write a program that was made of a stored one, with all that it runs beside it.

    Documents from outside the stored program's folder are written beside it as well; the sources
    that name them are made to name them there.

    Args:
        path: file of the program, in an existing folder.
        source: its source.
        text: text of the stored program (:func:`stored_text`).

    Raises:
        UsageError: a file is too large to be stored, another one of its name exists there, or
            a document could not be found there; nothing is written.
        OSError: a file cannot be written.
    """
    stored = _others(path, text)
    outside = {name for name in stored if os.path.isabs(name) or name.startswith(os.pardir)}
    places = {name: Path(name).name if name in outside else name for name in stored}
    _check_bases(path, stored, places)
    moved = {name: places[name] for name in outside}
    files: dict[Path, bytes] = {}
    for name, data in stored.items():
        written = _renamed(data, moved) if name.endswith(_SOURCES) else data
        file = path.parent / places[name]
        if files.setdefault(file, written) != written or (
            file.exists() and file.read_bytes() != written
        ):
            raise UsageError(f'{path}: cannot be written: beside it, {file.name} is another file')
    bases = {_beside(name, base) for name, data in stored.items() if (base := _base(name, data))}
    sources = [source.encode(), *(data for name, data in stored.items()
                                  if name.endswith(_SOURCES))]
    for name in outside - bases:
        if not any(_quoted([name]).search(data) for data in sources):
            raise UsageError(
                f'{path}: cannot be written: no source has the name {name} as it is, to replace it '
                f'by {moved[name]}'
            )
    for file, data in files.items():
        make_folder(file.parent)
        write_atomically(file, data)
    write_atomically(path, _renamed(source.encode(), moved))


def _check_bases(path: Path, stored: Mapping[str, bytes], places: Mapping[str, str]) -> None:
    """Check that each document finds the one that it moves where both are written."""
    for name, data in stored.items():
        base = _base(name, data)
        if base and _beside(places[name], base) != places.get(_beside(name, base)):
            raise UsageError(
                f'{path}: cannot be written: {base}, base of {name}, is in another folder; put '
                'both in one'
            )


def _others(path: Path, text: str) -> dict[str, bytes]:
    """The stored files that are to be written beside a program by name."""
    model = _stored(shipped_folder() / f'{MODEL}{SUFFIX}')[1].rstrip()
    others: dict[str, bytes] = {}
    for name, data in list(stored_files(text).items())[1:]:
        if data is None:
            raise UsageError(f'{path}: cannot be written: {name} is too large to be stored with it')
        if name != f'{MODEL}{SUFFIX}' or data.decode().rstrip() != model:
            others[name] = data
    return others


def _quoted(names: Iterable[str]) -> re.Pattern[bytes]:
    words = b'|'.join(re.escape(name.encode()) for name in names)
    return re.compile(rb'(?<=["\'])(?:' + words + rb')(?=["\'])')


def _renamed(source: bytes, places: Mapping[str, str]) -> bytes:
    """A source that names files by their places."""
    if not places:
        return source
    return _quoted(places).sub(lambda found: places[found[0].decode()].encode(), source)


def scenario_program(scenario: Scenario, about: str, remarks: Mapping[str, str]) -> str:
    """Source of a program that always draws ``scenario``.

    Args:
        scenario: the scenario; reading it back is exact except for the last bit of an angle.
        about: header comment: purpose and origin of the program.
        remarks: comments by key of the scenario.
    """
    from taxinet_ros.core.scenario_fields import CATALOGUES, PARAMETERS, PLANE_KEYS

    # Whole documents: a reference is meaningful only within its campaign.
    documents = {key: getattr(scenario, key) for key in CATALOGUES}
    values = {**scenario.to_human(), **_exact(scenario), **documents}
    lines = [f'"""{_quotable(about)}"""', f'model {MODEL}', '']
    lines += [
        f'param {key} = {_literal(values[key])}{_comment(remarks, key)}' for key in PARAMETERS
    ]
    lines += [
        f'param {key!r} = {_literal(value)}{_comment(remarks, key)}'
        for key, value in scenario.points.items()
    ]
    lines += ['', *(f'# {key} {remarks[key]}' for key in PLANE_KEYS if key in remarks)]
    right, along = _literal(0 - values['cross_track_m']), _literal(values['distance_m'])
    nose_left = _literal(values['heading_deg'])
    lines.append(f'ego = new Plane at ({right}, {along}), facing {nose_left} deg')
    return '\n'.join(lines) + '\n'


def _exact(scenario: Scenario) -> dict[str, Any]:
    """Values that rounding for display would change."""
    from taxinet_ros.core.scenario import scenario_from_human
    from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS

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
