"""How a node runs as a process: start, spinning, a line on whom it waits for, clean end.

Signals are Python's here, not rclpy's: that would shut down the context of every node of a
graph before any of them could say or hear how the run at hand ends.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from threading import Event, Timer
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from taxinet_ros.errors import ExitCode, InfraError, RecordError, UsageError
from taxinet_ros.nodes.running.parameters import Usage, read_arguments
from taxinet_ros.nodes.running.remaps import cut_off
from taxinet_ros.processes.interrupts import (
    exit_handler,
    exit_now,
    handle_signals,
    interrupted_exit_code,
    interrupts,
    raise_interrupt,
)

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


_WAITING_LOOK_S = 0.5
_PATIENCE_S = 2.0
"""What is over sooner is how a run begins."""


class Waiting:
    """Looks whom a node waits for, and says so once it has lasted, at each change, and at its end.

    A node tells by its method ``waits_for``, if it has one: names of other nodes, or none. It warns
    of remaps that have parted the node from those whom it is to meet.
    """

    def __init__(self, node: Any) -> None:
        """Look from now on, on the executor of the node."""
        self._node = node
        self._since_s = 0.0
        self._told: tuple[str, ...] = ()
        self._parted: list[str] = []
        self._timer = node.create_timer(
            _WAITING_LOOK_S, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def look(self) -> None:
        """Say what has changed."""
        self._look_for_remaps()
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
        """Look no more."""
        self._timer.cancel()

    def _look_for_remaps(self) -> None:
        before, self._parted = self._parted, cut_off(self._node)
        for line in self._parted:
            if line not in before:
                self._node.get_logger().warning(line)

    def _say(self, line: str) -> None:
        self._node.get_logger().info(line)


_BAD_ARGUMENTS = (
    rclpy_implementation.RCLInvalidROSArgsError,
    rclpy_implementation.RCLError,
)
GRACE_S = 5.0
"""Longest time [s] that a node which was asked to end goes on, for the run at hand to end.

Where the machine is so busy that the node itself has to wait, it is longer.
"""
AT_ONCE_S = 1.0
"""Longest time [s] that it then takes to leave the graph after a second signal."""
_LOOK_S = 0.05


def run_node(
    build: Callable[[], Any], work: Callable[[Any, Any], int] | None = None, *, usage: Usage
) -> None:
    """Run one node until Ctrl-C, SIGTERM, a closed terminal or the end of its work, then exit.

    The first signal has a node that serves a run go on until it may leave (its method
    ``may_leave``, if it has one, is asked again and again), but for :data:`GRACE_S` at most.
    After the second one it waits for nothing, but says goodbye, so that all others know that it
    is gone. Exit code: 0 after one signal, 130, 143 or 129 after two.

    Args:
        build: makes the node; may raise :class:`UsageError`, which exits 2 with one line, or
            :class:`InfraError`, which exits 4.
        work: given the node and its executor, spins until the work is done and returns the exit
            code, after an interrupt too, which is its own to handle; where None the node spins
            until it is stopped, or until its future ``ended`` is done, if it has one.
        usage: what the executable says of itself; a command line that holds more than arguments of
            ROS exits 2 with one line.
    """
    stopped = ExitCode.INTERRUPTED if work else ExitCode.OK
    code: int = stopped
    handle_signals(exit_handler(stopped))  # Nothing is begun that would have to be ended.
    try:
        if read_arguments(usage, sys.argv):
            sys.exit(ExitCode.OK)
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = build()
        executor = EventsExecutor()
        executor.add_node(node)
        if work is None:  # else it says what it does
            node.get_logger().info(f'up on ROS domain {node.context.get_domain_id()}')
        waiting = Waiting(node)
        try:
            handle_signals(raise_interrupt)
            code = work(node, executor) if work else _serve(node, executor)
        finally:
            # All is done but leaving, which may be torn.
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
        # Of a parameter that rclpy declares itself, as use_sim_time.
        code = complain(' '.join(str(error).split()), ExitCode.USAGE)
    except rclpy.exceptions.InvalidHandle as error:
        code = complain(str(error), ExitCode.INFRA)
    except _BAD_ARGUMENTS as error:
        # What follows is where in the C code it was noticed.
        code = complain(' '.join(str(error).split(', at /')[0].split()), ExitCode.USAGE)
    handle_signals(exit_handler(code))
    rclpy.try_shutdown()
    sys.exit(interrupted_exit_code(code))


def _serve(node: Any, executor: Any) -> int:
    """Spin until the node has ended, or was asked to and may leave."""
    ended, asked, asked_again = getattr(node, 'ended', Future()), Event(), Event()

    def at_once() -> bool:
        asked_again.set()
        hung = Timer(AT_ONCE_S, lambda: exit_now(interrupted_exit_code(ExitCode.INTERRUPTED)))
        hung.daemon = True
        hung.start()
        return True

    with interrupts(asked.set, at_once):
        while not (asked.is_set() or spin_for(executor, ended, _LOOK_S)):
            pass
        may_leave = getattr(node, 'may_leave', lambda: True)
        # Looks are counted and no seconds, which a busy machine would take away.
        for _ in range(round(GRACE_S / _LOOK_S)):
            if ended.done() or asked_again.is_set() or may_leave():
                break
            spin_for(executor, ended, _LOOK_S)
    return ExitCode.INTERRUPTED if asked_again.is_set() else ExitCode.OK


def _leave(node: Any, executor: Any) -> None:
    """Take a node out of the graph in order, so that nobody takes it for one that is still there.

    The interpreter's end would do it in any order, or not at all.
    """
    node.close()
    executor.remove_node(node)
    node.destroy_node()
    executor.shutdown()


def complain(line: str, code: int) -> int:
    """Print a one-line error message; return the exit code."""
    print(f'error: {line}', file=sys.stderr)
    return code
