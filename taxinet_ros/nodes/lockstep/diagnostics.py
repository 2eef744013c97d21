"""Health of each node of a graph, published on ``/diagnostics``.

The form is that of diagnostic_updater (REP-107): names are ``NODE: WHAT``, levels OK, WARN and
ERROR, figures are pairs of texts. They depend on the wall clock, so they are not recorded. Without
subscribers nothing is published, so a campaign pays only for one check per second.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.running.parameters import Parameter, declare

PARAMETER = Parameter(
    name='diagnostics', default=1.0, limits=(0.0, 3600.0),
    description='wall-clock period of reports on /diagnostics [s]; 0: off',
)
PATIENCE_S = 2.0
"""Waiting time [s] after which a node reports a warning."""


@dataclass(frozen=True, kw_only=True)
class Health:
    """Health of a node.

    Attributes:
        level: OK, WARN or ERROR of :class:`diagnostic_msgs.msg.DiagnosticStatus`.
        message: one line of text.
        values: figures by name, the unit in the name.
    """

    level: bytes = DiagnosticStatus.OK
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


class Diagnostics:
    """Polls a node's health and publishes it while there are subscribers.

    Attributes:
        watched: whether there are subscribers, so that measuring pays off.
    """

    def __init__(self, node: Node, health: Callable[[], Health]) -> None:
        """Declare the parameter and start; ``health`` is called once a period."""
        period_s = declare(node, PARAMETER)
        self._node, self._health = node, health
        self.watched = False
        if period_s:
            topic = interface.DIAGNOSTICS
            self._publisher = node.create_publisher(topic.type, topic.name, topic.qos)
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            node.create_timer(period_s, self._tell, clock=steady)

    def _tell(self) -> None:
        before, self.watched = self.watched, self._publisher.get_subscription_count() > 0
        if not self.watched:
            return
        try:
            health = self._health()
        except Exception as error:  # A reporting error must not end the node.
            line = f'{type(error).__name__}: {error}'.splitlines()[0]
            health = Health(level=DiagnosticStatus.ERROR, message=line)
        if not before:
            return  # The figures cover a time without subscribers.
        name = self._node.get_fully_qualified_name().lstrip('/')
        status = DiagnosticStatus(
            level=health.level, name=f'{name}: run', message=health.message, hardware_id='',
            values=[KeyValue(key=key, value=_words(of)) for key, of in health.values.items()],
        )
        report = DiagnosticArray(status=[status])
        report.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(report)


class Pace:
    """Rate and durations of an operation since the last look."""

    def __init__(self) -> None:
        """Start measuring."""
        self._count, self._total_s, self._most_s = 0, 0.0, 0.0
        self._since_s = time.monotonic()

    def took(self, seconds: float) -> None:
        """Record one operation of this duration [s]."""
        self._count += 1
        self._total_s += seconds
        self._most_s = max(self._most_s, seconds)

    def look(self, what: str) -> tuple[float, dict[str, object]]:
        """Return rate [1/s] and figures of ``what`` since the last look, and reset."""
        elapsed_s = max(time.monotonic() - self._since_s, 1e-9)
        mean_ms = 1e3 * self._total_s / self._count if self._count else 0.0
        figures: dict[str, object] = {
            f'{what}s': self._count,
            f'{what} time, mean [ms]': mean_ms, f'{what} time, max [ms]': 1e3 * self._most_s,
        }
        rate = self._count / elapsed_s
        self._count, self._total_s, self._most_s = 0, 0.0, 0.0
        self._since_s = time.monotonic()
        return rate, figures


def too_long(waited_s: float) -> bool:
    """Whether a wait [s] deserves a warning."""
    return waited_s > PATIENCE_S


def _words(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)
