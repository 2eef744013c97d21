"""Child processes: start, limit, watch and end them.

Operating-system limits (setrlimit(2)) also apply to native code, which Python timers cannot
interrupt. A process sets them before it processes untrusted input. A child can ask Linux to signal
it when its parent dies for any reason (prctl(2)).
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Self

import taxinet_ros
from taxinet_ros.processes.streams import fill_standard_descriptors

Ladder = Sequence[tuple[signal.Signals, float]]
"""Signals that ask a process to end, each with the grace period after it [s]."""
SOFT: Ladder = ((signal.SIGTERM, 5.0),)
"""For processes without state to save."""
IN_ORDER: Ladder = ((signal.SIGINT, 5.0), (signal.SIGTERM, 2.0))
"""Ctrl-C first, as a user would."""
_LAST_GRACE_S = 60.0
_LAST_BYTES = 4096


def module_command(module: str, *words: str) -> list[str]:
    """Command line of a module of this package with this Python."""
    # -P: a random.py in the user's folder must not shadow that of the standard library.
    return [sys.executable, '-P', '-m', module, *words]


def package_environment() -> dict[str, str]:
    """Environment of this process in which a child imports this same package from any folder."""
    here = str(Path(taxinet_ros.__file__).resolve().parents[1])
    path = os.pathsep.join(part for part in (here, os.environ.get('PYTHONPATH', '')) if part)
    return {**os.environ, 'PYTHONPATH': path}


def child_environment() -> dict[str, str]:
    """As :func:`package_environment`, with a fixed hash order and single-threaded BLAS."""
    fixed = {'PYTHONHASHSEED': '0', 'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1'}
    return {**package_environment(), **fixed}


class ChildProcess:
    """A child process; a context manager that leaves nothing behind.

    It leads its own session: Ctrl-C in the terminal goes to this process, which then ends its
    children in order.

    Attributes:
        name: display name, for messages.
        log: file to which its output is appended; None if the output goes elsewhere.
        process: the current or last process.
    """

    def __init__(
        self, name: str, command: Sequence[str], *, log: Path | None = None,
        environment: Mapping[str, str] | None = None, folder: Path | None = None,
        stdin: int = subprocess.DEVNULL, stdout: int | IO[Any] | None = None,
        stderr: int | IO[Any] | None = None, descriptors: Sequence[int] = (),
        new_session: bool = True, killed_with_parent: bool = False,
    ) -> None:
        """Start the process.

        Args:
            name: display name, for messages.
            command: program and arguments, see :func:`module_command`.
            log: file to which output is appended; replaces ``stdout`` and ``stderr``.
            environment: complete environment; None for :func:`child_environment`.
            folder: working directory; None for the current one.
            stdin: as for :class:`subprocess.Popen`.
            stdout: likewise.
            stderr: likewise.
            descriptors: further file descriptors to inherit, see :func:`open_pipe`.
            new_session: False for a process group of its own in this session: it shares this
                terminal, but does not receive its Ctrl-C.
            killed_with_parent: whether Linux sends SIGKILL when this thread ends; a hanging or
                stopped process would not handle other signals.

        Raises:
            OSError: the program does not exist, or the log cannot be written.
        """
        self.name = name
        self.log = log
        self._command = list(command)
        self._environment = child_environment() if environment is None else dict(environment)
        self._folder = folder
        self._streams = {'stdin': stdin, 'stdout': stdout, 'stderr': stderr}
        self._descriptors = tuple(descriptors)
        self._new_session = new_session
        self._killed_with_parent = killed_with_parent
        self.start()

    def start(self) -> None:
        """Start or restart the process."""
        before = functools.partial(_die_with, os.getpid()) if self._killed_with_parent else None
        with contextlib.ExitStack() as files:
            streams: dict[str, Any] = self._streams
            if self.log is not None:
                log = files.enter_context(self.log.open('ab'))
                streams = {**streams, 'stdout': log, 'stderr': subprocess.STDOUT}
            self.process: subprocess.Popen[bytes] = subprocess.Popen(
                self._command, **streams, env=self._environment, cwd=self._folder,
                pass_fds=self._descriptors, start_new_session=self._new_session,
                process_group=None if self._new_session else 0,
                preexec_fn=before,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Kill it if it is alive."""
        self.end(())

    @property
    def pid(self) -> int:
        """Process id."""
        return self.process.pid

    @property
    def code(self) -> int | None:
        """Exit code, negative for a signal; None until its end has been observed."""
        return self.process.returncode

    @property
    def dead(self) -> bool:
        """Whether it has ended, for any reason."""
        return self.process.poll() is not None

    def send(self, number: signal.Signals) -> None:
        """Send a signal to it and its whole process group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def kill(self) -> None:
        """Kill it and its whole process group."""
        self.send(signal.SIGKILL)

    def wait(self, timeout_s: float | None = None) -> int | None:
        """Wait for its end; return the exit code, negative for a signal, or None on timeout."""
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None

    def end(self, ladder: Ladder = SOFT) -> None:
        """End it, see :func:`end_all`."""
        end_all([self], ladder)
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()

    def how_it_ended(self) -> str:
        """Its exit code or signal; after a failure also the last line of its log."""
        if self.code is None:
            return 'outlives SIGKILL'
        last = self.last_line() if self.code > 0 else ''
        return f'{exit_words(self.code)}: {last}' if last else exit_words(self.code)

    def last_line(self, but: str | None = None) -> str:
        """Last line of its log that does not begin with ``but``, or ''."""
        if self.log is None:
            return ''
        try:
            with self.log.open('rb') as log:
                log.seek(max(0, os.fstat(log.fileno()).st_size - _LAST_BYTES))
                lines = log.read().decode(errors='replace').strip().splitlines()
        except FileNotFoundError:  # its folder was moved meanwhile, which others tell
            return ''
        told = [line for line in lines if but is None or not line.startswith(but)]
        return told[-1] if told else ''


def end_all(children: Iterable[ChildProcess], ladder: Ladder = SOFT) -> list[str]:
    """End processes with a sequence of signals, finally SIGKILL, leaving no orphans.

    Args:
        children: processes to end.
        ladder: signals to send before SIGKILL.

    Returns:
        Names of those that had to be killed.
    """
    left = [child for child in children if not child.dead]
    for number, grace_s in ladder:
        for child in left:
            child.send(number)
            child.send(signal.SIGCONT)  # A stopped process handles no other signal.
        left = _outlasting(left, grace_s)
    for child in left:
        child.kill()
    _outlasting(left, _LAST_GRACE_S)
    return [child.name for child in left]


def _outlasting(children: list[ChildProcess], grace_s: float) -> list[ChildProcess]:
    """Children that are still alive after the grace period."""
    deadline = time.monotonic() + grace_s
    return [
        child for child in children
        if child.wait(max(0.0, deadline - time.monotonic())) is None
    ]


def exit_words(code: int) -> str:
    """Describe how a process ended, by its exit code (negative for a signal)."""
    return f'killed by {signal_name(-code)}' if code < 0 else f'exit code {code}'


def signal_name(number: int) -> str:
    """Signal name as in ``kill -l``; real-time signals have none and are given by number."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f'signal {number}'


