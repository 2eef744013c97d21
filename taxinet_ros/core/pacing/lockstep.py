"""The lockstep protocol as a state machine: answers required before time may advance.

The simulator owns one per run. Every frame has a number, and every answer names its frame;
simulated time advances from step k to k+1 only after the command for k has arrived. Participants
outside the control loop (monitor, recorder) report progress instead and may lag by at most
:data:`WINDOW` frames, so their queues cannot overflow. Wall-clock time is not used: the same
answers in any timing give the same run.
"""

from __future__ import annotations

from collections.abc import Sequence

from taxinet_ros.core.verdict.judging import StopOn

WINDOW = 8
"""Maximum lag [frames] of a participant outside the control loop; below the queue depth."""

PROGRESS_EVERY = 4
"""Number of steps between progress reports; the last step is always reported."""


def reports_progress(seq: int, last_seq: int, stop_on: StopOn = StopOn.NEVER) -> bool:
    """Whether a participant outside the control loop reports at this step.

    If a run may end early, every step is reported, because it may be the last.
    """
    any_may_be_last = stop_on is not StopOn.NEVER
    return any_may_be_last or seq % PROGRESS_EVERY == PROGRESS_EVERY - 1 or seq == last_seq


class Lockstep:
    """Bookkeeping of one run's answers."""

    def __init__(
        self, *, participants: Sequence[str], chain: Sequence[str], followers: Sequence[str],
        last_seq: int, enders: Sequence[str] = (),
    ) -> None:
        """Set the participants.

        Args:
            participants: all nodes that must be ready before the first frame.
            chain: nodes that answer one after another within a step, in order; the last answer is
                the command.
            followers: nodes that report progress.
            last_seq: number of the last control step.
            enders: followers that may end the run at any frame; time waits for them as for the
                chain.
        """
        self.last_seq = last_seq
        self.seq = -1
        self._chain = tuple(chain)
        self._not_ready = set(participants)
        self._answered = dict.fromkeys(chain, -1)
        self._progress = {name: -1 for name in followers if name in participants}
        self._enders = frozenset(enders)

    def ready(self, node: str) -> bool:
        """Note that ``node`` is ready; True if it was the last one."""
        if node not in self._not_ready:
            return False
        self._not_ready.discard(node)
        return not self._not_ready

    @property
    def all_ready(self) -> bool:
        """Whether every participant has reported ready."""
        return not self._not_ready

    def begin(self, seq: int, now_s: float = 0.0) -> None:
        """Note a new frame; the lockstep ignores its wall-clock time."""
        self.seq = seq

    def answer(self, node: str, seq: int, now_s: float = 0.0) -> bool:
        """Note the answer of a chain node; False for a stale, repeated or unexpected one."""
        if seq != self.seq or self._answered[node] == seq:
            return False
        self._answered[node] = seq
        return True

    def progress(self, node: str, seq: int, arrived: int = -1, now_s: float = 0.0) -> None:
        """Note the last frame that a follower has processed."""
        if node in self._progress:
            self._progress[node] = max(self._progress[node], seq)

    def end(self, node: str) -> None:
        """End the run at the current frame, which ``node`` has processed."""
        self.last_seq = self.seq
        self.progress(node, self.seq)

    @property
    def complete(self) -> bool:
        """Whether the last frame is answered and every follower has processed it."""
        return self.seq == self.last_seq and not self.missing()

    @property
    def may_advance(self) -> bool:
        """Whether time may advance to the next frame."""
        return self.seq < self.last_seq and not self.missing()

    def missing(self) -> list[str]:
        """Names of awaited nodes.

        In the chain only the first missing one is named, because the others wait for it.
        """
        if self._not_ready:
            return sorted(self._not_ready)
        for node in self._chain:
            if self._answered[node] != self.seq:
                return [node]
        return [node for node, seq in self._progress.items() if seq < self._needed(node)]

    def _needed(self, node: str) -> int:
        """Frame that a follower must have processed by now."""
        at_once = self.seq == self.last_seq or node in self._enders
        return self.seq if at_once else self.seq - WINDOW + 1
