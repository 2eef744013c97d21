"""Interrupts that come while an earlier one is handled, as two presses of Ctrl-C do."""

from __future__ import annotations

import signal

import pytest

from taxinet_ros.processes import interrupts as module
from taxinet_ros.processes.interrupts import interrupts


class Doubled(list[int]):
    """The signals received; while the first is noted, the second comes."""

    def append(self, number: int) -> None:
        super().append(number)
        if len(self) == 1:
            signal.raise_signal(signal.SIGINT)


def test_r4_given_an_interrupt_within_the_handling_of_another_then_each_has_its_turn_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, 'RECEIVED_STOPS', received := Doubled())
    done: list[str] = []

    def give_up() -> bool:
        done.append('second')
        return True

    with interrupts(lambda: done.append('first'), give_up):
        signal.raise_signal(signal.SIGINT)
    assert sorted(done) == ['first', 'second']
    assert received == [signal.SIGINT] * 2


def test_r4_given_a_third_interrupt_then_it_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, 'RECEIVED_STOPS', received := [])
    with interrupts(lambda: None, lambda: True):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert len(received) == 3
