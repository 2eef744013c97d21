"""Child processes: start, limit, watch and end them.

Limits of the operating system (setrlimit(2)) hold in native code, too, which no timer of Python's
interrupts. A process sets them before it touches what it is to be protected from. A child can ask
Linux to end it when its parent goes, however it goes (prctl(2)).
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

Ladder = Sequence[tuple[signal.Signals, float]]
"""Signals that ask a process to end, each with the grace that follows it [s]."""
SOFT: Ladder = ((signal.SIGTERM, 5.0),)
"""For processes without state to save."""
IN_ORDER: Ladder = ((signal.SIGINT, 5.0), (signal.SIGTERM, 2.0))
"""As a user would: Ctrl-C first."""
_LAST_GRACE_S = 60.0
_LAST_BYTES = 4096


def module_command(module: str, *words: str) -> list[str]:
    """Command line of a module of this package with this Python."""
    # -P: a random.py in the user's folder must not become the standard library's.
    return [sys.executable, '-P', '-m', module, *words]


def package_environment() -> dict[str, str]:
    """This very package wherever the child runs; else as a shell would start it."""
    here = str(Path(taxinet_ros.__file__).resolve().parents[1])
    path = os.pathsep.join(part for part in (here, os.environ.get('PYTHONPATH', '')) if part)
    return {**os.environ, 'PYTHONPATH': path}


def child_environment() -> dict[str, str]:
    """This very package, the same hash order every time, and no idle threads for matrices."""
    fixed = {'PYTHONHASHSEED': '0', 'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1'}
    return {**package_environment(), **fixed}


class ChildProcess:
    """A child process; a context manager that leaves nothing behind.

    It leads its own session: Ctrl-C in the terminal goes to this process, which then ends its
    children in order.

    Attributes:
        name: display name, for messages.
        log: file that takes, at its end, what it prints; None where that goes elsewhere.
        process: the one that runs now, or ran last.
    """

    def __init__(
        self, name: str, command: Sequence[str], *, log: Path | None = None,
        environment: Mapping[str, str] | None = None, folder: Path | None = None,
        stdin: int = subprocess.DEVNULL, stdout: int | IO[Any] | None = None,
        stderr: int | IO[Any] | None = None, descriptors: Sequence[int] = (),
        new_session: bool = True, killed_with_parent: bool = False, signals_held: bool = False,
    ) -> None:
        """Start it.

        Args:
            name: display name, for messages.
            command: program and arguments, see :func:`module_command`.
            log: file that takes what it prints, in the place of ``stdout`` and ``stderr``.
            environment: all of it; :func:`child_environment` where None.
            folder: where it runs; here where None.
            stdin: as :class:`subprocess.Popen` takes it.
            stdout: likewise.
            stderr: likewise.
            descriptors: further ones that it has, see :func:`open_pipe`.
            new_session: False for a process group of its own in this session, so that its terminal
                is this process's, but Ctrl-C there is not for it.
            killed_with_parent: whether Linux kills it when this thread goes. It is killed and not
                asked, for one that hangs or is stopped would not hear.
            signals_held: whether SIGINT, SIGTERM and SIGHUP wait until the program lets them come:
                Python has no better answer than a traceback to what comes while it starts.

        Raises:
            OSError: there is no such program, or the log cannot be written.
        """
        self.name = name
        self.log = log
        self._command = list(command)
        self._environment = child_environment() if environment is None else dict(environment)
        self._folder = folder
        self._streams = {'stdin': stdin, 'stdout': stdout, 'stderr': stderr}
        self._descriptors = tuple(descriptors)
        self._new_session = new_session
        self._before = (killed_with_parent, signals_held)
        self.start()

    def start(self) -> None:
        """Start it, or start it again."""
        before = functools.partial(_before_program, os.getpid(), *self._before)
        with contextlib.ExitStack() as files:
            streams: dict[str, Any] = self._streams
            if self.log is not None:
                log = files.enter_context(self.log.open('ab'))
                streams = {**streams, 'stdout': log, 'stderr': subprocess.STDOUT}
            self.process: subprocess.Popen[bytes] = subprocess.Popen(
                self._command, **streams, env=self._environment, cwd=self._folder,
                pass_fds=self._descriptors, start_new_session=self._new_session,
                process_group=None if self._new_session else 0,
                preexec_fn=before if any(self._before) else None,
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
        """Its exit code, negative for a signal; None until its end has been observed."""
        return self.process.returncode

    @property
    def dead(self) -> bool:
        """Whether it has ended, for any reason."""
        return self.process.poll() is not None

    def send(self, number: signal.Signals) -> None:
        """Send a signal to it and to all of its group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def kill(self) -> None:
        """Kill it and all of its group."""
        self.send(signal.SIGKILL)

    def wait(self, timeout_s: float | None = None) -> int | None:
        """Its exit code once it has ended, negative for a signal; None after ``timeout_s``."""
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None

    def end(self, ladder: Ladder = SOFT) -> None:
        """Have it end, see :func:`end_all`."""
        end_all([self], ladder)
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()

    def how_it_ended(self) -> str:
        """Its exit code or signal, and the last line of a log that says why."""
        if self.code is None:
            return 'outlives SIGKILL'
        last = self.last_line() if self.code > 0 else ''
        return f'{exit_words(self.code)}: {last}' if last else exit_words(self.code)

    def last_line(self, but: str | None = None) -> str:
        """The last line in its log that does not begin with ``but``, or ''."""
        if self.log is None:
            return ''
        with self.log.open('rb') as log:
            log.seek(max(0, self.log.stat().st_size - _LAST_BYTES))
            lines = log.read().decode(errors='replace').strip().splitlines()
        told = [line for line in lines if but is None or not line.startswith(but)]
        return told[-1] if told else ''


def end_all(children: Iterable[ChildProcess], ladder: Ladder = SOFT) -> list[str]:
    """End processes with a sequence of signals, finally SIGKILL, leaving no orphans.

    Args:
        children: all that are to end.
        ladder: what asks them before they are killed.

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
    """The children that are still alive after a time."""
    deadline = time.monotonic() + grace_s
    return [
        child for child in children
        if child.wait(max(0.0, deadline - time.monotonic())) is None
    ]


def exit_words(code: int) -> str:
    """Text on how a process ended, by its exit code (negative for a signal)."""
    return f'killed by {signal_name(-code)}' if code < 0 else f'exit code {code}'


def signal_name(number: int) -> str:
    """As in ``kill -l``; real-time signals have no names of their own."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f'signal {number}'


def open_pipe() -> tuple[int, int]:
    """A pipe's end to read and end to write, of which none is a standard stream."""
    fill_standard_descriptors()
    return os.pipe()


def fill_standard_descriptors() -> None:
    """Ensure that 0, 1 and 2 are open, so that no file or pipe becomes a standard stream."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)


def limit_memory(most_bytes: int) -> None:
    """Limit the address space of this process; allocations beyond it fail."""
    _lower(resource.RLIMIT_AS, most_bytes)


def limit_cpu(most_s: int) -> None:
    """Limit the processor time of this process; SIGXCPU ends it then."""
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


def _before_program(parent: int, killed_with_parent: bool, signals_held: bool) -> None:
    """In a child, between fork and exec."""
    if signals_held:
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    if killed_with_parent:
        die_with_parent(signal.SIGKILL)
        if os.getppid() != parent:  # The parent died before the call.
            os.kill(os.getpid(), signal.SIGKILL)
