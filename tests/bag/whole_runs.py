"""Whole runs of ours, as the recorder writes them, made by the closed loop without ROS."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from bag_samples import QOS, Sample, make, serialise, store

from taxinet_ros.bag.run.message_values import reading_values, verdict_values
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import Scenario, scenario_from_human

TYPES = {
    '/scenario': 'taxinet_msgs/msg/Scenario',
    '/node_status': 'taxinet_msgs/msg/NodeStatus',
    '/clock': 'rosgraph_msgs/msg/Clock',
    '/camera/image_raw': 'sensor_msgs/msg/Image',
    '/ground_truth/odom': 'nav_msgs/msg/Odometry',
    '/ground_truth/tracking_error': 'taxinet_msgs/msg/TrackingError',
    '/perception/tracking_error': 'taxinet_msgs/msg/TrackingError',
    '/taxi_command': 'taxinet_msgs/msg/TaxiCommand',
    '/monitor/robustness': 'taxinet_msgs/msg/Robustness',
    '/monitor/verdict': 'taxinet_msgs/msg/Verdict',
    '/run_status': 'taxinet_msgs/msg/RunStatus',
}
RUN_ID = 'program-s7-00003'
PARTICIPANTS = ('mtl_monitor', 'perception', 'recorder', 'steering_controller')
SPECS = ('phi_eventually', 'on_runway')
STEPS = 16
PER_STEP = 9
"""Messages of a control step: seven topics, one of them with a message for each formula."""

WEIGHTS = 'ab' * 32
SCENE = scenario_from_human({
    'cross_track': -2.5, 'heading': 8, 'distance': 640, 'clouds': 'broken', 'rain': 30,
    'time_of_day': 9.25, 'duration': (STEPS - 1) / 10,
})


def run_topics() -> list[TopicInfo]:
    """The topics of such a run."""
    return [
        TopicInfo(
            name=name, type=kind, qos=QOS, type_hash=store().hash_rihs01(kind),
            definition=_definition(kind),
        )
        for name, kind in TYPES.items()
    ]


@cache
def run_messages() -> tuple[Sample, ...]:
    """Everything that such a run holds, in the recorder's order."""
    steps: list[Step] = []
    specs = [parse_spec(text) for text in SPECS]
    judgement = run_closed_loop(
        SCENE, make_perception('truth'), specs=specs, on_step=steps.append
    )
    messages = [('/scenario', 0, serialise(_scenario(SCENE)))]
    messages += [('/node_status', 0, serialise(_ready(node))) for node in PARTICIPANTS]
    for step in steps:
        stamp_ns = step.observation.stamp_ns
        messages += [(name, stamp_ns, serialise(m)) for name, m in _step(step, specs)]
    last = steps[-1]
    robustness = [_robustness(last, number, specs) for number in range(len(specs))]
    end = {**_stamped(last), 'run_id': RUN_ID}
    verdict = make(
        'taxinet_msgs/msg/Verdict', **_stamped(last), specs=robustness,
        **verdict_values(judgement, RUN_ID),
    )
    status = make(
        'taxinet_msgs/msg/RunStatus', **end, state=2, seq=STEPS - 1, perception='truth',
        outcome='PASS' if judgement.satisfied else 'FAIL',
    )
    stamp_ns = last.observation.stamp_ns
    messages += [
        ('/monitor/verdict', stamp_ns, serialise(verdict)),
        ('/run_status', stamp_ns, serialise(status)),
    ]
    return tuple(messages)


def write_run(folder: Path, messages: tuple[Sample, ...] | list[Sample] | None = None) -> Path:
    """Record such a run into ``folder`` as the recorder does; return the storage file."""
    with BagWriter(
        folder, run_topics(), metadata={'taxinet_ros_version': '1.2.3', 'run_id': RUN_ID},
        attachments={'scenario.json': json.dumps(SCENE.to_human()).encode()}, min_free_bytes=0,
    ) as bag:
        before = None
        for topic, stamp_ns, cdr in run_messages() if messages is None else messages:
            once = topic in ('/scenario', '/node_status', '/monitor/verdict', '/run_status')
            now = None if once else stamp_ns
            if before is not None and now != before:
                bag.flush()
            before = now
            bag.write(topic, cdr, stamp_ns)
        bag.add_metadata('taxinet_outcome', {'outcome': 'PASS', 'steps': str(STEPS)})
        return bag.close().mcap


def _definition(kind: str) -> str:
    """As installed where it is one of ours, for its comments tell units."""
    text, _ = store().generate_msgdef(kind, ros_version=2)
    own = Path(__file__).parents[2] / 'msg_defs' / 'msg' / f'{kind.split("/")[-1]}.msg'
    if kind.startswith('taxinet_msgs/'):
        _, separator, rest = text.partition('\n' + '=' * 80)
        return own.read_text() + separator + rest
    return text


def _stamped(step: Step) -> dict[str, int]:
    sec, nanosec = divmod(step.observation.stamp_ns, 1_000_000_000)
    return {'header__stamp__sec': sec, 'header__stamp__nanosec': nanosec}


def _scenario(scene: Scenario) -> Any:
    return make(
        'taxinet_msgs/msg/Scenario', run_id=RUN_ID, index=3, program='program', seed=7,
        **dataclasses.asdict(scene), specs=list(SPECS), participants=list(PARTICIPANTS),
    )


def _ready(node: str) -> Any:
    eyes = {'implementation': 'taxinet', 'fingerprint': WEIGHTS} if node == 'perception' else {}
    law = {'implementation': 'heading_gain=1.5'} if node == 'steering_controller' else {}
    return make('taxinet_msgs/msg/NodeStatus', run_id=RUN_ID, node=node, **eyes, **law)


def _step(step: Step, specs: list[Any]) -> list[tuple[str, Any]]:
    now, stamp = step.observation, _stamped(step)
    named = {**stamp, 'run_id': RUN_ID, 'seq': now.seq}
    state, pixels = now.state, np.full((200, 360, 3), 60 + 10 * now.seq, dtype=np.uint8)
    sec, nanosec = stamp.values()
    return [
        ('/clock', make('rosgraph_msgs/msg/Clock', clock__sec=sec, clock__nanosec=nanosec)),
        ('/camera/image_raw', make(
            'sensor_msgs/msg/Image', **stamp, height=200, width=360, encoding='rgb8', step=1080,
            data=pixels.reshape(-1),
        )),
        ('/ground_truth/odom', make(
            'nav_msgs/msg/Odometry', **stamp, pose__pose__position__x=state.x_m,
            pose__pose__position__y=state.y_m, twist__twist__linear__x=state.speed_mps,
        )),
        ('/ground_truth/tracking_error', _error(state.tracking_error, named)),
        ('/perception/tracking_error', _error(step.estimate, named)),
        ('/taxi_command', make(
            'taxinet_msgs/msg/TaxiCommand', **named, steering_angle=step.command.steering_rad,
            speed=step.command.speed_mps,
        )),
        *(('/monitor/robustness', _robustness(step, k, specs)) for k in range(len(specs))),
    ]


def _error(error: Any, named: dict[str, Any]) -> Any:
    return make(
        'taxinet_msgs/msg/TrackingError', **named, cross_track_error=error.cte_m,
        heading_error=error.he_rad, valid=error.valid,
    )


def _robustness(step: Step, number: int, specs: list[Any]) -> Any:
    return make(
        'taxinet_msgs/msg/Robustness', **_stamped(step),
        **reading_values(specs[number], step.readings[number], RUN_ID, step.observation.seq),
    )
