"""Pipes, sockets and devices where a file is to be read: refused, for they may never end.

Files are opened in many places, and some by libraries, so Python is asked to tell of each.
"""

from __future__ import annotations

import os
import stat
import sys
from typing import Any

from taxinet_ros.core.errors import UsageError

_FOUND = {stat.S_IFIFO: 'a pipe', stat.S_IFSOCK: 'a socket', stat.S_IFCHR: 'a device',
          stat.S_IFBLK: 'a device'}
_watched: list[bool] = []


def refuse_strange_files() -> None:
    """From now on, opening such a thing raises :class:`UsageError`.

    What is named below ``/dev`` itself was meant: ``/dev/null``, ``/dev/stdin``, and the
    ``/dev/fd/63`` of a shell's ``<(command)``.
    """
    if not _watched:
        _watched.append(True)
        sys.addaudithook(_hear)


def _hear(event: str, arguments: tuple[Any, ...]) -> None:
    if event != 'open' or not isinstance(arguments[0], str | bytes):
        return
    path = os.fsdecode(arguments[0])
    if path.startswith(('/dev/', '/proc/')):
        return
    try:
        kind = stat.S_IFMT(os.stat(path).st_mode)
    except (OSError, ValueError):
        return
    if kind in _FOUND:
        raise UsageError(f'{path}: is {_FOUND[kind]}, no regular file')
