"""``taxinet live-monitor``."""

from __future__ import annotations

import sys

import typer

from taxinet_ros.errors import ExitCode


def live_monitor(context: typer.Context) -> None:
    """Evaluate formulas on topics of any robot as messages arrive.

    Starts the node, as `ros2 run taxinet_ros live_monitor` does. Arguments are passed to it
    (--ros-args …).
    """
    from taxinet_ros.extras.live_monitor.node import main

    sys.argv = ['live_monitor', *context.args]
    try:
        main()
    except SystemExit as end:  # as every node ends
        raise typer.Exit(end.code if isinstance(end.code, int) else ExitCode.INFRA) from None
