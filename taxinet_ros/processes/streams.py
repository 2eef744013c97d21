"""Standard streams that are closed from the start, or come to be."""

from __future__ import annotations

import os
import sys


def fill_standard_descriptors() -> None:
    """Ensure that 0, 1 and 2 are open, so that no file or pipe becomes a standard stream."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)


def fill_standard_streams() -> None:
    """Let standard streams that are closed read and write nothing."""
    fill_standard_descriptors()
    sys.stdin = sys.stdin or os.fdopen(0, closefd=False)
    sys.stdout = sys.stdout or os.fdopen(1, 'w', closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, 'w', closefd=False)


def drop_output(*descriptors: int) -> None:
    """Let standard streams write to nowhere from now on."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in descriptors:
        os.dup2(nowhere, descriptor)
    os.close(nowhere)


def is_closed(descriptor: int) -> bool:
    """Whether nothing can be written to a descriptor, as to a closed terminal."""
    try:
        os.write(descriptor, b'')
    except OSError:
        return True
    return False
