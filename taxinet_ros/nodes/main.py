"""How a node runs as a process of its own: clean start, clean end, one line for a mistake."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.exceptions import ROSInterruptException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from taxinet_ros.core.errors import UsageError
from taxinet_ros.nodes.spinning import spin_until

_BAD_ARGUMENTS = (
    rclpy_implementation.RCLInvalidROSArgsError,
    rclpy_implementation.RCLError,
)
_INTERRUPTS = (KeyboardInterrupt, ExternalShutdownException, ROSInterruptException)


def run_node(
    build: Callable[[], Any], work: Callable[[Any, Any], int] | None = None
) -> None:
    """Run one node until Ctrl-C, SIGTERM or the end of its work, then exit.

    Args:
        build: makes the node; may raise :class:`UsageError`, which exits 2 with one line.
        work: given the node and its executor, spins until the work is done and returns the exit
            code, after an interrupt too, which is its own to handle; where None the node spins
            until it is stopped, or until its future ``ended`` is done, if it has one.
    """
    handlers, stopped = (
        (SignalHandlerOptions.ALL, 0) if work is None else (SignalHandlerOptions.NO, 130)
    )
    code = 0
    try:
        rclpy.init(signal_handler_options=handlers)
        node = build()
        executor = EventsExecutor()
        executor.add_node(node)
        try:
            if work is None:
                spin_until(executor, getattr(node, 'ended', Future()))
            else:
                code = work(node, executor)
        except RuntimeError:
            if rclpy.ok():
                raise
            # rclpy's way to end where a message comes in while it shuts down.
            code = stopped
        finally:
            node.close()
    except _INTERRUPTS:
        code = stopped
    except UsageError as error:
        code = complain(str(error), 2)
    except rclpy.exceptions.InvalidHandle as error:
        code = complain(str(error), 4)
    except _BAD_ARGUMENTS as error:
        # What follows is where in the C code it was noticed.
        code = complain(' '.join(str(error).split(', at /')[0].split()), 2)
    finally:
        rclpy.try_shutdown()
    sys.exit(code)


def complain(line: str, code: int) -> int:
    """Print one line on what is wrong; the exit code that goes with it."""
    print(f'error: {line}', file=sys.stderr)
    return code
