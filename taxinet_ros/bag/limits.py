"""Limits of time and memory for reading a bag, as protection against malicious files.

The limits of :mod:`.parse` hold for what is in chunks. What its definitions make of a message, a
million objects out of a megabyte, no count of records foresees; so the processor's clock decides,
and the size of this process.
"""

from __future__ import annotations

import contextlib
import resource
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

from taxinet_ros.bag.errors import BagCorrupt
from taxinet_ros.errors import UsageError

FREE_S = 20.0
"""Processor time for a bag of any size."""

S_PER_MIB = 10.0
"""And for each MiB of it; some hundred times what recordings need."""

FREE_BYTES = 2 << 30
"""Address space for a bag of any size, beyond what this process has when it begins."""

BYTES_PER_BYTE = 64
"""And for each byte of it."""

_AGAIN_S = 0.5


class _TookTooLongError(BaseException):
    """No ``except Exception`` on the way may swallow it."""


@contextlib.contextmanager
def limited_reading(
    *bags: Path, error: Callable[[str], Exception] = BagCorrupt
) -> Iterator[None]:
    """Context in which reading is aborted when it exceeds the limits for its size.

    Only the main thread is watched. Within another ``with`` of its kind that one decides.

    Raises:
        error: it took more processor time, or memory.
    """
    alone = signal.getitimer(signal.ITIMER_VIRTUAL)[0] == 0.0
    if not alone or threading.current_thread() is not threading.main_thread():
        yield
        return
    size = sum(_size(bag) for bag in bags)
    allowed_s = FREE_S + S_PER_MIB * size / 2**20
    names = ', '.join(map(str, bags))
    before = signal.signal(signal.SIGVTALRM, _too_long)
    signal.setitimer(signal.ITIMER_VIRTUAL, allowed_s, _AGAIN_S)
    try:
        with _memory(FREE_BYTES + BYTES_PER_BYTE * size):
            yield
    except _TookTooLongError:
        raise error(
            f'{names}: took more than {allowed_s:.0f} s of processor time, too much for a '
            f'recording of {size} bytes; is it a valid recording?'
        ) from None
    except MemoryError:
        raise error(
            f'{names}: took too much memory for a recording of {size} bytes; is it a valid '
            'recording?'
        ) from None
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def read_within_limits(*bags: Path) -> contextlib.AbstractContextManager[None]:
    """:func:`limited_reading` for a command: the bag is the user's to mend."""
    return limited_reading(*bags, error=UsageError)


@contextlib.contextmanager
def _memory(more_bytes: int) -> Iterator[None]:
    """Let this process grow by so much and no further."""
    before, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path('/proc/self/statm').read_text().split()[0])
    limit = pages * resource.getpagesize() + more_bytes
    known = [one for one in (before, hard) if one != resource.RLIM_INFINITY]
    hook = sys.unraisablehook

    def quiet(unraisable: sys.UnraisableHookArgs) -> None:
        # Generators are closed on the way out, where there is no memory for that yet.
        if unraisable.exc_type is not MemoryError:
            hook(unraisable)

    sys.unraisablehook = quiet
    resource.setrlimit(resource.RLIMIT_AS, (min(limit, *known) if known else limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (before, hard))
        sys.unraisablehook = hook


def _size(bag: Path) -> int:
    """Total bytes of a bag's files; 0 if there are none, which reading reports."""
    try:
        files = bag.glob('*.mcap') if bag.is_dir() else [bag]
        return sum(file.stat().st_size for file in files)
    except OSError:
        return 0


def _too_long(*_: object) -> NoReturn:
    raise _TookTooLongError
