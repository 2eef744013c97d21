"""Limits of time and memory for reading a bag, as protection against malicious files.

The limits of :mod:`.storage.records` apply to the content of chunks. They cannot bound the decoding
of messages, where a definition may turn a megabyte into a million objects; so CPU time and memory
of this process are limited too.
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
"""CPU time allowed for a bag of any size [s]."""

S_PER_MIB = 10.0
"""Additional CPU time per MiB [s]; about a hundred times what recordings need."""

FREE_BYTES = 2 << 30
"""Additional address space allowed for a bag of any size."""

BYTES_PER_BYTE = 64
"""Additional address space per byte of the bag."""

_AGAIN_S = 0.5


class _TookTooLongError(BaseException):
    """Derived from BaseException, so that no ``except Exception`` catches it."""


@contextlib.contextmanager
def limited_reading(
    *bags: Path, error: Callable[[str], Exception] = BagCorrupt
) -> Iterator[None]:
    """Context in which reading is aborted when it exceeds the limits for the bags' size.

    Only the main thread is limited. In nested contexts the outermost one applies.

    Raises:
        error: CPU time or memory exceeded the limit.
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
    """Return :func:`limited_reading` for a command; exceeding the limits is a usage error."""
    return limited_reading(*bags, error=UsageError)


@contextlib.contextmanager
def _memory(more_bytes: int) -> Iterator[None]:
    """Limit the growth of this process's address space."""
    before, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path('/proc/self/statm').read_text().split()[0])
    limit = pages * resource.getpagesize() + more_bytes
    known = [one for one in (before, hard) if one != resource.RLIM_INFINITY]
    hook = sys.unraisablehook

    def quiet(unraisable: sys.UnraisableHookArgs) -> None:
        # Generators are closed while unwinding, when memory is still exhausted.
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
