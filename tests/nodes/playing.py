"""A player of bags, and somebody who listens, on a domain of their own."""

from __future__ import annotations

import contextlib
from pathlib import Path

import rclpy
from graph_runs import on_own_domain
from rclpy.context import Context
from rclpy.parameter import Parameter

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.bag_player import BagPlayer


class Listener(rclpy.node.Node):
    """Keeps what is said on some topics, serialised."""

    def __init__(self, names: dict[str, interface.Topic], **node) -> None:
        super().__init__('listener', **node)
        self.heard: dict[str, list[bytes]] = {name: [] for name in names}
        self.ears = [
            self.create_subscription(
                topic.type, name, self.heard[name].append, topic.qos, raw=True
            )
            for name, topic in names.items()
        ]


@contextlib.contextmanager
def listening(*topics: interface.Topic, **renamed: interface.Topic):
    """A listener, an executor that spins it, and its context on a domain of its own."""
    with on_own_domain() as spinning:
        names = {topic.name: topic for topic in topics} | renamed
        listener = Listener(names, context=spinning.context)
        spinning.add(listener)
        yield listener, spinning.executor, spinning.context


def make_player(context: Context, bag: Path | str, **parameters) -> BagPlayer:
    values = {'bag': str(bag), **parameters}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    return BagPlayer(context=context, parameter_overrides=overrides)


@contextlib.contextmanager
def playing(context: Context, executor, bag: Path, **parameters):
    player = make_player(context, bag, **parameters)
    executor.add_node(player)
    try:
        yield player
    finally:
        player.close()
        executor.remove_node(player)
        player.destroy_node()  # the listener stays
