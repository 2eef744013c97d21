"""One stage's command as a process: its terminal is ours, and so is its end."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

import taxinet_ros
from taxinet_ros.campaign.interrupts import interrupts

_GRACE_S = 20.0
"""For a command that was told twice to end, before it is killed."""


def run_child(command: Sequence[str], folder: Path) -> tuple[int, bool]:
    """Run a command to its end.

    It is in a process group of its own, so that Ctrl-C comes to it through us, and once: the first
    one ends what it is at in order, the second one at once.

    Args:
        command: the program with its words.
        folder: where it runs.

    Returns:
        Its exit code, negative for the signal that killed it; and whether we were interrupted.
    """
    process = subprocess.Popen(
        list(command), cwd=folder, stdin=subprocess.DEVNULL, env=_environment(), process_group=0,
    )
    asked: list[bool] = []

    def pass_on() -> None:
        asked.append(True)
        process.send_signal(signal.SIGINT)

    try:
        with interrupts(pass_on):
            return process.wait(), bool(asked)
    except KeyboardInterrupt:
        process.send_signal(signal.SIGINT)
        return _ended(process), True
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def _ended(process: subprocess.Popen[bytes]) -> int:
    try:
        return process.wait(_GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def _environment() -> dict[str, str]:
    """This very package, wherever the command runs; else as a shell would start it."""
    here = str(Path(taxinet_ros.__file__).resolve().parents[1])
    path = os.pathsep.join(part for part in (here, os.environ.get('PYTHONPATH', '')) if part)
    return {**os.environ, 'PYTHONPATH': path}
