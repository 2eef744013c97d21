"""Spinning until something is done."""

from __future__ import annotations

from typing import Any

from rclpy.task import Future

_SLICE_S = 1.0


def spin_until(executor: Any, done: Future) -> bool:
    """Spin until ``done`` is, or its context is shut down; then re-raise its exception, if any.

    Returns:
        Whether it is done.
    """
    while executor.context.ok() and not spin_for(executor, done, _SLICE_S):
        pass
    return bool(done.done())


def spin_for(executor: Any, done: Future, time_s: float) -> bool:
    """Spin until ``done`` is, or for a time [s]; then re-raise its exception, if any.

    Returns:
        Whether it is done.
    """
    # Without a timeout the events executor of rclpy 7.1 turns in circles and runs no callback.
    if not done.done():
        executor.spin_until_future_complete(done, timeout_sec=time_s)
    if done.done():
        done.result()
    return bool(done.done())
