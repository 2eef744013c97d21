"""``taxinet`` as a process of its own, and those that it starts."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

COMMAND = [sys.executable, '-P', '-c', 'from taxinet_ros.cli.start import main; main()']
RUN = ('run', 'nominal', '--runs', '3', '--perception', 'truth', '--images', 'none',
       '--set', 'duration=600')


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


class Terminal:
    """A terminal, and the command in its foreground."""

    def __init__(self, words: Sequence[str], cwd: Path, env: Mapping[str, str]) -> None:
        self._ours, theirs = pty.openpty()
        # Whoever runs the tests in the background or under nohup has not begun this command there.
        claim = (
            'import fcntl, os, signal, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); '
            '[signal.signal(number, signal.SIG_DFL) for number in (signal.SIGINT, signal.SIGHUP)]; '
            'os.execv(sys.argv[1], sys.argv[1:])'
        )
        self.process = subprocess.Popen(
            [sys.executable, '-c', claim, *words], stdin=theirs, stdout=theirs, stderr=theirs,
            cwd=cwd, env=env, start_new_session=True,
        )
        os.close(theirs)
        self._shown: list[bytes] = []
        self._closing = threading.Event()
        self._looker = threading.Thread(target=self._look)
        self._looker.start()

    @property
    def shown(self) -> str:
        """What is to be seen so far."""
        return b''.join(self._shown).decode(errors='replace')

    def press(self, *keys: bytes) -> None:
        """Press one key after the other."""
        for key in keys:
            os.write(self._ours, key)

    def close(self) -> None:
        """Close it, as a person closes a window."""
        self._closing.set()
        self._looker.join()

    def _look(self) -> None:
        """Take what is written, for a terminal that nobody reads holds its writers up."""
        with open(self._ours, 'rb', buffering=0) as ours:
            while not self._closing.is_set():
                with contextlib.suppress(OSError):  # EIO once the command is gone
                    if select.select([ours], [], [], 0.05)[0]:
                        self._shown.append(ours.read(4096))


@contextlib.contextmanager
def on_terminal(
    *words: str, cwd: Path, env: Mapping[str, str] = os.environ
) -> Iterator[Terminal]:
    """A program in the foreground of a terminal; neither outlives the test."""
    terminal = Terminal(words, cwd, env)
    try:
        yield terminal
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(terminal.process.pid, signal.SIGKILL)
        terminal.process.wait()
        terminal.close()


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit code, output and complaints of a command that comes to its end."""
    out, err = process.communicate()
    return process.returncode, out, err


@contextlib.contextmanager
def small_disk(place: Path, size: str) -> Iterator[Path]:
    """A disk of its own, mounted at a new folder."""
    place.mkdir()
    words = ['mount', '-t', 'tmpfs', '-o', f'size={size}', 'taxinet-test', str(place)]
    try:
        done = subprocess.run(words, capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip('no mount here; a limit on files stands for it in test_recorded_bag.py')
    if done.returncode:
        pytest.skip(f'may not mount ({done.stderr.strip()}); see test_recorded_bag.py')
    try:
        yield place
    finally:
        subprocess.run(['umount', '-l', str(place)], check=True)
