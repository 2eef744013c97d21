"""What the simulator says of a free run, and what its parameters ask for."""

from __future__ import annotations

from taxinet_msgs.msg import Timing as TimingMessage

from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.free_run import FreeRun, FreeRunAccount
from taxinet_ros.core.timing import Timing, free_timing
from taxinet_ros.nodes.convert import header

FREE_TICK_S = 0.001
"""How often it is looked whether the next frame is due [s]: a hundredth of a step in real time."""


def chosen_timing(timing: Timing, *, lockstep: bool, factor: float) -> Timing:
    """What the simulator's parameters ask for together.

    Args:
        timing: with the latency.
        lockstep: simulated time waits for every answer.
        factor: simulated seconds per second of the wall clock in a free run; 0: no limit.

    Raises:
        UsageError: one of them has no effect beside another.
    """
    if lockstep and factor != 1.0:
        raise UsageError('simulator: real_time_factor: no effect in lockstep; set lockstep false')
    if not lockstep and timing.laws:
        raise UsageError(
            f'simulator: latency {timing.latency}: has no effect in a free run, where answers are '
            'as late as they are'
        )
    return timing if lockstep else free_timing(f'{factor!r}')


def settled_message(free: FreeRun, run_id: str) -> TimingMessage:
    """What becomes known with a frame: which earlier ones get no answer any more."""
    unestimated, uncommanded = free.settle()
    return TimingMessage(
        header=header(free.seq * CONTROL_PERIOD_NS, ''), run_id=run_id, seq=free.seq,
        unestimated=unestimated, uncommanded=uncommanded,
    )


def account_message(free: FreeRun, run_id: str) -> TimingMessage:
    """How a free run went, at its end."""
    account = free.account
    seq = max(free.seq, 0)
    return TimingMessage(
        header=header(seq * CONTROL_PERIOD_NS, ''), run_id=run_id, seq=seq, ended=True,
        applied=account.applied, frame_time=account.frame_s, estimate_time=account.estimate_s,
        command_time=account.command_s, estimate_seq=account.estimate_seq,
        command_seq=account.command_seq, overruns=account.overruns, stale=account.stale,
    )


def account_of(message: TimingMessage) -> FreeRunAccount:
    """The inverse of :func:`account_message`."""
    return FreeRunAccount(
        applied=list(message.applied), frame_s=list(message.frame_time),
        estimate_s=list(message.estimate_time), command_s=list(message.command_time),
        estimate_seq=list(message.estimate_seq), command_seq=list(message.command_seq),
        overruns=message.overruns, stale=message.stale,
    )
