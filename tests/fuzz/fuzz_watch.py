"""What no input may make this package do: see :func:`watched`."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from taxinet_ros.bag.errors import BagError
from taxinet_ros.errors import MAX_CHARACTERS, UsageError

CPU_S = 20
"""Processor time for one input: what takes milliseconds has room on the slowest machine."""

MEMORY_BYTES = 1 << 30
"""Address space beyond what the process has when it begins."""

_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGES = frozenset({
    'os.mkdir', 'os.rename', 'os.remove', 'os.rmdir', 'os.link', 'os.symlink', 'os.truncate',
    'os.chmod', 'os.chown', 'shutil.rmtree', 'shutil.move', 'shutil.copyfile',
})
_FORBIDDEN = frozenset({
    'subprocess.Popen', 'os.system', 'os.exec', 'os.fork', 'os.posix_spawn', 'os.kill',
    'socket.connect', 'socket.bind', 'pickle.find_class', 'ctypes.dlopen',
})

_folder: str | None = None
_deeds: list[str] = []


class TookTooLong(BaseException):
    """One input took more processor time than :data:`CPU_S`."""


def _heed(event: str, arguments: tuple[object, ...]) -> None:
    """Note what is done where it must not be; called for everything that Python does."""
    if _folder is None:
        return
    if event in _FORBIDDEN:
        _deeds.append(f'{event} {arguments!r:.200}')
    elif event == 'open' and isinstance(arguments[0], str | bytes):
        flags = arguments[2]
        if isinstance(flags, int) and flags & _WRITES:
            _heed_path(event, arguments[0])
    elif event in ('os.remove', 'os.rmdir') and arguments[1] != -1:
        pass  # shutil.rmtree goes through folders by descriptor; its own event tells which
    elif event in _CHANGES and isinstance(arguments[0], str | bytes):
        _heed_path(event, arguments[0])


def _heed_path(event: str, path: str | bytes) -> None:
    place = os.path.realpath(os.fsdecode(path))
    if place not in (_folder, os.devnull) and not place.startswith(f'{_folder}/'):
        _deeds.append(f'{event} {place}')


sys.addaudithook(_heed)


@contextlib.contextmanager
def watched(folder: Path) -> Iterator[None]:
    """Whatever happens within, happens in little time and memory, and leaves no trace outside.

    No file outside ``folder`` is written, moved or removed; no process, connection or library is
    opened; nothing is imported; no input takes more than :data:`CPU_S` (see :func:`end_of`) or
    more memory than :data:`MEMORY_BYTES`.
    """
    global _folder
    modules = set(sys.modules)
    before = resource.getrlimit(resource.RLIMIT_AS)
    size = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
    old = signal.signal(signal.SIGPROF, _too_long)
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY_BYTES, before[1]))
    _folder = os.path.realpath(folder)
    try:
        yield
    finally:
        _folder = None
        resource.setrlimit(resource.RLIMIT_AS, before)
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, old)
    deeds, _deeds[:] = list(_deeds), []
    assert deeds == [], deeds[:5]
    new = {name.partition('.')[0] for name in set(sys.modules) - modules}
    assert new <= {name.partition('.')[0] for name in modules}


def end_of(use: Callable[[], object]) -> str:
    """``ok``, or the name of the typed error of one line; all other errors come out."""
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    try:
        use()
    except (UsageError, BagError) as error:
        if len(str(error).splitlines()) != 1 or len(str(error)) > 8 * MAX_CHARACTERS:
            raise AssertionError(f'not one line: {str(error)[:2000]!r}') from error
        return type(error).__name__
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return 'ok'


def _too_long(*_: object) -> None:
    raise TookTooLong
