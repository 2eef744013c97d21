"""Build taxinet_msgs into a virtual environment whose ROS 2 came as wheels (no ROS installation).

Run it with the environment's own Python, ``.venv/bin/python msg_defs/build_with_wheels.py``. It
does nothing when the installed messages stem from the present sources already. Where a ROS 2
installation is sourced, use ``colcon build`` instead.
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
from pathlib import Path

PACKAGE = 'taxinet_msgs'
SOURCE = Path(__file__).resolve().parent
PREFIX = Path(sys.prefix)
BUILD = PREFIX / 'build' / PACKAGE
LOG = BUILD / 'build.log'
STAMP = PREFIX / 'share' / PACKAGE / 'sources.sha256'
LOG_TAIL_LINES = 30


class BuildError(Exception):
    """The build cannot go on; the message is what to tell the user."""


def sources_digest() -> str:
    """SHA-256 over everything that decides what gets installed, the Python version included."""
    digest = hashlib.sha256(sys.version.encode())
    kinds = ('*.txt', '*.xml', '*.py', 'msg/*.msg', 'srv/*.srv', 'action/*.action')
    for path in sorted(path for kind in kinds for path in SOURCE.glob(kind)):
        digest.update(f'{path.relative_to(SOURCE)}\0{path.stat().st_size}\0'.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def numpy_include() -> Path:
    """Folder of NumPy's C headers in this environment."""
    spec = importlib.util.find_spec('numpy')
    if spec is None or spec.origin is None:
        raise BuildError('numpy is not installed in this environment; run: make install')
    return Path(spec.origin).parent / '_core' / 'include'


def mend_include_paths() -> None:
    """Point the wheels' exported CMake files at this environment's headers.

    The wheels carry two include folders of the machine that built them, which exist nowhere else;
    CMake refuses to configure against a missing include folder.
    """
    foreign = r'/opt/python/cp\d+-cp\d+'
    mends = (
        (rf'{foreign}/include/python3\.\d+', sysconfig.get_paths()['include']),
        (rf'{foreign}/lib/python3\.\d+/site-packages/numpy/_core/include', str(numpy_include())),
    )
    for path in PREFIX.glob('share/*/cmake/*.cmake'):
        before = after = path.read_text(encoding='utf-8')
        for pattern, mend in mends:
            # Backslashes in a path are no group references.
            after = re.sub(pattern, mend.replace('\\', r'\\'), after)
        if after != before:
            path.write_text(after, encoding='utf-8')


def build_environment() -> dict[str, str]:
    """Environment for CMake: this prefix only, whatever other ROS the shell has sourced."""
    sourced = ('PYTHONPATH', 'AMENT_PREFIX_PATH', 'CMAKE_PREFIX_PATH', 'COLCON_PREFIX_PATH')
    environment = {key: value for key, value in os.environ.items() if key not in sourced}
    environment['PATH'] = os.pathsep.join([str(PREFIX / 'bin'), environment.get('PATH', '')])
    environment['AMENT_PREFIX_PATH'] = environment['CMAKE_PREFIX_PATH'] = str(PREFIX)
    return environment


def run_logged(command: list[str]) -> None:
    """Run one build step with its output in the log; on failure show the log's tail."""
    with LOG.open('a', encoding='utf-8') as log:
        log.write(f'$ {" ".join(command)}\n')
        log.flush()
        done = subprocess.run(
            command, stdout=log, stderr=subprocess.STDOUT, env=build_environment(), check=False
        )
    if done.returncode != 0:
        tail = LOG.read_text(encoding='utf-8', errors='replace').splitlines()[-LOG_TAIL_LINES:]
        shown = '\n'.join(tail)
        raise BuildError(f'{shown}\n{PACKAGE}: {command[0]} failed; whole log: {LOG}')


def installed_files() -> set[Path]:
    """Files that the last build installed, after CMake's own list."""
    manifest = BUILD / 'install_manifest.txt'
    if not manifest.exists():
        return set()
    return {Path(line) for line in manifest.read_text(encoding='utf-8').splitlines() if line}


def build() -> None:
    """Configure, compile and install into this environment; drop files of deleted messages."""
    BUILD.mkdir(parents=True, exist_ok=True)
    LOG.write_text('', encoding='utf-8')
    before = installed_files()
    cmake = str(PREFIX / 'bin' / 'cmake')
    run_logged(
        [
            *(cmake, '-S', str(SOURCE), '-B', str(BUILD), '-G', 'Ninja', '-Wno-dev'),
            *(f'-DCMAKE_INSTALL_PREFIX={PREFIX}', '-DCMAKE_BUILD_TYPE=Release'),
            *('-DBUILD_TESTING=OFF', '-DPython3_FIND_VIRTUALENV=ONLY'),
            f'-DPython3_EXECUTABLE={sys.executable}',
        ]
    )
    run_logged([cmake, '--build', str(BUILD), '--target', 'install'])
    for stale in before - installed_files():
        stale.unlink(missing_ok=True)


def main() -> int:
    """Build unless up to date; 0 on success, 1 when a build step failed."""
    if sys.prefix == sys.base_prefix:
        print(f'{PACKAGE}: {sys.executable} is not in a virtual environment', file=sys.stderr)
        return 1
    digest = sources_digest()
    if STAMP.exists() and STAMP.read_text(encoding='utf-8') == digest:
        print(f'{PACKAGE}: up to date in {PREFIX}')
        return 0
    started = time.monotonic()
    try:
        mend_include_paths()
        build()
    except BuildError as error:
        print(error, file=sys.stderr)
        return 1
    STAMP.write_text(digest, encoding='utf-8')
    print(f'{PACKAGE}: built into {PREFIX} in {time.monotonic() - started:.0f} s')
    return 0


if __name__ == '__main__':
    sys.exit(main())
