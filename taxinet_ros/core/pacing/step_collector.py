"""Messages of control steps that arrive in any order, collected into whole steps.

The recorder and the monitor use it: their inputs come on many topics, which overtake each other.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

from taxinet_ros.core.topics import COMMAND, ESTIMATE

Step = tuple[int, dict[str, list[Any]]]
"""Control step number and its messages by topic."""


class StepCollector:
    """Collects messages per topic and step, and returns complete steps in order.

    Attributes:
        repeated: number of messages beyond the expected ones.
    """

    def __init__(
        self, expected: Mapping[str, int],
        more: Callable[[int], Mapping[str, int]] | None = None,
    ) -> None:
        """Expect the same in each step, and more in some.

        Args:
            expected: topic name to number of messages per step.
            more: the same of further topics, by step; None: there are none.
        """
        self._expected, self._more = dict(expected), more
        self._pending: dict[int, _Pending] = {}
        self._next = 0
        self.repeated = 0

    def add(self, topic: str, seq: int, message: Any) -> Sequence[Step]:
        """Add one message; return the steps now complete, oldest first.

        A message beyond the expected number (a repetition, or of a step already returned) is
        counted in :attr:`repeated` and ignored.
        """
        if seq < self._next:
            self.repeated += 1
            return ()
        step = self._pending.get(seq)
        if step is None:
            step = self._pending[seq] = self._begun(seq)
        messages = step.messages.get(topic, ())
        if topic in step.excused or len(messages) >= step.expected.get(topic, 0):
            self.repeated += 1
            return ()
        messages = step.messages.setdefault(topic, [])
        messages.append(message)
        step.missing -= 1
        return () if step.missing or seq != self._next else self._whole()

    def settle(self, unestimated: Iterable[int], uncommanded: Iterable[int]) -> list[Step]:
        """Drop the answers that frames of a free run do not get; return as :meth:`add`."""
        settled = ((ESTIMATE.name, unestimated), (COMMAND.name, uncommanded))
        return [
            step for topic, frames in settled for frame in frames
            for step in self._excuse(topic, frame)
        ]

    def torn(self) -> list[Step]:
        """Incomplete steps, oldest first, left by an aborted run."""
        return sorted((seq, step.messages) for seq, step in self._pending.items())

    def _excuse(self, topic: str, seq: int) -> Sequence[Step]:
        """Drop a topic from a step, including messages received."""
        if seq < self._next:
            return ()
        step = self._pending.setdefault(seq, self._begun(seq))
        if topic not in step.excused:
            step.excused.add(topic)
            step.missing -= step.expected[topic] - len(step.messages.pop(topic, ()))
        return () if step.missing or seq != self._next else self._whole()

    def _begun(self, seq: int) -> _Pending:
        more = self._more(seq) if self._more is not None else None
        return _Pending({**self._expected, **more} if more else self._expected)

    def _whole(self) -> list[Step]:
        whole = []
        while (step := self._pending.get(self._next)) is not None and not step.missing:
            del self._pending[self._next]
            whole.append((self._next, step.messages))
            self._next += 1
        return whole


class FreeProgress:
    """What a follower of a free run reports: how far it has come, and its messages."""

    def __init__(self, topics: Collection[str]) -> None:
        """``topics``: those of the simulator that it follows."""
        self._arrived = dict.fromkeys(topics, -1)
        self._reported = (-1, -1)

    def arrived(self, topic: str, seq: int) -> bool:
        """Record the newest message of a topic; False if it is not one of those followed."""
        if topic in self._arrived:
            self._arrived[topic] = seq
        return topic in self._arrived

    def news(self, done: int) -> tuple[int, int] | None:
        """Steps done and arrived, if they have changed since the last report."""
        now = max(done, 0), max(min(self._arrived.values()), 0)
        if now == self._reported:
            return None
        self._reported = now
        return now


class _Pending:
    """Messages of a step by topic, numbers expected and still missing, and excused topics."""

    __slots__ = ('excused', 'expected', 'messages', 'missing')

    def __init__(self, expected: Mapping[str, int]) -> None:
        self.messages: dict[str, list[Any]] = {}
        self.expected = expected
        self.missing = sum(expected.values())
        self.excused: set[str] = set()
