"""Exceptions: usage errors (bad input), infrastructure errors (a part failed), disk errors.

Also the exit codes of commands and nodes.
"""

from __future__ import annotations

import contextlib
import enum
import signal
import sys
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
        INTERRUPTED: by Ctrl-C; as shells say it, with 128 and the signal's number (POSIX.1-2024,
            XCU section 2.8.2).
        TERMINATED: likewise by SIGTERM.
        UNREAD: nobody reads the output any more.
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
    """A text as one line that a terminal shows as it is.

    What is quoted in a message may come from a bag or a file of anybody's: line breaks and other
    signs that a terminal obeys are spelled out, and what is beyond :data:`MAX_CHARACTERS` is cut.
    """
    if len(text) > MAX_CHARACTERS:
        text = f'{text[:MAX_CHARACTERS]}…'
    if text.isprintable():
        return text
    return ''.join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def warn_once(text: str) -> None:
    """Print a line on stderr on what is not as safe as it may seem, the first time it is found."""
    if text in _WARNED or sys.stderr is None:  # None: it was closed before Python started
        return
    _WARNED.add(text)
    with contextlib.suppress(OSError, ValueError):  # nobody reads it any more
        print(f'taxinet: warning: {plain_line(text)}', file=sys.stderr)


class UsageError(Exception):
    """Bad input. The message is one line: what is wrong, where, and how to mend it. CLI exit 2."""

    def __init__(self, message: str) -> None:
        super().__init__(plain_line(message))


class RecordError(Exception):
    """What was found out cannot be kept: its place is full, closed or gone. CLI exit 4.

    Unlike a place that is named wrongly at the start, this comes amid the work, and what was
    recorded before it stays.
    """

    def __init__(self, message: str) -> None:
        super().__init__(plain_line(message))


class InfraKind(enum.StrEnum):
    """How a part of the test bench failed. ``docs/faults.md`` and ``RunStatus.msg`` list them."""

    NOT_READY = 'not_ready'
    """A node was not there, or not ready, in time."""
    TIMEOUT = 'timeout'
    """A node or process was silent for too long."""
    DIED = 'died'
    """A process ended."""
    NODE_ERROR = 'node_error'
    """A node could not go on, and said why."""
    PROTOCOL = 'protocol'
    """A node gave an answer that cannot be one: it does not keep to the lockstep."""
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
        super().__init__(f'{kind}: {who}{f" at step {step}" if step >= 0 else ""}: {detail}')
        self.kind = str(kind)
        self.who = who
        self.step = step
        self.detail = detail

    def __reduce__(self) -> tuple[type[InfraError], tuple[str, str, int, str]]:
        """Support pickling across worker processes."""
        return InfraError, (self.kind, self.who, self.step, self.detail)
