"""Start the whole graph, every node a process, and run a campaign of one Scenic program.

``ros2 launch taxinet_ros taxinet.launch.py perception:=truth program:=s_falsif runs:=10``, and with
``sampler:=ce`` a search for failures; it ends when the last run has ended.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = 'taxinet_ros'
PERCEPTIONS = {'taxinet': 'taxinet_perception', 'truth': 'ground_truth_perception'}
"""Executable behind each word of ``perception:=``."""


def arguments() -> list[DeclareLaunchArgument]:
    """What may be set on the command line; a word that is not a choice is refused with the list."""
    config = Path(get_package_share_directory(PACKAGE)) / 'config' / 'nodes.yaml'
    described = {
        'weights': ('taxinet', 'the network: taxinet (shipped), or a .safetensors or .onnx file'),
        'program': ('s_falsif', 'Scenic program to draw scenarios from: a shipped name or a file'),
        'runs': ('10', 'number of runs'),
        'seed': ('0', 'seed of the draws'),
        'sampler': ('', 'ce, random, …: searches for failures; empty: what the program draws'),
        'until': ('', 'a search stops early: failures=K or half-width=W'),
        'budget': ('0.0', 'a search begins no run after so long [min]; 0: ever'),
        'resume': ('false', 'continues the search that was interrupted in out'),
        'out': (f'bags/launch-{datetime.now():%Y%m%d-%H%M%S}', 'new folder for table and bags'),
        'namespace': ('', 'prefix of every topic of the graph but /clock'),
        'params': (str(config), "file with the nodes' parameters"),
    }
    return [
        DeclareLaunchArgument(
            'perception', default_value='taxinet', choices=list(PERCEPTIONS), description='who sees'
        ),
        *(
            DeclareLaunchArgument(name, default_value=default, description=text)
            for name, (default, text) in described.items()
        ),
    ]


def value(name: str, kind: type = str) -> ParameterValue:
    """A node parameter that takes a launch argument's value; unquoted digits stay text."""
    return ParameterValue(LaunchConfiguration(name), value_type=kind)


def node(executable: str, name: str | None = None, **more: object) -> Node:
    """One node of this package with its parameters from the file, and these on top."""
    parameters = [LaunchConfiguration('params'), more.pop('parameters', {})]
    return Node(
        package=PACKAGE,
        executable=executable,
        name=name or executable,
        namespace=LaunchConfiguration('namespace'),
        parameters=parameters,
        output='screen',
        **more,
    )


def graph(context: LaunchContext) -> list[Node]:
    """The six nodes, with the perception that was asked for."""
    word = LaunchConfiguration('perception').perform(context)
    weights = {'weights': value('weights')} if word == 'taxinet' else {}
    campaign = {
        'program': value('program'),
        'runs': value('runs', int),
        'seed': value('seed', int),
        'sampler': value('sampler'),
        'until': value('until'),
        'budget': value('budget', float),
        'resume': value('resume', bool),
        'out': value('out'),
    }
    return [
        node('simulator'),
        node(PERCEPTIONS[word], 'perception', parameters=weights),
        node('steering_controller'),
        node('mtl_monitor'),
        node('recorder', parameters={'out': value('out')}),
        node('scenario_sampler', parameters=campaign, on_exit=Shutdown()),
    ]


def generate_launch_description() -> LaunchDescription:
    """What ``ros2 launch`` starts."""
    return LaunchDescription([*arguments(), OpaqueFunction(function=graph)])
