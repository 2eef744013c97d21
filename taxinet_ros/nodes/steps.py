"""Puts the messages of one control step together, in whatever order they arrive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Step = tuple[int, dict[str, list[Any]]]
"""Number of a control step, and its messages by topic."""


class StepCollector:
    """Collects so many messages per topic and step, and hands out whole steps in order."""

    def __init__(self, expected: Mapping[str, int]) -> None:
        """``expected``: topic name to number of messages per step."""
        self._expected = dict(expected)
        self._total = sum(expected.values())
        self._pending: dict[int, _Pending] = {}
        self._next = 0
        self.repeated = 0

    def add(self, topic: str, seq: int, message: Any) -> Sequence[Step]:
        """Take one message; answer every step that is now whole, oldest first.

        A message beyond the expected number (a repetition, or one of a step already handed out) is
        counted in :attr:`repeated` and ignored.
        """
        if seq < self._next:
            self.repeated += 1
            return ()
        step = self._pending.get(seq)
        if step is None:
            step = self._pending[seq] = _Pending(self._total)
        messages = step.messages.get(topic)
        if topic in step.excused:
            self.repeated += 1
            return ()
        if messages is None:
            messages = step.messages[topic] = []
        if len(messages) == self._expected[topic]:
            self.repeated += 1
            return ()
        messages.append(message)
        step.missing -= 1
        return () if step.missing or seq != self._next else self._whole()

    def excuse(self, topic: str, seq: int) -> Sequence[Step]:
        """What a topic says of a step does not come, or came for nothing; answer as :meth:`add`."""
        if seq < self._next:
            return ()
        step = self._pending.setdefault(seq, _Pending(self._total))
        if topic not in step.excused:
            step.excused.add(topic)
            step.missing -= self._expected[topic] - len(step.messages.pop(topic, ()))
        return () if step.missing or seq != self._next else self._whole()

    def _whole(self) -> list[Step]:
        whole = []
        while (step := self._pending.get(self._next)) is not None and not step.missing:
            del self._pending[self._next]
            whole.append((self._next, step.messages))
            self._next += 1
        return whole

    def torn(self) -> list[Step]:
        """Steps begun and not whole, oldest first: what an aborted run left behind."""
        return sorted((seq, step.messages) for seq, step in self._pending.items())


class _Pending:
    """Messages of a step by topic, how many are to come, and topics of which none is."""

    __slots__ = ('excused', 'messages', 'missing')

    def __init__(self, missing: int) -> None:
        self.messages: dict[str, list[Any]] = {}
        self.missing = missing
        self.excused: set[str] = set()
