"""The exit code of a command that was interrupted."""

from __future__ import annotations

import signal

import pytest

from taxinet_ros.errors import ExitCode
from taxinet_ros.processes import interrupts as module
from taxinet_ros.processes.interrupts import interrupted_exit_code, interrupts


@pytest.mark.parametrize(('number', 'code'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_given_an_interrupt_then_the_exit_code_is_that_of_its_signal(
    number: int, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, '_received', [])
    with interrupts(lambda: None):
        signal.raise_signal(number)
    assert interrupted_exit_code(ExitCode.INTERRUPTED) == code
    assert interrupted_exit_code(1) == 1
