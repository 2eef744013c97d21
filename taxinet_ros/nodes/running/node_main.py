"""Run a node as a process: start, spin, report what it waits for, clean shutdown.

Signals are handled by Python, not rclpy, which would shut down the context before nodes could
exchange the end of the current run.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from threading import Event
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from taxinet_ros.errors import ExitCode, InfraError, RecordError, UsageError
from taxinet_ros.nodes.running.domain import domain_number, require_discovery
from taxinet_ros.nodes.running.leave import leave_graph
from taxinet_ros.nodes.running.parameters import Usage, read_arguments
from taxinet_ros.processes.interrupts import (
    exit_handler,
    handle_signals,
    interrupted_exit_code,
    interrupts,
    raise_interrupt,
)

_SLICE_S = 1.0


def spin_until(executor: Any, done: Future) -> bool:
    """Spin until ``done`` is done or the context is shut down; then re-raise its exception, if any.

    Returns:
        Whether it is done.
    """
    while executor.context.ok() and not spin_for(executor, done, _SLICE_S):
        pass
    return bool(done.done())


def spin_for(executor: Any, done: Future, time_s: float) -> bool:
    """Spin until ``done`` is done, or for a time [s]; then re-raise its exception, if any.

    Returns:
        Whether it is done.
    """
    # Without a timeout, the events executor of rclpy 7.1 busy-loops and runs no callback.
    if not done.done():
        executor.spin_until_future_complete(done, timeout_sec=time_s)
    if done.done():
        done.result()
    return bool(done.done())


_WAITING_LOOK_S = 0.5
_PATIENCE_S = 2.0
"""Shorter waits are normal at the start of a run."""


class Waiting:
    """Reports which nodes a node waits for: once it lasts, at each change, and at its end.

    The node's method ``waits_for``, if any, returns the names of these nodes.
    """

    def __init__(self, node: Any) -> None:
        """Start watching on the node's executor."""
        self._node = node
        self._since_s = 0.0
        self._told: tuple[str, ...] = ()
        self._timer = node.create_timer(
            _WAITING_LOOK_S, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def look(self) -> None:
        """Report changes."""
        names = tuple(sorted(getattr(self._node, 'waits_for', tuple)()))
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
        """Stop watching."""
        self._timer.cancel()

    def _say(self, line: str) -> None:
        self._node.get_logger().info(line)


_BAD_ARGUMENTS = (
    rclpy_implementation.RCLInvalidROSArgsError,
    rclpy_implementation.RCLError,
)
GRACE_S = 5.0
"""Maximum time [s] a node continues after a shutdown request until the current run ends.

Longer on a machine so busy that the node itself has to wait.
"""
_LOOK_S = 0.05


def run_node(
    build: Callable[[], Any], work: Callable[[Any, Any], int] | None = None, *, usage: Usage
) -> None:
    """Run one node until Ctrl-C, SIGTERM, a closed terminal or the end of its work, then exit.

    After the first signal, a node that serves a run continues until its method ``may_leave`` (if
    any, polled) returns True, at most for :data:`GRACE_S`. The second one ends it at once. Exit
    code: 0 after one signal, 130, 143 or 129 after two.

    Args:
        build: makes the node; may raise :class:`UsageError`, which exits 2 with one line, or
            :class:`InfraError`, which exits 4.
        work: called with the node and its executor; spins until the work is done and returns the
            exit code, handling interrupts itself. None: spin until stopped, or until the node's
            future ``ended`` is done, if any.
        usage: usage text of the executable; a command line with other than ROS arguments exits 2
            with one line.
    """
    stopped = ExitCode.INTERRUPTED if work else ExitCode.OK
    code: int = stopped
    handle_signals(exit_handler(stopped))  # Nothing has been started that needs shutdown.
    try:
        if read_arguments(usage, sys.argv):
            sys.exit(ExitCode.OK)
        # If it is too high, Fast DDS exits with 1; ROS converts -1 to 0.
        domain_number(os.environ.get('ROS_DOMAIN_ID') or '0', 'ROS_DOMAIN_ID')
        require_discovery()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = build()
        executor = EventsExecutor()
        executor.add_node(node)
        if work is None:  # otherwise it reports what it does
            node.get_logger().info(f'up on ROS domain {node.context.get_domain_id()}')
        waiting = Waiting(node)
        try:
            handle_signals(raise_interrupt)
            code = work(node, executor) if work else _serve(node, executor)
        finally:
            # Only the shutdown remains, which may be interrupted.
            handle_signals(exit_handler(code))
            waiting.end()
            _leave(node, executor)
    except KeyboardInterrupt:
        code = stopped
    except UsageError as error:
        code = complain(str(error), ExitCode.USAGE)
    except (InfraError, RecordError) as error:
        code = complain(str(error), ExitCode.INFRA)
    except ParameterException as error:
        # From a parameter declared by rclpy, such as use_sim_time.
        code = complain(' '.join(str(error).split()), ExitCode.USAGE)
    except rclpy.exceptions.InvalidHandle as error:
        code = complain(str(error), ExitCode.INFRA)
    except _BAD_ARGUMENTS as error:
        # The rest of the message is a location in C code.
        code = complain(' '.join(str(error).split(', at /')[0].split()), ExitCode.USAGE)
    handle_signals(exit_handler(code))
    rclpy.try_shutdown()
    sys.exit(interrupted_exit_code(code))


def _serve(node: Any, executor: Any) -> int:
    """Spin until the node has ended, or may leave after a shutdown request."""
    ended, asked = getattr(node, 'ended', Future()), Event()
    with interrupts(asked.set):
        while not (asked.is_set() or spin_for(executor, ended, _LOOK_S)):
            pass
        may_leave = getattr(node, 'may_leave', lambda: True)
        # Counts checks instead of seconds, so that a busy machine gets more time.
        for _ in range(round(GRACE_S / _LOOK_S)):
            if ended.done() or may_leave():
                break
            spin_for(executor, ended, _LOOK_S)
    return ExitCode.OK


def _leave(node: Any, executor: Any) -> None:
    """Remove a node from the graph in order, so that others notice.

    Interpreter shutdown would do it in arbitrary order, or not at all.
    """
    node.close()
    executor.remove_node(node)
    leave_graph(node)
    executor.shutdown()


def complain(line: str, code: int) -> int:
    """Print a one-line error message; return the exit code."""
    print(f'error: {line}', file=sys.stderr)
    return code
