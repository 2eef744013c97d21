"""Remove a node from the graph, and end the process where Fast DDS hangs in it.

``rmw_fastrtps`` waits without a limit for discovery callbacks under way, which happen just when
other nodes leave too. In Fast DDS 2.14 that wait may never end (one of 360 nodes that left six at a
time), with Python's global lock held: nothing but the system can end such a process.
"""

from __future__ import annotations

import signal
from typing import Any

_LIMIT_S = 10.0
"""Time limit; destroying a node takes milliseconds."""


def leave_graph(node: Any) -> None:
    """Destroy a node; if this hangs, SIGALRM ends the process.

    Args:
        node: an instance of :class:`rclpy.node.Node`.
    """
    before = signal.setitimer(signal.ITIMER_REAL, _LIMIT_S)
    try:
        node.destroy_node()
    finally:
        signal.setitimer(signal.ITIMER_REAL, *before)
