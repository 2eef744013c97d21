"""``taxinet up``: keep a graph of supervised node processes up."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from taxinet_ros.cli.completion import complete_gain
from taxinet_ros.cli.options import (
    ControllerOption,
    FactorOption,
    FallbackOption,
    FreeOption,
    ImagesOption,
    LatencyOption,
    MonitorOption,
    PerceptionOption,
    WorldCameraOption,
    WorldOption,
    controller_of,
    refuse_given,
)
from taxinet_ros.errors import ExitCode, UsageError


def up(
    context: typer.Context,
    perception: PerceptionOption = 'taxinet',
    controller: ControllerOption = 'steering',
    monitor: MonitorOption = None,
    fallback: FallbackOption = None,
    world: WorldOption = 'kmwh',
    camera: WorldCameraOption = None,
    out: Annotated[Path | None, typer.Option(help='folder for bags and logs; must be new')] = None,
    record: Annotated[
        bool, typer.Option('--record/--no-record', help='a bag for every run, or no recorder')
    ] = True,
    images: ImagesOption = 'all',
    latency: LatencyOption = None,
    free: FreeOption = False,
    real_time_factor: FactorOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set', metavar='KEY=VALUE',
            help='a controller gain (steering.heading_gain=1.2); repeatable',
            autocompletion=complete_gain,
        ),
    ] = None,
    restart: Annotated[
        str,
        typer.Option(
            metavar='RULE',
            help='when a node dies: on-failure restarts it, at most 3 times in 60 s, and also one '
            'whose silence ended a run; never ends the graph',
        ),
    ] = 'on-failure',
    domain: Annotated[
        int | None,
        typer.Option(
            min=0, max=232,
            help='ROS domain (default: ROS_DOMAIN_ID, else one not used by another taxinet graph)',
        ),
    ] = None,
    namespace: Annotated[
        str,
        typer.Option(
            metavar='NAME',
            help='prefix of every name in the graph, /clock included, so that several graphs can '
            'share a domain',
        ),
    ] = '',
) -> int:
    """Start every node except the sampler in its own process and keep them running.

    To run scenes, use `ros2 run taxinet_ros scenario_sampler` in another terminal, in the ROS
    domain printed. Ctrl-C ends the current run and the graph in order; a second one kills it. Exit
    code 130 after Ctrl-C, 143 after SIGTERM, 4 if a node could not be kept up.
    """
    from taxinet_ros.cli.run.up_view import UpView
    from taxinet_ros.core.assurance.switch import check_controller
    from taxinet_ros.core.perception.perception import check_perception
    from taxinet_ros.core.world import find_world, world_word
    from taxinet_ros.nodes.graph.launch_plan import absolute_namespace
    from taxinet_ros.nodes.graph.runner import GraphOptions
    from taxinet_ros.nodes.graph.standing import run_standing_graph
    from taxinet_ros.nodes.graph.supervisor import GraphLostError, Restart
    from taxinet_ros.nodes.running.domain import BY_HAND, domain_number
    from taxinet_ros.processes.interrupts import interrupts
    from taxinet_ros.trials.options import (
        DEFAULT_ROOT,
        IMAGES,
        check_new,
        check_not_free,
        check_timing,
        new_folder,
        recorded_images,
        split_settings,
    )

    if not record:
        refuse_given(context, ('images',), 'has no effect with --no-record; leave one out')
    steers = controller_of(context)
    check_perception(perception, graph=True)
    for option, word, known in (('images', images, IMAGES), ('restart', restart, list(Restart))):
        if word not in known:
            raise UsageError(f'--{option} {word}: unknown; known: {", ".join(known)}')
    overrides, gains = split_settings(settings or ())
    if overrides:
        raise UsageError(
            f'--set {next(iter(overrides))}: scenario values are set by the sampler; use '
            'steering.<gain>=value'
        )
    check_controller(steers, gains, graph=True)
    timing = check_timing(latency or (), free=free, factor=real_time_factor)
    check_not_free(timing, steers)
    chosen = find_world(world_word(world, camera))
    if domain is None and not os.environ.get(BY_HAND) and os.environ.get('ROS_DOMAIN_ID'):
        domain = domain_number(os.environ['ROS_DOMAIN_ID'], 'ROS_DOMAIN_ID')
    out = out or new_folder(DEFAULT_ROOT / 'up')
    check_new(out)
    graph = GraphOptions(
        perception=perception, out=out, images=recorded_images(chosen, images), gains=gains,
        controller=steers, timing=timing, world=chosen.name,
    )
    name = absolute_namespace(namespace, '--namespace ')
    view = UpView(Console(emoji=False, highlight=False), graph, record=record, namespace=name)
    with interrupts(view.stop):
        try:
            run_standing_graph(
                graph, view.say, view.watching, record=record, domain_id=domain, namespace=name,
                restart=Restart(restart),
            )
            view.say('ended')
        except KeyboardInterrupt:
            view.say('killed')
        except GraphLostError as error:
            print(f'taxinet: error: {error}', file=sys.stderr)
            return ExitCode.INFRA
    return ExitCode.INTERRUPTED
