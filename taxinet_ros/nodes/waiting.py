"""A node's word on whom it waits for, for whoever reads its log."""

from __future__ import annotations

import time
from typing import Any

from rclpy.clock import Clock, ClockType

_LOOK_S = 0.5
_PATIENCE_S = 2.0
"""What is over sooner is how a run begins."""


class Waiting:
    """Looks whom a node waits for, and says so once it has lasted, at each change, and at its end.

    A node tells by its method ``waits_for``, if it has one: names of other nodes, or none.
    """

    def __init__(self, node: Any) -> None:
        """Look from now on, on the executor of the node."""
        self._node = node
        self._since_s = 0.0
        self._told: tuple[str, ...] = ()
        self._timer = node.create_timer(
            _LOOK_S, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME)
        ) if hasattr(node, 'waits_for') else None

    def look(self) -> None:
        """Say what has changed."""
        names = tuple(sorted(self._node.waits_for()))
        now_s = time.monotonic()
        if not names:
            if self._told:
                self._say(f'no longer waiting for: {", ".join(self._told)}')
            self._since_s, self._told = 0.0, ()
            return
        self._since_s = self._since_s or now_s
        if names != self._told and now_s - self._since_s >= _PATIENCE_S:
            self._say(f'waiting for: {", ".join(names)}')
            self._told = names

    def end(self) -> None:
        """Look no more."""
        if self._timer is not None:
            self._timer.cancel()

    def _say(self, line: str) -> None:
        self._node.get_logger().info(line)
