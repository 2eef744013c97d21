"""Run a user's command as a node of a graph, and end all its descendants with the graph.

``ros2 run`` starts the node as its own child, which would outlive a killed parent. The wrapper
adopts orphans of its command, in any session. When the command ends or the wrapper's parent dies
for any reason, all of them are ended.
"""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from types import FrameType

import psutil

from taxinet_ros.processes.child import adopt_orphans, die_with_parent, module_command

SIGINT_GRACE_S, SIGTERM_GRACE_S = 1.5, 1.0
"""Grace periods of a command after SIGINT, and after the SIGTERM that follows.

Shorter than the wait of the process that ends the wrapper, since only the wrapper knows of
processes in other sessions.
"""
CHILDREN_LEFT = 'keeper: ended what the command left behind: '
"""Start of the line a wrapper prints about processes that outlived its command."""


def wrapped_command(
    command: list[str],
    parent: int,
    asked_s: float = SIGINT_GRACE_S,
    told_s: float = SIGTERM_GRACE_S,
) -> list[str]:
    """Command line of the wrapper of a command, with the grace periods after SIGINT and SIGTERM."""
    return module_command(
        'taxinet_ros.nodes.graph.command_wrapper', str(parent), str(asked_s), str(told_s), *command
    )


def main() -> int:
    """Run the command to its end.

    Returns:
        Its exit code; 127 if it cannot be started.
    """
    parent, command = int(sys.argv[1]), sys.argv[4:]
    asked_s, told_s = map(float, sys.argv[2:4])
    end_group = functools.partial(_end_group, told_s)
    signal.signal(signal.SIGINT, functools.partial(_end_soon, asked_s, end_group))
    signal.signal(signal.SIGTERM, end_group)
    die_with_parent(signal.SIGTERM)
    adopt_orphans()
    if os.getppid() != parent:
        return 1
    try:
        child = subprocess.Popen(command, preexec_fn=_usual_signals)
    except OSError as error:
        print(f'{command[0]}: cannot be started: {error.strerror}', flush=True)
        return 127
    code = child.wait()
    _end_what_is_left()
    if code < 0:
        if -code not in (signal.SIGKILL, signal.SIGSTOP):
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    return code


def _usual_signals() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _end_soon(
    after_s: float, end_group: Callable[[int, FrameType | None], None], number: int,
    frame: FrameType | None,
) -> None:
    """Wait for the command to end by itself: its process group received the signal too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, end_group)
    signal.setitimer(signal.ITIMER_REAL, after_s)


def _end_group(grace_s: float, number: int, frame: FrameType | None) -> None:
    """Ask all descendants of the command to end, and kill them after the grace period."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    for process in _descendants():
        with contextlib.suppress(psutil.NoSuchProcess):
            process.terminate()
    signal.signal(signal.SIGALRM, lambda *_: _end_what_is_left())
    signal.setitimer(signal.ITIMER_REAL, grace_s)


def _end_what_is_left() -> None:
    """End the command's descendants in any session."""
    names = []
    for process in _descendants():
        with contextlib.suppress(psutil.NoSuchProcess):
            names.append(f'{process.name()} (pid {process.pid})')
            process.kill()
    if names:
        print(CHILDREN_LEFT + ', '.join(names), flush=True)


def _descendants() -> list[psutil.Process]:
    return psutil.Process().children(recursive=True)

if __name__ == '__main__':
    sys.exit(main())
