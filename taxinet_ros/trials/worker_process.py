"""A worker's side of the protocol of :mod:`.worker_pool`: requests come in, results go out.

Requests are read in a thread, so that an interrupt arrives during a run.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.trials.worker_pool import encode_line, request_from_json, result_to_json

BEAT_S = 1.0
"""Time between two reports of progress [s]; silence means that a run hangs."""


class Link:
    """The pipes to the parent; messages may be sent from several threads.

    Attributes:
        interrupt: called when the current run is to end in order.
    """

    def __init__(self, answers: int) -> None:
        """``answers``: descriptor that results are written to."""
        self.interrupt: Callable[[], None] = lambda: None
        self._answers = answers
        self._lock = threading.Lock()
        self._requests: queue.SimpleQueue[RunRequest | None] = queue.SimpleQueue()
        self._interrupted = False
        self._told_s = time.monotonic()

    def requests(self) -> Iterator[RunRequest]:
        """Yield the runs as they are asked for, until there are no more or they are interrupted."""
        threading.Thread(target=self._listen, daemon=True).start()
        while not self._interrupted and (request := self._requests.get()) is not None:
            yield request

    def answer(self, request: RunRequest, result: RunResult) -> bool:
        """Send a result; the parent decides whether this worker gets another run."""
        self._say(result=result_to_json(result))
        return True

    def progress(self, seq: int) -> None:
        """Report a control step, unless one was reported just before."""
        if time.monotonic() - self._told_s > BEAT_S:
            self._told_s = time.monotonic()
            self._say(seq=seq)

    def refuse(self, error: UsageError) -> None:
        """Report what the user must fix."""
        self._say(error=str(error))

    def _listen(self) -> None:
        # Unbuffered: an unjoined thread would hold a buffer's lock forever.
        for line in io.FileIO(sys.stdin.fileno(), closefd=False):
            message = json.loads(line)
            if 'run' in message:
                self._requests.put(request_from_json(message['run']))
            else:
                self._interrupted = True
                self._requests.put(None)
                self.interrupt()
        self._requests.put(None)

    def _say(self, **message: Any) -> None:
        with self._lock:
            os.write(self._answers, encode_line(message))


def serve(work: Callable[[dict[str, Any], Link], None], words: Sequence[str] | None = None) -> int:
    """The main function of a worker.

    Args:
        work: makes the runs of a link, by the worker's options.
        words: command-line arguments; None for those of this process.

    Returns:
        Exit code: 0, or 2 after a usage error.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument('--answers', type=int, required=True)
    parser.add_argument('--options', required=True)
    arguments = parser.parse_args(words)
    link = Link(arguments.answers)
    try:
        work(json.loads(arguments.options), link)
    except UsageError as error:
        link.refuse(error)
        return ExitCode.USAGE
    return ExitCode.OK
