"""``taxinet`` as a process of its own, and those that it starts."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

COMMAND = [sys.executable, '-c', 'from taxinet_ros.cli.main import main; main()']


@contextlib.contextmanager
def taxinet(*words: str, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """A command under way, which does not outlive the test."""
    with subprocess.Popen(
        [*COMMAND, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd,
        env={**os.environ, 'COLUMNS': '200'},
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@contextlib.contextmanager
def taxinet_on_terminal(
    *words: str, cwd: Path
) -> Iterator[tuple[subprocess.Popen[bytes], Callable[[], None]]]:
    """A command in the foreground of a terminal, and what closes that."""
    ours, theirs = pty.openpty()
    # Whoever runs the tests under nohup has not had this command begun under it.
    claim = (
        'import fcntl, signal, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); '
        'signal.signal(signal.SIGHUP, signal.SIG_DFL); '
    )
    process = subprocess.Popen(
        [*COMMAND[:2], claim + COMMAND[2], *words], stdin=theirs, stdout=theirs, stderr=theirs,
        cwd=cwd, start_new_session=True,
    )
    os.close(theirs)
    closing = threading.Event()
    looker = threading.Thread(target=_look_at, args=(ours, closing))
    looker.start()

    def close() -> None:
        closing.set()
        looker.join()

    try:
        yield process, close
    finally:
        process.kill()
        process.wait()
        close()


def _look_at(terminal: int, closing: threading.Event) -> None:
    """Take what is written, for a terminal that nobody reads holds its writers up; then close."""
    with open(terminal, 'rb', buffering=0) as shown:
        while not closing.is_set():
            with contextlib.suppress(OSError):  # EIO once the command is gone
                if select.select([shown], [], [], 0.05)[0]:
                    shown.read(4096)


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit code, output and complaints of a command that comes to its end."""
    out, err = process.communicate()
    return process.returncode, out, err
