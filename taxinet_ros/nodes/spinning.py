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
    # Without a timeout the events executor of rclpy 7.1 turns in circles and runs no callback.
    while not done.done() and executor.context.ok():
        executor.spin_until_future_complete(done, timeout_sec=_SLICE_S)
    if done.done():
        done.result()
    return bool(done.done())
