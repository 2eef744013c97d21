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
        self._pending: dict[int, dict[str, list[Any]]] = {}
        self._counts: dict[int, int] = {}
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
        messages = self._pending.setdefault(seq, {}).setdefault(topic, [])
        if len(messages) == self._expected[topic]:
            self.repeated += 1
            return ()
        messages.append(message)
        count = self._counts[seq] = self._counts.get(seq, 0) + 1
        return self._whole() if count == self._total and seq == self._next else ()

    def _whole(self) -> list[Step]:
        whole = []
        while self._counts.get(self._next) == self._total:
            del self._counts[self._next]
            whole.append((self._next, self._pending.pop(self._next)))
            self._next += 1
        return whole

    def torn(self) -> list[Step]:
        """Steps begun and not whole, oldest first: what an aborted run left behind."""
        return sorted(self._pending.items())
