"""How a node runs as a process of its own: clean start, clean end, one line for a mistake."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException, ROSInterruptException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from taxinet_ros.campaign.interrupts import INTERRUPTED, told_apart
from taxinet_ros.core.errors import InfraError, UsageError
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
        build: makes the node; may raise :class:`UsageError`, which exits 2 with one line, or
            :class:`InfraError`, which exits 4.
        work: given the node and its executor, spins until the work is done and returns the exit
            code, after an interrupt too, which is its own to handle; where None the node spins
            until it is stopped, or until its future ``ended`` is done, if it has one.
    """
    handlers, stopped = (
        (SignalHandlerOptions.ALL, 0) if work is None else (SignalHandlerOptions.NO, INTERRUPTED)
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
            _leave(node, executor)
    except _INTERRUPTS:
        code = stopped
    except UsageError as error:
        code = complain(str(error), 2)
    except InfraError as error:
        code = complain(str(error), 4)
    except ParameterException as error:
        # Of a parameter that rclpy declares itself, as use_sim_time.
        code = complain(' '.join(str(error).split()), 2)
    except rclpy.exceptions.InvalidHandle as error:
        code = complain(str(error), 4)
    except _BAD_ARGUMENTS as error:
        # What follows is where in the C code it was noticed.
        code = complain(' '.join(str(error).split(', at /')[0].split()), 2)
    finally:
        rclpy.try_shutdown()
    sys.exit(told_apart(code))


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
