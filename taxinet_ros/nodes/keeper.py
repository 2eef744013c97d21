"""Runs somebody's command as a node of a graph: it and all that it starts end with the graph.

``ros2 run`` starts the node as a child of its own, which would outlive a killed parent. A keeper
inherits whatever its command leaves behind, in whatever session; when the command ends, or the
keeper's parent goes, however it goes, all of it is ended.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from types import FrameType

import psutil

from taxinet_ros.core.parent_death import adopt_orphans, die_with_parent

_ASKED_S, _TOLD_S = 1.5, 1.0
"""What is left to a command after SIGINT, and after SIGTERM, which follows.

Shorter than what whoever ends a keeper waits: what is in another session is known to it alone.
"""

CHILDREN_LEFT = 'keeper: ended what the command left behind: '
"""How the line begins that a keeper prints on processes which outlived its command."""


def keeper_command(command: list[str], parent: int) -> list[str]:
    """What starts a keeper of a command; ``parent`` is the process that starts it."""
    # -P: a module in the user's folder must not stand in for one of ours.
    return [sys.executable, '-P', '-m', 'taxinet_ros.nodes.keeper', str(parent), *command]


def main() -> int:
    """Run the command to its end.

    Returns:
        Its exit code; 127 where it cannot be started.
    """
    parent, command = int(sys.argv[1]), sys.argv[2:]
    signal.signal(signal.SIGINT, _end_soon)
    signal.signal(signal.SIGTERM, _end_group)
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


def _end_soon(number: int, frame: FrameType | None) -> None:
    """The command's group has the signal too: leave it a while to end by itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, _end_group)
    signal.setitimer(signal.ITIMER_REAL, _ASKED_S)


def _end_group(number: int, frame: FrameType | None) -> None:
    """Ask all that the command has started to end, and end them after a grace."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    for process in _descendants():
        with contextlib.suppress(psutil.NoSuchProcess):
            process.terminate()
    signal.signal(signal.SIGALRM, lambda *_: _end_what_is_left())
    signal.setitimer(signal.ITIMER_REAL, _TOLD_S)


def _end_what_is_left() -> None:
    """End what the command has started, in whatever session it is."""
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
