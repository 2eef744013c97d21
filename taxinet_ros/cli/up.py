"""``taxinet up``: a standing graph, each node a process that is looked after."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from rich.console import Console

from taxinet_ros.campaign.interrupts import INTERRUPTED, interrupts
from taxinet_ros.campaign.options import (
    DEFAULT_ROOT,
    IMAGES,
    check_new,
    check_timing,
    new_folder,
    split_settings,
)
from taxinet_ros.cli.up_view import UpView
from taxinet_ros.core.controller import check_controller
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.perception import check_perception
from taxinet_ros.nodes.domain import BY_HAND, domain_number
from taxinet_ros.nodes.graph import GraphOptions
from taxinet_ros.nodes.supervisor import Care, GraphLostError, Restart
from taxinet_ros.nodes.up import UpOptions, stand

_INFRA = 4
_GONE_S = 3.0
"""How long the graph may take to be gone after a second interrupt."""


def make_up_options(
    *, perception: str, controller: str, out: Path | None, record: bool, images: str,
    settings: Iterable[str], restart: str, domain: int | None, silent_s: float,
    latency: Iterable[str] = (), free: bool = False, real_time_factor: str | None = None,
) -> UpOptions:
    """Check what a person typed.

    Args:
        perception: as of :class:`.graph.GraphOptions`.
        controller: likewise.
        out: folder of bags and logs, which must be new; where None, a new one below ``bags/``.
        record: whether there is a recorder.
        images: runs whose camera frames go into the bags.
        settings: ``steering.<gain>=value``.
        restart: a word of :class:`Restart`.
        domain: ROS domain; where None, that of the environment, else one of its own.
        silent_s: silence after which a node is named [s].
        latency: ``NAME=LATENCY`` of perception or controller.
        free: simulated time goes by the wall clock.
        real_time_factor: simulated seconds per second then, or ``max``.

    Raises:
        UsageError: one line on the first that is wrong.
    """
    check_perception(perception, graph=True)
    if images not in IMAGES:
        raise UsageError(f'--images {images}: unknown; known: {", ".join(IMAGES)}')
    if restart not in list(Restart):
        raise UsageError(f'--restart {restart}: unknown; known: {", ".join(Restart)}')
    overrides, gains = split_settings(settings)
    if overrides:
        raise UsageError(
            f"--set {next(iter(overrides))}: a scenario value is the sampler's to set; here: "
            'steering.<gain>=value'
        )
    check_controller(controller, gains, graph=True)
    if domain is None and not os.environ.get(BY_HAND) and os.environ.get('ROS_DOMAIN_ID'):
        domain = domain_number(os.environ['ROS_DOMAIN_ID'], 'ROS_DOMAIN_ID')
    out = out or new_folder(DEFAULT_ROOT / 'up')
    check_new(out)
    return UpOptions(
        graph=GraphOptions(
            perception=perception, out=out, images=images, gains=gains, controller=controller,
            alone=False,
            timing=check_timing(latency, free=free, factor=real_time_factor),
        ),
        record=record, domain=domain, care=Care(restart=Restart(restart), silent_s=silent_s),
    )


def run_up(options: UpOptions) -> int:
    """Keep the graph up until somebody stops it.

    Returns:
        Exit code: that of an interrupt once it was stopped; 4 if it could not be kept up.
    """
    view = UpView(Console(highlight=False), options)
    stops: list[Callable[[], None]] = []

    def stop() -> None:
        if not stops:
            raise KeyboardInterrupt
        stops[-1]()

    # Every node dies with this process, so nothing is lost if the ways out of DDS take long.
    with interrupts(stop, gone_s=_GONE_S):
        try:
            stand(options, view, stops.append)
            view.say('ended')
        except KeyboardInterrupt:
            view.say('killed')
        except GraphLostError as error:
            print(f'taxinet: error: {error}', file=sys.stderr)
            return _INFRA
    return INTERRUPTED
