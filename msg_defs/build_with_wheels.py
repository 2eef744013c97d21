"""Build messages into a virtual environment whose ROS 2 came as wheels (no ROS installation).

Builds taxinet_msgs, and the messages used here of geometry2's tf2_msgs, for which there is no
wheel. Run it with the environment's own Python, ``.venv/bin/python msg_defs/build_with_wheels.py``.
It does nothing if the installed messages match the current sources, and keeps a tf2_msgs that was
installed by other means. Arguments are folders of more interface packages, which are built after
these, such as a checkout of simulation_interfaces. If a ROS 2 installation is sourced, use
``colcon build`` instead; it finds the original tf2_msgs.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import subprocess
import sys
import sysconfig
import time
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

SOURCE = Path(__file__).resolve().parent
PREFIX = Path(sys.prefix)
LOG_TAIL_LINES = 30


@dataclass(frozen=True)
class Package:
    """An interface package: its name and source folder."""

    name: str
    source: Path

    @property
    def build(self) -> Path:
        """CMake's build folder."""
        return PREFIX / 'build' / self.name

    @property
    def log(self) -> Path:
        """Log of CMake and the compiler."""
        return self.build / 'build.log'

    @property
    def share(self) -> Path:
        """Folder of the installed definitions."""
        return PREFIX / 'share' / self.name

    @property
    def stamp(self) -> Path:
        """File with the digest of the sources of the installed messages."""
        return self.share / 'sources.sha256'

    @property
    def foreign(self) -> bool:
        """Whether a package of this name was installed by other means."""
        manifest = self.share / 'package.xml'
        own = self.stamp, self.source / 'package.xml'  # An interrupted build leaves no stamp.
        return manifest.exists() and not (
            own[0].exists() or manifest.read_bytes() == own[1].read_bytes()
        )


PACKAGES = (Package('taxinet_msgs', SOURCE), Package('tf2_msgs', SOURCE / 'tf2_msgs'))


def package_in(folder: Path) -> Package:
    """The interface package of a folder, which has its name from its package.xml."""
    name = ElementTree.parse(folder / 'package.xml').findtext('name', '').strip()
    if re.fullmatch('[a-z][a-z0-9_]*', name) is None:
        raise BuildError(f'{folder}/package.xml: {name!r} is no name of a package')
    return Package(name, folder)


class BuildError(Exception):
    """The build failed; the message is for the user."""


