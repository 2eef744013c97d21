"""Extension points: perceptions, controllers, samplers, worlds, commands and more by name.

Installed packages add extensions through entry points in the groups ``taxinet_ros.perceptions``,
``taxinet_ros.controllers``, ``taxinet_ros.samplers``, ``taxinet_ros.worlds``,
``taxinet_ros.cameras``, ``taxinet_ros.requirements`` and ``taxinet_ros.commands``;
docs/extending.md describes the requirements for each. The shipped ones use the same groups. An
extension is imported only when its name is looked up, so a broken package affects only those who
use it.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from taxinet_ros.errors import UsageError, plain_line
from taxinet_ros.version import __version__

PERCEPTIONS, CONTROLLERS, SAMPLERS = 'perceptions', 'controllers', 'samplers'
WORLDS, CAMERAS, REQUIREMENTS = 'worlds', 'cameras', 'requirements'
COMMANDS = 'commands'
OURS = 'taxinet_ros'

KMWH = 'kmwh'
"""The shipped world: an aircraft on runway 04 of Grant County airport."""

FORK = 'fork'
"""Word of the world of a forked run (:mod:`taxinet_ros.core.fork`)."""

_NETWORKS = (
    'taxinet', 'anywhere', 'broad', 'original', 'generic', 'halton', 'specialised',
    'iterative-generic', 'iterative-crossing', 'iterative-verifai', 'iterative-learned',
)
_SAMPLERS = (
    'random', 'halton', 'sobol', 'grid', 'coverage', 'active', 'ce', 'mab', 'bo',
    'tpe', 'cmaes', 'splitting', 'stress',
)


def _constants(module: str, names: tuple[str, ...]) -> dict[str, str]:
    """Targets of names that stand for upper-case constants of a module."""
    return {name: f'{module}:{name.upper().replace("-", "_")}' for name in names}


SHIPPED: Mapping[str, Mapping[str, str]] = {
    PERCEPTIONS: {
        'truth': 'taxinet_ros.core.perception.perception:GroundTruth',
        **_constants('taxinet_ros.core.perception.weights', _NETWORKS),
    },
    CONTROLLERS: {
        'steering': 'taxinet_ros.core.motion.controller:SteeringLaw',
        'hold_short': 'taxinet_ros.core.motion.hold_short:HoldShort',
    },
    SAMPLERS: _constants('taxinet_ros.samplers.registry', _SAMPLERS),
    WORLDS: {
        KMWH: 'taxinet_ros.core.world:SimulatedWorld',
        'xplane': 'taxinet_ros.extras.xplane.world:XPlaneWorld',
    },
    CAMERAS: {
        'ours': 'taxinet_ros.core.camera.camera:Camera',
        'flightgear': 'taxinet_ros.extras.flightgear.camera:FlightGearCamera',
        'xplane': 'taxinet_ros.extras.xplane.camera:XPlaneCamera',
    },
    REQUIREMENTS: _constants(
        'taxinet_ros.core.mtl.specs',
        (
            'phi_always', 'phi_eventually', 'on_runway', 'usable', 'no_collision', 'keep_clear',
            'hold_short',
        ),
    ),
    COMMANDS: {
        'forecast': 'taxinet_ros.extras.forecast.commands:forecast_app',
        'assure': 'taxinet_ros.extras.assurance.commands:assure_app',
        'evidence': 'taxinet_ros.extras.evidence.commands:evidence_app',
        'tune': 'taxinet_ros.extras.tune.commands:tune',
        'flightgear': 'taxinet_ros.extras.flightgear.commands:app',
        'xplane': 'taxinet_ros.extras.xplane.commands:app',
    },
}
"""Shipped extensions: target (``module:object``) by extension point and name, in the order in
which they are listed to users. setup.py declares them as entry points."""

RESERVED = frozenset({'external', 'python', 'onnx', 'weights', FORK})
"""Words with another meaning on the command line or in records; not allowed as names."""

_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_-]*')
_CODE = ('.py', '.so', '.pyd')
_SAID_CHARACTERS = 300
_T = TypeVar('_T')


@dataclass(frozen=True, kw_only=True, slots=True)
class Extension:
    """A named object provided by a package.

    Attributes:
        kind: extension point, a key of :data:`SHIPPED`.
        name: name by which users select it.
        target: location of the object, ``module:object``.
        distribution: name of the installed package that provides it.
        version: version of that package.
    """

    kind: str
    name: str
    target: str
    distribution: str
    version: str

    @property
    def shipped(self) -> bool:
        """Whether it is part of this package."""
        return self.distribution == OURS

    @property
    def words(self) -> str:
        """Description with its origin, for messages: ``controller pid of our-pids 1.2``."""
        return f'{self.kind.removesuffix("s")} {self.name} of {self.distribution} {self.version}'

    @property
    def package(self) -> Path | None:
        """Folder (or single file) of the package that contains it; None if not found.

        Does not import anything.
        """
        return _place(self._module)

    @property
    def _module(self) -> str:
        return self.target.partition(':')[0].partition('.')[0]

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the distribution's name and version and all files of its packages.

        Raises:
            UsageError: the package is missing or cannot be read.
        """
        package = self.package
        if package is None:
            raise UsageError(f'{self.words}: {self.target}: no such package')
        beside = map(_place, sorted(_top_level(self.distribution) - {self._module}))
        digest = hashlib.sha256(f'{self.distribution} {self.version}\n'.encode())
        for place in (package, *filter(None, beside)):
            for path in _files(place):
                try:
                    content = path.read_bytes()
                except OSError as error:
                    raise UsageError(f'{self.words}: {path}: {error.strerror}') from error
                name = path.relative_to(place.parent).as_posix()
                digest.update(f'{name} {hashlib.sha256(content).hexdigest()}\n'.encode())
        return digest.hexdigest()

    def load(self) -> Any:
        """Import and return the object.

        Raises:
            UsageError: its package cannot be imported, or has no such object.
        """
        import importlib

        module, _, attributes = self.target.partition(':')
        try:
            # Standard output is reserved for results.
            with contextlib.redirect_stdout(sys.stderr):
                return functools.reduce(
                    getattr, attributes.split('.'), importlib.import_module(module)
                )
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # anything, including SystemExit
            raise self.failure(error) from error

    def failure(self, error: BaseException) -> UsageError:
        """Create the error that reports an exception of its code."""
        text = str(error).partition('\n')[0]
        said = type(error).__name__ + (f': {text}' if text else '')
        cut = f'{said[:_SAID_CHARACTERS]}…' if len(said) > _SAID_CHARACTERS else said
        return UsageError(plain_line(f'{self.words}: {self.target}: {cut}'))


