"""One worker of a campaign as its parent sees it: a process, a pipe each way, and the run it is at.

The worker gets ``{"run": …}`` lines on its standard input, and an ``{"interrupt": true}`` line
where it shall end the run at hand; the end of the input ends it. It writes to another descriptor:
``{"seq": n}`` now and then, ``{"result": …}`` after each run, and ``{"error": text}`` before it
leaves for a mistake of the user's.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from taxinet_ros.campaign.wire import line_of, request_to_json
from taxinet_ros.core.child_process import child_environment, fill_standard_descriptors
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult

_GRACE_S = 5.0


class WorkerProcess:
    """A process that runs what it is given.

    Attributes:
        request: the run that it is at, or None.
        seq: the control step that it last reported.
        silent_since: when its last sign of life came, by the monotonic clock [s].
        answers: descriptor to wait on; what comes is read with :meth:`read`.
    """

    def __init__(self, command: Sequence[str], log: Path) -> None:
        """Start it.

        Args:
            command: arguments; ``--parent=<pid>`` and ``--answers=<descriptor>`` are added.
            log: file that takes, at its end, what the process prints.
        """
        self.request: RunRequest | None = None
        self.seq = -1
        self.silent_since = time.monotonic()
        self._log = log
        self._unread = b''
        fill_standard_descriptors()
        self.answers, answers_write = os.pipe()
        own = [f'--parent={os.getpid()}', f'--answers={answers_write}']
        try:
            with log.open('ab') as printed:
                self._process = subprocess.Popen(
                    [*command, *own], stdin=subprocess.PIPE, stdout=printed,
                    stderr=subprocess.STDOUT, pass_fds=(answers_write,), env=child_environment(),
                    # Ctrl-C in the terminal is for the campaign, which then ends its workers.
                    start_new_session=True,
                )
        except BaseException:
            os.close(self.answers)
            raise
        finally:
            os.close(answers_write)

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it is still there."""
        return self._process.poll() is None

    def give(self, request: RunRequest) -> None:
        """Have it run something; if it is dead, its answers' end says so."""
        self.request, self.seq, self.silent_since = request, -1, time.monotonic()
        self._send({'run': request_to_json(request)})

    def interrupt(self) -> None:
        """Have it end the run at hand in order."""
        self.silent_since = time.monotonic()
        self._send({'interrupt': True})

    def read(self) -> list[Mapping[str, Any]] | None:
        """What it has said since the last time; None when it is gone."""
        part = os.read(self.answers, 65536)
        if not part:
            return None
        *lines, self._unread = (self._unread + part).split(b'\n')
        messages = [json.loads(line) for line in lines]
        for message in messages:
            if 'error' in message:
                raise UsageError(message['error'])
            if message.get('seq', self.seq) != self.seq:
                self.seq, self.silent_since = message['seq'], time.monotonic()
        return messages

    def bury(self, kind: str, detail: str = '') -> RunResult:
        """End it at once; the result of the run that it was at."""
        self.end(0.0 if detail else 1.0)
        return RunResult(
            outcome=Outcome.INFRA_ERROR, kind=kind, who='worker',
            detail=detail or self._how_it_died(), last_seq=self.seq,
        )

    def hang_up(self) -> None:
        """Tell it that there is no more to do."""
        with contextlib.suppress(BrokenPipeError):
            assert self._process.stdin is not None
            self._process.stdin.close()

    def end(self, grace_s: float = _GRACE_S) -> None:
        """Wait for it to leave, at most ``grace_s``, then kill it."""
        self.hang_up()
        try:
            self._process.wait(grace_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self.answers >= 0:
            os.close(self.answers)
        self.answers = -1

    def _send(self, message: Mapping[str, Any]) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(line_of(message))
            self._process.stdin.flush()

    def _how_it_died(self) -> str:
        code = self._process.returncode
        if code < 0:
            return f'killed by {signal.Signals(-code).name}'
        lines = self._log.read_text(errors='replace').strip().splitlines()
        return f'exit code {code}' + (f': {lines[-1]}' if lines and code > 0 else '')
