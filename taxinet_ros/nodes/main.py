"""How a node runs as a process of its own: clean start, clean end, one line for a mistake.

Signals are Python's here, not rclpy's: that would shut down the context of every node of a graph
before any of them could say or hear how the run at hand ends.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from threading import Event, Timer
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from taxinet_ros.campaign.interrupts import (
    INTERRUPTED,
    handle_from_now_on,
    interrupts,
    leave_with,
    told_apart,
)
from taxinet_ros.core.errors import InfraError, RecordError, UsageError
from taxinet_ros.core.process_end import end_now, leave
from taxinet_ros.nodes.spinning import spin_for
from taxinet_ros.nodes.usage import Usage, read_arguments
from taxinet_ros.nodes.waiting import Waiting

_BAD_ARGUMENTS = (
    rclpy_implementation.RCLInvalidROSArgsError,
    rclpy_implementation.RCLError,
)

GRACE_S = 5.0
"""Longest time [s] that a node which was asked to end goes on, for the run at hand to end."""

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
    code = stopped = INTERRUPTED if work else 0
    handle_from_now_on(leave_with(stopped))  # Nothing is begun that would have to be ended.
    try:
        if read_arguments(usage, sys.argv):
            sys.exit(0)
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = build()
        executor = EventsExecutor()
        executor.add_node(node)
        if work is None:  # else it says what it does
            node.get_logger().info(f'up on ROS domain {node.context.get_domain_id()}')
        waiting = Waiting(node)
        try:
            handle_from_now_on(end_now)
            code = work(node, executor) if work else _serve(node, executor)
        finally:
            # All is done but leaving, which may be torn.
            handle_from_now_on(leave_with(code))
            waiting.end()
            _leave(node, executor)
    except KeyboardInterrupt:
        code = stopped
    except UsageError as error:
        code = complain(str(error), 2)
    except (InfraError, RecordError) as error:
        code = complain(str(error), 4)
    except ParameterException as error:
        # Of a parameter that rclpy declares itself, as use_sim_time.
        code = complain(' '.join(str(error).split()), 2)
    except rclpy.exceptions.InvalidHandle as error:
        code = complain(str(error), 4)
    except _BAD_ARGUMENTS as error:
        # What follows is where in the C code it was noticed.
        code = complain(' '.join(str(error).split(', at /')[0].split()), 2)
    handle_from_now_on(leave_with(code))
    rclpy.try_shutdown()
    sys.exit(told_apart(code))


def _serve(node: Any, executor: Any) -> int:
    """Spin until the node has ended, or was asked to and may leave."""
    ended, asked, asked_again = getattr(node, 'ended', Future()), Event(), Event()

    def at_once() -> bool:
        asked_again.set()
        hung = Timer(AT_ONCE_S, lambda: leave(told_apart(INTERRUPTED)))
        hung.daemon = True
        hung.start()
        return True

    with interrupts(asked.set, at_once):
        while not (asked.is_set() or spin_for(executor, ended, _LOOK_S)):
            pass
        may_leave = getattr(node, 'may_leave', lambda: True)
        deadline_s = time.monotonic() + GRACE_S
        while not (ended.done() or asked_again.is_set() or may_leave()):
            spin_for(executor, ended, _LOOK_S)
            if time.monotonic() > deadline_s:
                break
    return INTERRUPTED if asked_again.is_set() else 0


def _leave(node: Any, executor: Any) -> None:
    """Take a node out of the graph in order, so that nobody takes it for one that is still there.

    The interpreter's end would do it in any order, or not at all.
    """
    node.close()
    executor.remove_node(node)
    node.destroy_node()
    executor.shutdown()


def complain(line: str, code: int) -> int:
    """Print one line on what is wrong; the exit code that goes with it."""
    print(f'error: {line}', file=sys.stderr)
    return code
