"""Runs somebody's command as a node of a graph: it and all that it starts end with the graph.

``ros2 run`` starts the node as a child of its own, which would outlive a killed parent. A keeper is
the leader of a process group of its own; when its parent goes, however it goes, the group is ended.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from types import FrameType

from taxinet_ros.core.parent_death import die_with_parent

_GRACE_S = 5.0


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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the group has it too: the command answers
    signal.signal(signal.SIGTERM, _end_group)
    die_with_parent(signal.SIGTERM)
    if os.getppid() != parent:
        return 1
    try:
        child = subprocess.Popen(command, preexec_fn=_usual_signals)
    except OSError as error:
        print(f'{command[0]}: cannot be started: {error.strerror}', flush=True)
        return 127
    code = child.wait()
    if code < 0:
        signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    return code


def _usual_signals() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _end_group(number: int, frame: FrameType | None) -> None:
    """Ask all of the group to end, and end them after a grace."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.killpg(0, signal.SIGTERM)
    signal.signal(signal.SIGALRM, lambda *_: os.killpg(0, signal.SIGKILL))
    signal.setitimer(signal.ITIMER_REAL, _GRACE_S)


if __name__ == '__main__':
    sys.exit(main())
