"""Whole runs of ours, as the recorder writes them, made by the closed loop without ROS."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from bag_samples import Sample

from taxinet_ros.bag.reader import read_messages
from taxinet_ros.bag.run import run_bag
from taxinet_ros.bag.run.run_bag import NodeWords, RunEnding, bag_topics
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest

TYPES = {topic.name: topic.type for topic in bag_topics()}
RUN_ID = 'program-s7-00003'
PARTICIPANTS = ('mtl_monitor', 'perception', 'recorder', 'steering_controller')
SPECS = ('phi_eventually', 'on_runway')
STEPS = 16
PER_STEP = 10
"""Messages of a control step: nine topics, one of them with a message for each formula."""

WEIGHTS = 'ab' * 32
SCENE = scenario_from_human({
    'cross_track': -2.5, 'heading': 8, 'distance': 640, 'clouds': 'broken', 'rain': 30,
    'time_of_day': 9.25, 'duration': (STEPS - 1) / 10,
})


def run_topics() -> list[TopicInfo]:
    """The topics of such a run."""
    return list(bag_topics())


@cache
def run_messages() -> tuple[Sample, ...]:
    """Everything that such a run holds, in the recorder's order; its frames are plain grey."""
    steps: list[Step] = []
    specs = [parse_spec(text) for text in SPECS]
    judgement = run_closed_loop(SCENE, make_perception('truth'), specs=specs, on_step=steps.append)
    says = {
        'perception': {'implementation': 'taxinet', 'fingerprint': WEIGHTS},
        'steering_controller': {'implementation': 'heading_gain=1.5'},
    }
    request = RunRequest(
        run_id=RUN_ID, index=3, program='program', seed=7, scenario=SCENE,
        judging=Judging(specs=SPECS), participants=PARTICIPANTS,
    )
    with tempfile.TemporaryDirectory() as scratch:
        run_bag.write_run(
            Path(scratch) / RUN_ID, request, steps=steps, judgement=judgement,
            nodes=[NodeWords(node=name, **says.get(name, {})) for name in PARTICIPANTS],
            frames=[np.full((200, 360, 3), 60 + 10 * seq, np.uint8) for seq in range(STEPS)],
            ending=RunEnding(
                outcome='PASS' if judgement.satisfied else 'FAIL', perception='truth',
                fingerprint='',
            ),
        )
        found = read_messages(Path(scratch) / RUN_ID)
        return tuple((one.topic, one.stamp_ns, one.cdr) for one in found)


def write_run(folder: Path, messages: tuple[Sample, ...] | list[Sample] | None = None) -> Path:
    """Record such a run into ``folder`` as the recorder does; return the storage file."""
    with BagWriter(
        folder, run_topics(), metadata={'taxinet_ros_version': '1.2.3', 'run_id': RUN_ID},
        attachments={'scenario.json': b'{}'}, min_free_bytes=0,
    ) as bag:
        before = None
        for topic, stamp_ns, cdr in run_messages() if messages is None else messages:
            once = topic in (
                '/scenario', '/node_status', '/tf_static', '/monitor/verdict', '/run_status')
            now = None if once else stamp_ns
            if before is not None and now != before:
                bag.flush()
            before = now
            bag.write(topic, cdr, stamp_ns)
        bag.add_metadata('taxinet_outcome', {'outcome': 'PASS', 'steps': str(STEPS)})
        return bag.close().mcap
