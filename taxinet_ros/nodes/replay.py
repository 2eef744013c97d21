"""One node alone, fed with a recorded run: what would it have answered?"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter

from taxinet_ros.bag.definitions import type_hash
from taxinet_ros.bag.frames import frame_messages
from taxinet_ros.bag.reader import read_info, stored_messages
from taxinet_ros.bag.recorded_run import RecordedRun
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.controller import STEERING
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.perception import make_perception
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.convert import scenario_message
from taxinet_ros.nodes.domain import own_domain
from taxinet_ros.nodes.graph import GraphOptions
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.player import Player, Step
from taxinet_ros.nodes.recorder import bag_name
from taxinet_ros.nodes.spinning import spin_until

_ANSWERS = {
    interface.PERCEPTION: interface.ESTIMATE,
    interface.STEERING_CONTROLLER: interface.COMMAND,
    interface.MTL_MONITOR: interface.ROBUSTNESS,
}
TARGETS = tuple(_ANSWERS)
"""Nodes that a run can be replayed into."""

Columns = dict[str, NDArray[np.float64]]


def replay(
    bag: Path, run: RecordedRun, *, target: str, perception: str, controller: str = STEERING
) -> Columns:
    """Feed a recorded run to one node over its topics.

    Camera frames that the bag lacks are rendered.

    Args:
        bag: a run folder or an ``.mcap`` file.
        run: what it holds.
        target: one of :data:`TARGETS`.
        perception: word or file of the perception, where that is the target.
        controller: word of the controller, likewise.

    Returns:
        What the node answered, by the names of :func:`taxinet_ros.bag.trace.read_trace`: ``seq``
        and the columns of the target.

    Raises:
        UsageError: unknown target, or the bag's messages are of another version.
        InfraError: the node broke or fell silent.
        BagError: the bag cannot be read, or its frames cannot be had.
    """
    if target not in _ANSWERS:
        raise UsageError(f'--into {target}: cannot be replayed into; known: {", ".join(TARGETS)}')
    inputs = _inputs(target, perception)
    answer = _ANSWERS[target]
    _check_types(bag, inputs)
    request = dataclasses.replace(run.request, participants=(target,))
    options = GraphOptions(
        perception=perception, out=Path(), controller=controller,
        gains=run.gains if controller == STEERING else {},
    )
    kind, parameters = options.nodes()[target]
    per_step = len(request.specs) if answer.recorded == interface.PER_SPEC else 1
    with _spinning() as (executor, context, add):
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        add(kind(context=context, parameter_overrides=overrides))
        player = Player(
            scenario_message(request), _steps(bag, inputs), target=target, speaks=inputs,
            answer=answer, per_step=per_step, executor=executor, context=context,
        )
        add(player)
        spin_until(executor, player.finished)
        return _columns(answer, player.answers)


def _inputs(target: str, perception: str) -> tuple[Topic, ...]:
    """The topics that steer a node from step to step."""
    looks = target != interface.PERCEPTION or make_perception(perception).needs_image
    unused = interface.TRUTH if looks else interface.IMAGE
    return tuple(
        topic for topic in interface.TOPICS
        if target in topic.subscribers and topic.recorded == interface.PER_STEP
        and not (target == interface.PERCEPTION and topic is unused)
    )


def _check_types(bag: Path, inputs: tuple[Topic, ...]) -> None:
    recorded = {topic.name: topic for topic in read_info(bag).topics}
    for topic in inputs:
        found = recorded.get(bag_name(topic))
        if found is None and topic is not interface.IMAGE:
            raise UsageError(f'{bag}: no topic {bag_name(topic)}, so there is nothing to replay')
        if found is not None and found.type_hash != type_hash(topic.type_name):
            raise UsageError(
                f'{bag}: {topic.type_name} on {found.name} is of another version than the '
                'installed one; record the run again: taxinet run --from'
            )


def _steps(bag: Path, inputs: tuple[Topic, ...]) -> Iterator[Step]:
    """The inputs of every control step, frames rendered where the bag has none."""
    if inputs == (interface.IMAGE,):
        for seq, cdr in frame_messages(bag):
            yield seq, {interface.IMAGE.name: [cdr]}
        return
    names = {bag_name(topic): topic.name for topic in inputs}
    messages = stored_messages(bag, names.__contains__)
    for seq, group in groupby(messages, lambda message: message.stamp_ns // CONTROL_PERIOD_NS):
        step: dict[str, list[bytes]] = {}
        for message in group:
            step.setdefault(names[message.topic.name], []).append(message.cdr)
        if len(step) == len(inputs):  # A run that broke down may have left a torn step.
            yield seq, step


@contextlib.contextmanager
def _spinning() -> Iterator[tuple[Any, Context, Any]]:
    """An executor on a domain of its own, its context, and what adds a node to both."""
    with own_domain() as domain:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        executor = EventsExecutor(context=context)
        nodes: list[Any] = []

        def add(node: Any) -> None:
            nodes.append(node)
            executor.add_node(node)

        try:
            yield executor, context, add
        finally:
            for node in reversed(nodes):
                executor.remove_node(node)
                node.destroy_node()
            executor.shutdown()
            rclpy.try_shutdown(context=context)


def _columns(answer: Topic, answers: dict[int, dict[str, list[Any]]]) -> Columns:
    rows = []
    for seq, messages in sorted(answers.items()):
        row = {'seq': float(seq)}
        for message in messages[answer.name]:
            row.update(_numbers(message))
        rows.append(row)
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}


def _numbers(message: Any) -> dict[str, float]:
    """The numbers of one answer, named as in a trace; an estimate that is invalid has none."""
    if isinstance(message, interface.ESTIMATE.type):
        if not message.valid:
            return {}
        return {'est_cte_m': message.cross_track_error, 'est_he_rad': message.heading_error}
    if isinstance(message, interface.COMMAND.type):
        return {'steering_rad': message.steering_angle, 'speed_cmd_mps': message.speed}
    return {
        f'rho_lower.{message.spec}': message.rho_lower,
        f'rho_upper.{message.spec}': message.rho_upper,
    }
