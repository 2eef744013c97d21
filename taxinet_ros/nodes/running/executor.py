"""Nodes of this process on one executor, in a context of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor


class NodeExecutor:
    """Spins nodes on a ROS domain; a context manager that takes them out of the graph at its end.

    Attributes:
        context: what the nodes are made with.
        executor: what spins them.
        nodes: those that are spun.
    """

    def __init__(self, domain: int, executor: Callable[..., Any] = EventsExecutor) -> None:
        """Join a domain.

        Args:
            domain: its id.
            executor: makes the executor, from the keyword ``context``.
        """
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = executor(context=self.context)
        self.nodes: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        try:
            while self.nodes:
                node = self.nodes.pop()
                if hasattr(node, 'close'):  # one of ours; others have nothing to finish
                    node.close()
                self.executor.remove_node(node)
                node.destroy_node()
            self.executor.shutdown()
        finally:
            rclpy.try_shutdown(context=self.context)

    def add(self, node: Any) -> None:
        """Spin a node too."""
        self.nodes.append(node)
        self.executor.add_node(node)