def open_pipe() -> tuple[int, int]:
    """Create a pipe; return its read and write ends, neither of which is a standard stream."""
    fill_standard_descriptors()
    return os.pipe()


def limit_memory(most_bytes: int) -> None:
    """Limit the address space of this process; allocations beyond it fail."""
    _lower(resource.RLIMIT_AS, most_bytes)


def limit_cpu(most_s: int) -> None:
    """Limit the processor time of this process; SIGXCPU ends it when the time is used up."""
    _lower(resource.RLIMIT_CPU, most_s)


def _lower(limit: int, value: int) -> None:
    _, hard = resource.getrlimit(limit)
    resource.setrlimit(limit, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))


_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_prctl = ctypes.CDLL(None).prctl
"""Looked up at import, because it is not safe between fork and exec."""


def die_with_parent(number: signal.Signals) -> None:
    """Make Linux signal this process when its parent, still alive now, dies (PR_SET_PDEATHSIG)."""
    _prctl(_PR_SET_PDEATHSIG, number)


def adopt_orphans() -> None:
    """Become the reaper of orphaned descendants (PR_SET_CHILD_SUBREAPER)."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def _die_with(parent: int) -> None:
    """Have a child killed with its parent; called between fork and exec."""
    die_with_parent(signal.SIGKILL)
    if os.getppid() != parent:  # The parent died before the call.
        os.kill(os.getpid(), signal.SIGKILL)
