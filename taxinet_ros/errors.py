"""Exceptions: usage errors (bad input), infrastructure errors (a part failed), disk errors.

Also the exit codes of commands and nodes.
"""

from __future__ import annotations

import contextlib
import difflib
import enum
import signal
import sys
from collections.abc import Iterable
from enum import IntEnum, unique

MAX_CHARACTERS = 2000
"""Maximum length of a message."""

_WARNED: set[str] = set()


@unique
class ExitCode(IntEnum):
    """Exit code of a command or node.

    Attributes:
        OK: every run satisfied its specifications; the command completed.
        VIOLATED: a run violated one; a comparison found differences.
        USAGE: bad input, :class:`UsageError`.
        INCOMPLETE: the result is based on partial data, or there is too little data.
        INFRA: the test bench or the disk failed, :class:`InfraError` and :class:`RecordError`.
        INTERRUPTED: ended by Ctrl-C; 128 plus the signal number, as in shells (POSIX.1-2024, XCU
            section 2.8.2).
        TERMINATED: ended by SIGTERM; likewise.
        UNREAD: the reader of the output closed it.
    """

    OK = 0
    VIOLATED = 1
    USAGE = 2
    INCOMPLETE = 3
    INFRA = 4
    INTERRUPTED = 128 + signal.SIGINT
    UNREAD = 128 + signal.SIGPIPE
    TERMINATED = 128 + signal.SIGTERM


def plain_line(text: str) -> str:
    """Make a text safe to print on one terminal line.

    Messages may quote untrusted bags or files: line breaks and other control characters are
    escaped, and text beyond :data:`MAX_CHARACTERS` is cut.
    """
    if len(text) > MAX_CHARACTERS:
        text = f'{text[:MAX_CHARACTERS]}…'
    if text.isprintable():
        return text
    return ''.join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def near_miss(word: str, known: Iterable[str]) -> str:
    """``; did you mean taxinet?`` where a known word is near a misspelt one, else ''."""
    near = difflib.get_close_matches(word, list(known), 1)
    return f'; did you mean {near[0]}?' if near else ''


def warn_once(text: str) -> None:
    """Print a warning on stderr, once per process."""
    if text in _WARNED or sys.stderr is None:  # None: closed before Python started
        return
    _WARNED.add(text)
    with contextlib.suppress(OSError, ValueError):  # stderr is closed
        print(f'taxinet: warning: {plain_line(text)}', file=sys.stderr)


class UsageError(Exception):
    """Bad input. The one-line message says what is wrong, where, and the fix. CLI exit 2."""

    def __init__(self, message: str) -> None:
        super().__init__(plain_line(message))


class RecordError(Exception):
    """A result cannot be saved: the destination is full, closed or gone. CLI exit 4.

    Unlike an invalid destination, which is rejected at the start, this happens during the work;
    everything recorded before it is kept.
    """

    def __init__(self, message: str) -> None:
        super().__init__(plain_line(message))


class InfraKind(enum.StrEnum):
    """How a part of the test bench failed. ``docs/faults.md`` and ``RunStatus.msg`` list them."""

    NOT_READY = 'not_ready'
    """A node was missing or not ready in time."""
    TIMEOUT = 'timeout'
    """A node or process was silent for too long."""
    DIED = 'died'
    """A process ended."""
    NODE_ERROR = 'node_error'
    """A node reported an error and stopped."""
    PROTOCOL = 'protocol'
    """A node violated the lockstep protocol."""
    SIM = 'sim'
    """The simulator or JSBSim failed."""
    BAG = 'bag'
    """The run could not be recorded completely."""
    INVALID_RUN = 'invalid_run'
    """The monitor had no complete, finite sequence of samples."""
    BUSY = 'busy'
    """The simulator is busy with another client's run."""
    INTRUDER = 'intruder'
    """A node outside the run publishes on one of its topics."""


class InfraError(Exception):
    """A part of the test bench failed, so the run has no verdict. CLI exit 4.

    Attributes:
        kind: an :class:`InfraKind`, or the word used by a third-party simulator.
        who: name of the node or part that failed.
        step: control step at which it happened, or -1 before the first.
    """

    def __init__(self, kind: str, who: str, step: int, detail: str) -> None:
        detail = plain_line(detail)  # it may quote what a peer has sent
        super().__init__(f'{kind}: {who}{f" at step {step}" if step >= 0 else ""}: {detail}')
        self.kind = str(kind)
        self.who = who
        self.step = step
        self.detail = detail

    def __reduce__(self) -> tuple[type[InfraError], tuple[str, str, int, str]]:
        """Support pickling across worker processes."""
        return InfraError, (self.kind, self.who, self.step, self.detail)