def _place(module: str) -> Path | None:
    """Folder (or single file) of a top-level module, without importing it; None if not found."""
    import importlib.util

    with contextlib.suppress(ImportError, ValueError, AttributeError):
        spec = importlib.util.find_spec(module)
        if spec is not None and spec.origin is not None:
            origin = Path(spec.origin)
            return origin.parent if origin.name == '__init__.py' else origin
    return None


def _files(place: Path) -> list[Path]:
    return sorted(
        path for path in (place.rglob('*') if place.is_dir() else [place])
        if path.is_file() and path.suffix != '.pyc'
    )


def _top_level(distribution: str) -> set[str]:
    """Top-level modules and packages of a distribution, as far as its metadata list them."""
    from importlib import metadata

    try:
        found = metadata.distribution(distribution)
    except metadata.PackageNotFoundError:
        return set()
    told = (found.read_text('top_level.txt') or '').split()  # editable installs record no files
    installed = (
        file.parts[0].partition('.')[0] for file in found.files or ()
        if file.suffix in _CODE and not file.name.startswith('__editable__')
    )
    return {name for name in (*told, *installed) if name.isidentifier()}


def find(kind: str, name: str) -> Extension | None:
    """Find the extension installed under a name; None if there is none.

    Args:
        kind: extension point.
        name: name given by the user.

    Raises:
        UsageError: two packages provide the name, or it is not a valid extension name.
    """
    found = [one for one in installed(kind) if one.name == name]
    if not found:
        return None
    if len(found) > 1:
        told = ' and '.join(f'{one.distribution} {one.version} ({one.target})' for one in found)
        raise UsageError(f'{kind.removesuffix("s")} {name}: there are two, of {told}; '
                         'uninstall one')
    if not _NAME.fullmatch(name) or name in RESERVED:
        raise UsageError(f'{found[0].words}: the name cannot be used: letters, digits, _ and - '
                         f'only, and none of {", ".join(sorted(RESERVED))}')
    return found[0]


