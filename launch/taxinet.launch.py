"""Start the whole graph, every node a process, and run a campaign of one Scenic program.

``ros2 launch taxinet_ros taxinet.launch.py perception:=truth scenario:=s_falsif runs:=10``, and
with ``sampler:=ce`` a search for failures; it ends when the last run has ended, with the exit code
of ``taxinet run``. ``--show-args`` lists the arguments.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit, OnProcessStart
from launch.events import Shutdown
from launch.events.process import ProcessExited, ProcessStarted
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.utilities import prefix_namespace

from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.nodes.graph.launch_plan import (
    ARGUMENTS,
    CLOCK_REMAP,
    Ending,
    NodePlan,
    check_names,
    environment,
    namespace,
    parameter_file,
    plan,
)

PACKAGE = 'taxinet_ros'


def process(node: NodePlan, params: str, within: str, more: dict[str, str]) -> ExecuteProcess:
    """What starts one node."""
    if node.command:
        from taxinet_ros.nodes.graph.command_wrapper import (
            wrapped_command,  # which takes a library more
        )

        # A keeper ends with its command all that this has started; it hears SIGTERM only.
        words = wrapped_command([*node.command], os.getpid())
        return ExecuteProcess(
            cmd=words, name=node.name, additional_env=more, output='screen', sigterm_timeout='0.1'
        )
    return Node(
        package=PACKAGE, executable=node.executable, name=node.name, namespace=within,
        parameters=[params, dict(node.parameters)], remappings=[CLOCK_REMAP], additional_env=more,
        output='screen',
    )


def until_the_end(
    ending: Ending, processes: dict[ExecuteProcess, str]
) -> list[RegisterEventHandler]:
    """End everything with the campaign, or with a node that does not take what it was given."""

    def over(event: ProcessExited, context: LaunchContext) -> list[LogInfo | EmitEvent]:
        ends = ending.over(event.pid, processes.get(event.action, ''), event.returncode)
        if ending.exit_code is not None:
            # Launch itself knows 0 and 1 only. Nothing is left that it would have to end.
            raise SystemExit(ending.exit_code)
        if not ends:
            return []
        return [LogInfo(msg=ending.why), EmitEvent(event=Shutdown(reason=ending.why))]

    def begun(event: ProcessStarted, context: LaunchContext) -> None:
        ending.begun(event.pid)

    return [
        RegisterEventHandler(OnProcessStart(on_start=begun)),
        RegisterEventHandler(OnProcessExit(on_exit=over)),
    ]


def graph(context: LaunchContext) -> list[ExecuteProcess | RegisterEventHandler]:
    """Every node of the graph, as the arguments say."""
    try:
        # Where another launch file includes this one, what was typed is for that one.
        if Path(__file__).name in (Path(word).name for word in sys.argv):
            check_names(context.argv)
        words = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
        outer = context.launch_configurations.get('ros_namespace')
        words['namespace'] = namespace({'namespace': prefix_namespace(outer, words['namespace'])})
        params = parameter_file(words, Path(get_package_share_directory(PACKAGE)))
        more, nodes = environment(words), plan(words)
    except UsageError as error:
        print(f'error: {error}', file=sys.stderr)
        raise SystemExit(ExitCode.USAGE) from None
    processes = {process(node, params, words['namespace'], more): node.name for node in nodes}
    return [*until_the_end(Ending(nodes), processes), *processes]


def generate_launch_description() -> LaunchDescription:
    """What ``ros2 launch`` starts."""
    declared = (
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    )
    return LaunchDescription([*declared, OpaqueFunction(function=graph)])
