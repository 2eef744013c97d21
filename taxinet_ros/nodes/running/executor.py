"""Run nodes of this process on one executor in a private context."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor

from taxinet_ros.nodes.running.leave import leave_graph
from taxinet_ros.processes.interrupts import interrupts_delayed


class NodeExecutor:
    """Spins nodes on a ROS domain; a context manager at whose end they leave the graph."""

    def __init__(self, domain: int, executor: Callable[..., Any] = EventsExecutor) -> None:
        """Join a domain."""
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = executor(context=self.context)
        self.nodes: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        # Half closed, rclpy would release the rest in an order in which C++ aborts the process.
        with interrupts_delayed():
            try:
                while self.nodes:
                    node = self.nodes.pop()
                    if hasattr(node, 'close'):  # other nodes have nothing to finish
                        node.close()
                    self.executor.remove_node(node)
                    leave_graph(node)
                self.executor.shutdown()
            finally:
                rclpy.try_shutdown(context=self.context)

    def add(self, node: Any) -> None:
        """Add a node."""
        self.nodes.append(node)
        self.executor.add_node(node)