def origin_words(kind: str, name: str) -> str:
    """``NAME of PACKAGE VERSION`` for an added extension; '' for anything else."""
    found = None if name in RESERVED else find(kind, name)
    if found is None or found.shipped:
        return ''
    return f'{found.name} of {found.distribution} {found.version}'


def installed(kind: str) -> list[Extension]:
    """All extensions of an extension point, usable or not; shipped ones first."""
    ours = [
        Extension(kind=kind, name=name, target=target, distribution=OURS, version=__version__)
        for name, target in SHIPPED[kind].items()
    ]
    return [*ours, *_foreign(kind)]


def names(kind: str) -> list[str]:
    """Names that :func:`find` accepts; shipped ones first."""
    return list(dict.fromkeys(one.name for one in installed(kind)))


def known(kind: str, *more: str) -> str:
    """Text after ``known:`` in an unknown-name error: names, other words, providing packages.

    Args:
        kind: extension point.
        more: descriptions of other accepted values.
    """
    return f'{", ".join([*names(kind), *more])}; packages add more by {OURS}.{kind}'


def plugins() -> str:
    """Packages that add extensions, with their versions, for records; '' if there are none."""
    return ', '.join(sorted({
        f'{one.distribution} {one.version}' for kind in SHIPPED for one in _foreign(kind)
    }))


def origins(**chosen: str) -> dict[str, dict[str, str]]:
    """Origins of the selected extensions, for records; shipped ones are omitted.

    Args:
        chosen: name by extension point.
    """
    found = {kind: find(kind, name) for kind, name in chosen.items()}
    return {
        kind: {
            'name': one.name, 'distribution': one.distribution, 'version': one.version,
            'sha256': one.fingerprint,
        }
        for kind, one in found.items() if one is not None and not one.shipped
    }


class Extensions(Mapping[str, _T], Generic[_T]):
    """Mapping of all extensions of a kind by name; loads them on lookup."""

    def __init__(self, kind: str, read: Callable[[Extension, Any], _T]) -> None:
        """Create the mapping; nothing is loaded yet.

        Args:
            kind: extension point.
            read: converts an extension and its loaded object to the value, or raises UsageError.
        """
        self._kind, self._read = kind, read

    def __getitem__(self, name: str) -> _T:
        found = find(self._kind, name)
        if found is None:
            raise KeyError(name)
        return self._read(found, found.load())

    def __contains__(self, name: object) -> bool:
        return name in names(self._kind)

    def __iter__(self) -> Iterator[str]:
        return iter(names(self._kind))

    def __len__(self) -> int:
        return len(names(self._kind))


def _foreign(kind: str) -> tuple[Extension, ...]:
    return _declared(tuple(sys.path)).get(kind, ())


@functools.cache
def _declared(folders: tuple[str, ...]) -> dict[str, tuple[Extension, ...]]:
    """Extensions declared by other installed packages, by kind.

    Importing ``importlib.metadata`` takes longer than all of ``taxinet --help``, so it is imported
    only if some entry-points file contains one of our groups. Every process does the same.
    """
    if not any(map(_declares, folders)):
        return {}
    from importlib.metadata import entry_points

    found = {}
    declared = entry_points()  # it reads those of all packages, whatever it is asked for
    for kind in SHIPPED:
        entries = sorted(
            declared.select(group=f'{OURS}.{kind}'), key=lambda one: (one.name, one.value)
        )
        found[kind] = tuple(
            Extension(
                kind=kind, name=entry.name, target=entry.value,
                distribution=entry.dist.name, version=entry.dist.version,
            )
            for entry in entries
            if entry.dist is not None and entry.dist.name.replace('-', '_') != OURS
        )
    return found


def _declares(folder: str) -> bool:
    """Whether a folder of packages contains another package that adds extensions."""
    try:
        inside = os.listdir(folder or '.')
    except OSError:
        return False
    for name in inside:
        if not name.endswith(('.dist-info', '.egg-info')) or name.startswith(
            (f'{OURS}-', f'{OURS}.egg')
        ):
            continue
        with contextlib.suppress(OSError):
            text = Path(folder or '.', name, 'entry_points.txt').read_bytes()
            if f'[{OURS}.'.encode() in text:
                return True
    return False