def sources_digest(package: Package) -> str:
    """SHA-256 of everything that affects the installed files, including the Python version."""
    digest = hashlib.sha256(sys.version.encode())
    kinds = ('*.txt', '*.xml', 'msg/*.msg', 'srv/*.srv', 'action/*.action')
    found = {path for kind in kinds for path in package.source.glob(kind)}
    for path in sorted({*found, Path(__file__).resolve()}):
        name = os.path.relpath(path, package.source)
        digest.update(f'{name}\0{path.stat().st_size}\0'.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def numpy_include() -> Path:
    """Folder of NumPy's C headers in this environment."""
    spec = importlib.util.find_spec('numpy')
    if spec is None or spec.origin is None:
        raise BuildError('numpy is not installed in this environment; run: make install')
    home = Path(spec.origin).parent
    include = home / '_core' / 'include'
    return include if include.is_dir() else home / 'core' / 'include'  # of NumPy 1


def fix_include_paths() -> None:
    """Point the wheels' exported CMake files at this environment's headers.

    The wheels contain two include paths of their build machine, and CMake rejects include folders
    that do not exist.
    """
    foreign = r'/opt/python/cp\d+-cp\d+'
    fixes = (
        (rf'{foreign}/include/python3\.\d+', sysconfig.get_paths()['include']),
        (r'/[^;" ]+/site-packages/numpy/_?core/include', str(numpy_include())),
    )
    for path in PREFIX.glob('share/*/cmake/*.cmake'):
        before = after = path.read_text(encoding='utf-8')
        for pattern, fix in fixes:
            # Backslashes in a path are not group references.
            after = re.sub(pattern, fix.replace('\\', r'\\'), after)
        if after != before:
            path.write_text(after, encoding='utf-8')


def build_environment() -> dict[str, str]:
    """Environment for CMake with this prefix only, ignoring any sourced ROS installation."""
    sourced = ('PYTHONPATH', 'AMENT_PREFIX_PATH', 'CMAKE_PREFIX_PATH', 'COLCON_PREFIX_PATH')
    environment = {key: value for key, value in os.environ.items() if key not in sourced}
    environment['PATH'] = os.pathsep.join([str(PREFIX / 'bin'), environment.get('PATH', '')])
    environment['AMENT_PREFIX_PATH'] = environment['CMAKE_PREFIX_PATH'] = str(PREFIX)
    return environment


def run_logged(package: Package, command: list[str]) -> None:
    """Run one build step with its output in the log; on failure, show the end of the log."""
    with package.log.open('a', encoding='utf-8') as log:
        log.write(f'$ {" ".join(command)}\n')
        log.flush()
        done = subprocess.run(
            command, stdout=log, stderr=subprocess.STDOUT, env=build_environment(), check=False
        )
    if done.returncode != 0:
        lines = package.log.read_text(encoding='utf-8', errors='replace').splitlines()
        shown = '\n'.join(lines[-LOG_TAIL_LINES:])
        raise BuildError(f'{shown}\n{package.name}: {command[0]} failed; whole log: {package.log}')


def installed_files(package: Package) -> set[Path]:
    """Files that the last build installed, from CMake's install manifest."""
    manifest = package.build / 'install_manifest.txt'
    if not manifest.exists():
        return set()
    return {Path(line) for line in manifest.read_text(encoding='utf-8').splitlines() if line}


def build(package: Package) -> None:
    """Configure, compile and install into this environment; remove files of deleted messages."""
    package.build.mkdir(parents=True, exist_ok=True)
    package.log.write_text('', encoding='utf-8')
    before = installed_files(package)
    cmake = str(PREFIX / 'bin' / 'cmake')
    run_logged(
        package,
        [
            *(cmake, '-S', str(package.source), '-B', str(package.build), '-G', 'Ninja'),
            *('-Wno-dev', f'-DCMAKE_INSTALL_PREFIX={PREFIX}', '-DCMAKE_BUILD_TYPE=Release'),
            *('-DBUILD_TESTING=OFF', '-DPython3_FIND_VIRTUALENV=ONLY'),
            f'-DPython3_EXECUTABLE={sys.executable}',
        ],
    )
    run_logged(package, [cmake, '--build', str(package.build), '--target', 'install'])
    for stale in before - installed_files(package):
        stale.unlink(missing_ok=True)


def bring_up_to_date(package: Package) -> None:
    """Build a package unless it is up to date, and print the result."""
    digest = sources_digest(package)
    if package.foreign:
        print(f'{package.name}: another one is installed in {PREFIX}, and is used')
    elif package.stamp.exists() and package.stamp.read_text(encoding='utf-8') == digest:
        print(f'{package.name}: up to date in {PREFIX}')
    else:
        started = time.monotonic()
        package.stamp.unlink(missing_ok=True)  # An interrupted build is repeated.
        fix_include_paths()
        build(package)
        package.stamp.write_text(digest, encoding='utf-8')
        print(f'{package.name}: built into {PREFIX} in {time.monotonic() - started:.0f} s')


def main() -> int:
    """Build packages that are not up to date; return 0, or 1 if a build step failed."""
    if sys.prefix == sys.base_prefix:
        print(f'messages: {sys.executable} is not in a virtual environment', file=sys.stderr)
        return 1
    try:
        for package in (*PACKAGES, *(package_in(Path(word).resolve()) for word in sys.argv[1:])):
            bring_up_to_date(package)
    except (BuildError, OSError, ElementTree.ParseError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
