"""Content of a run's bag (topics and metadata), and writing the bag of a run in one process.

The recorder node writes received messages (:mod:`.live_bag`); :func:`write_run` writes the
same messages for a run of :mod:`taxinet_ros.core.loop`, which has no ROS graph.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.errors import BagWriteError
from taxinet_ros.bag.layout import run_folder
from taxinet_ros.bag.run.message_values import (
    reading_values,
    scenario_json,
    scenario_values,
    verdict_values,
)
from taxinet_ros.bag.run.messages import (
    command_cdr,
    error_cdr,
    header_values,
    message_cdr,
    observation_messages,
    robustness_cdr,
)
from taxinet_ros.bag.run.topics import NODE_READY, RUN_ENDED
from taxinet_ros.bag.run.transforms import aircraft_transform, camera_transform
from taxinet_ros.bag.topics import TopicInfo, describe_topic, offered_qos
from taxinet_ros.bag.writer import FORK_METADATA, MIN_FREE_BYTES, BagWriter
from taxinet_ros.core import topics
from taxinet_ros.core.control_step import Observation
from taxinet_ros.core.loop import Step
from taxinet_ros.core.motion.controller import Controller, SteeringGains, SteeringLaw, gains_text
from taxinet_ros.core.mtl import Spec
from taxinet_ros.core.pacing.timing import Timing
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.provenance import COMMIT, provenance, without_commit
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.topics import Topic
from taxinet_ros.core.types import TrackingError, step_stamp_ns
from taxinet_ros.core.verdict.judge import Judgement
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.core.world import ChosenWorld
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import disk_words, draft_path, sync_folder
from taxinet_ros.registry import CONTROLLERS, PERCEPTIONS, origin_words
from taxinet_ros.version import __version__

_TOPICS = (*topics.TOPICS, *topics.TRANSFORMS)


def bag_name(topic: Topic) -> str:
    """Name of a topic in a bag, independent of the graph's namespace."""
    return '/' + topic.name.lstrip('/')


_BAG_NAMES = {topic.name: bag_name(topic) for topic in _TOPICS}
_RANKS = {
    topic.name: rank for rank, topic in enumerate(
        topic for one in topics.TOPICS if one.each_step
        for topic in ((one, topics.TF) if one is topics.ODOMETRY else (one,))
    )
}
"""The recorder's order of the topics of a control step."""


@functools.cache
def bag_topics(images: bool = True, sensors: tuple[str, ...] = ()) -> tuple[TopicInfo, ...]:
    """Recorded topics of the graph, as bag topic descriptions.

    Args:
        images: whether to include camera frames.
        sensors: names of the sensors beside the camera.
    """
    left_out = {topic.name for name, topic in topics.SENSORS.items() if name not in sensors}
    left_out |= set() if images else {topic.name for topic in topics.FRAMES}
    return tuple(
        describe_topic(
            name=bag_name(topic), type_name=topic.type_name,
            qos=offered_qos(**dataclasses.asdict(topic.quality)),
        )
        for topic in _TOPICS if topic.recorded and topic.name not in left_out
    )


def run_words(scenario: Any) -> dict[str, str]:
    """Metadata of a run's bag: the run, machine and versions.

    Args:
        scenario: scenario message of the run.
    """
    return {
        'taxinet_ros_version': __version__,
        **{name: value for name, value in without_commit(provenance()).items()
           if name != 'taxinet_ros'},
        'run_id': scenario.run_id,
        'program': scenario.program,
        'seed': str(scenario.seed),
        'index': str(scenario.index),
        'specs': json.dumps(list(scenario.specs)),
    }


def commit_words() -> dict[str, str]:
    """Metadata for ``metadata.yaml`` only, in which bags of equal runs may differ."""
    return {name: value for name, value in provenance().items() if name == COMMIT}


class BegunBag:
    """Bag of a run, with its request and what is known before its first message.

    The file has its final name from the start; closing it marks it as complete.

    Attributes:
        folder: the run folder.
    """

    def __init__(
        self, folder: Path, scenario: Any, *, images: bool, sensors: tuple[str, ...],
        attachments: Mapping[str, bytes], min_free_bytes: int, make_parents: bool,
    ) -> None:
        """Start the bag.

        Args:
            folder: the run folder, named like the run; it must not exist.
            scenario: scenario message of the run.
            images: whether there will be camera frames.
            sensors: names of the sensors beside the camera.
            attachments: files to attach besides the request, by name.
            min_free_bytes: required free disk space [bytes].
            make_parents: whether to create the folder's parents.

        Raises:
            UsageError: the folder exists, its name is not a valid run name, or the disk is full.
            BagWriteError: an error of the operating system.
        """
        self.folder = folder
        self._writer = BagWriter(
            folder, bag_topics(images, sensors), metadata=run_words(scenario),
            beside=commit_words(),
            attachments={'scenario.json': scenario_json(scenario), **attachments},
            min_free_bytes=min_free_bytes, make_parents=make_parents,
        )

    def abandon(self) -> None:
        """Stop without marking the bag as complete; keeps what was written."""
        self._writer.abandon()

    def _write(self, topic: Topic, cdr: bytes, stamp_ns: int) -> None:
        self._writer.write(_BAG_NAMES[topic.name], cdr, stamp_ns)


OUTCOME_METADATA = 'taxinet_outcome'


def outcome_words(ended: Any, steps: int) -> dict[str, str]:
    """Metadata record with the outcome of a run.

    Args:
        ended: last ``RunStatus`` of the run.
        steps: number of control steps in the bag.
    """
    return {
        'outcome': ended.outcome, 'kind': ended.kind, 'who': ended.who,
        'detail': ended.detail, 'steps': str(steps),
        'perception': ended.perception, 'weights_sha256': ended.fingerprint,
    }


@dataclass(frozen=True, kw_only=True)
class NodeWords:
    """Report of a node when it is ready.

    Attributes:
        node: name of the node.
        implementation, fingerprint, detail: fields of ``NodeStatus``.
        listens: names of its subscribed topics.
    """

    node: str
    implementation: str = ''
    fingerprint: str = ''
    detail: str = ''
    listens: tuple[str, ...] = ()


def node_words(
    eyes: Perception, hands: Controller, world: ChosenWorld, timing: Timing, scenario: Scenario
) -> tuple[NodeWords, ...]:
    """Reports of the nodes that a ROS graph would have with these parts."""
    usual = dataclasses.asdict(SteeringGains())
    tuned = {
        name: gain for name, gain in dataclasses.asdict(hands.gains).items() if gain != usual[name]
    } if isinstance(hands, SteeringLaw) else {}
    seen = topics.IMAGE if eyes.needs_image else topics.TRUTH
    heard = topics.ODOMETRY, topics.TRUTH, topics.ESTIMATE, topics.COMMAND
    nodes = [
        NodeWords(
            node=topics.PERCEPTION, implementation=eyes.word, fingerprint=eyes.fingerprint,
            detail=origin_words(PERCEPTIONS, eyes.word),
            listens=(
                topics.SCENARIO.name, *_sensor_topics(eyes), seen.name,
                *_second_camera(eyes, scenario),
            ),
        ),
        NodeWords(
            node=topics.STEERING_CONTROLLER, fingerprint=hands.fingerprint,
            implementation=gains_text(tuned) if isinstance(hands, SteeringLaw) else hands.word,
            detail=origin_words(CONTROLLERS, hands.word),
            listens=(
                topics.SCENARIO.name, *_sensor_topics(hands), topics.ESTIMATE.name,
                *((topics.IMAGE.name,) if hands.needs_image else ()),
                *_second_camera(hands, scenario),
            ),
        ),
        NodeWords(
            node=topics.MTL_MONITOR,
            listens=(topics.SCENARIO.name, *(topic.name for topic in heard)),
        ),
        NodeWords(node=topics.RECORDER),
    ]
    detail = world.origin
    if timing.words or detail:
        nodes.append(NodeWords(
            node=topics.SIMULATOR, implementation=timing.words, fingerprint=world.fingerprint,
            detail=detail,
        ))
    return tuple(nodes)


def _sensor_topics(part: Perception | Controller) -> list[str]:
    named = [one.name for one in topics.SENSORS.values() if one is not topics.CAMERA2]
    return named if part.needs_sensors else []


def _second_camera(part: Perception | Controller, scenario: Scenario) -> list[str]:
    """Heard only in runs that have one: it is the only sensor whose messages are large."""
    there = part.needs_sensors and scenario.sensor_set.camera
    return [topics.CAMERA2.name] if there else []


@dataclass(frozen=True, kw_only=True)
class RunEnding:
    """End of a run; fields of its last ``RunStatus``."""

    outcome: str
    kind: str = ''
    who: str = ''
    detail: str = ''
    perception: str
    fingerprint: str


Said = tuple[Topic, bytes]


class RunBag(BegunBag):
    """Bag of a run without ROS graph, written step by step as the recorder node does."""

    def __init__(
        self, folder: Path, request: RunRequest, nodes: Sequence[NodeWords], *, images: bool,
        attachments: Mapping[str, bytes] = MappingProxyType({}),
        min_free_bytes: int = MIN_FREE_BYTES, make_parents: bool = True,
    ) -> None:
        """Start the bag as :class:`BegunBag`, with the messages before the first step.

        ``nodes`` are reports of the nodes that a ROS graph would have, without those that report
        nothing.
        """
        self._run_id = request.run_id
        self._specs = request.judging.parsed_specs
        self._cameras, self._filmed = request.scenario.cameras, images
        self._period_ns = request.scenario.period_ns
        self._steps = 0
        sensors = request.scenario.sensor_set.names
        scenario_cdr = message_cdr(
            topics.SCENARIO, {'header': header_values(0), **scenario_values(request)}
        )
        super().__init__(
            folder, decode(bag_topics(images)[0], scenario_cdr), images=images, sensors=sensors,
            attachments=attachments, min_free_bytes=min_free_bytes, make_parents=make_parents,
        )
        ready = _ready(request.run_id, nodes, self._cameras)
        for topic, cdr in ((topics.SCENARIO, scenario_cdr), *ready):
            self._write(topic, cdr, 0)

    def step(self, step: Step, picture: NDArray[np.uint8] | None) -> None:
        """Write a control step, with its frame (200, 360, 3) uint8 RGB if there is one.

        Raises:
            BagWriteError: an error of the operating system.
        """
        now = step.observation
        at = self._run_id, now.seq, now.stamp_ns
        self._take(now, picture, [
            (topics.ESTIMATE, error_cdr(step.estimate, *at)),
            (topics.COMMAND, command_cdr(step.command, *at)),
        ], [
            (topics.ROBUSTNESS, robustness_cdr(spec, reading, *at))
            for spec, reading in zip(self._specs, step.readings, strict=True)
        ])
        self._steps += 1

    def torn_step(
        self, now: Observation, picture: NDArray[np.uint8] | None, estimate: TrackingError | None
    ) -> None:
        """Write the step in which a run broke: what was observed, and the estimate if any."""
        at = self._run_id, now.seq, now.stamp_ns
        said = [] if estimate is None else [(topics.ESTIMATE, error_cdr(estimate, *at))]
        self._take(now, picture, said, [])

    def _take(
        self, now: Observation, picture: NDArray[np.uint8] | None, answers: Sequence[Said],
        readings: Sequence[Said],
    ) -> None:
        """Write a step's messages in the recorder's order, that of the topic table."""
        seen = now if self._filmed else now.without_second_camera
        observed = observation_messages(seen, picture, self._run_id, self._cameras[0])
        moved = topics.TF, aircraft_transform(now.state, now.stamp_ns)
        # By name, as hashing a topic takes as long as serialising its message.
        ordered = sorted((*observed, *answers, moved), key=lambda said: _RANKS[said[0].name])
        for topic, cdr in (*ordered, *readings):  # canonical, as serialised here
            self._writer.write(_BAG_NAMES[topic.name], cdr, now.stamp_ns)
        self._writer.flush()

    def end(
        self, ending: RunEnding, seq: int, judgement: Judgement | None, *, fork: str = ''
    ) -> None:
        """Complete the bag.

        Args:
            ending: end of the run.
            seq: its last control step.
            judgement: judgement of the run; None if it broke.
            fork: what a forked run was forked from, as
                :attr:`taxinet_ros.core.fork.Fork.text`.

        Raises:
            BagWriteError: an error of the operating system.
        """
        seq = max(seq, 0)
        stamp_ns = step_stamp_ns(seq, self._period_ns)
        for topic, cdr in _end(self._run_id, self._specs, seq, stamp_ns, judgement, ending):
            self._write(topic, cdr, stamp_ns)
        if fork:
            self._writer.add_metadata(FORK_METADATA, {'fork': fork})
        self._writer.add_metadata(OUTCOME_METADATA, outcome_words(ending, self._steps))
        self._writer.close()


def write_run(
    folder: Path, request: RunRequest, *, nodes: Sequence[NodeWords], steps: Sequence[Step],
    frames: Iterable[NDArray[np.uint8] | None] | None, judgement: Judgement, ending: RunEnding,
    fork: str = '',
) -> None:
    """Write the bag of a finished run atomically.

    Args:
        folder: the run folder, named like the run; it must not exist, its parents are created.
        request: the run request.
        nodes: as for :class:`RunBag`.
        steps: control steps in order; their images are not used.
        frames: for each step (200, 360, 3) uint8 RGB, or None for a step without image; None for a
            bag without images.
        judgement: judgement of the run.
        ending: end of the run.
        fork: what a forked run was forked from, as :attr:`taxinet_ros.core.fork.Fork.text`.

    Raises:
        UsageError: the folder exists, its name is not a valid run name, or the disk is full.
        BagWriteError: an error of the operating system.
    """
    if folder.exists() or folder.is_symlink():
        raise UsageError(
            f'{folder}: exists already; nothing recorded is overwritten, name another folder'
        )
    # In a separate parent folder, because the storage file is named after the run folder.
    draft = draft_path(folder)
    made = run_folder(draft, folder.name)
    try:
        if draft.exists():
            shutil.rmtree(draft)
        bag = RunBag(made, request, nodes, images=frames is not None)
        try:
            pictures = itertools.repeat(None) if frames is None else frames
            for step, picture in zip(steps, pictures, strict=frames is not None):
                bag.step(step, picture)
            bag.end(ending, steps[-1].observation.seq, judgement, fork=fork)
        except BaseException:
            bag.abandon()
            raise
        made.rename(folder)
        sync_folder(folder.parent)
    except OSError as error:
        raise BagWriteError(
            f'{folder}: cannot write: {disk_words(error)}', path=folder, errno=error.errno or 0
        ) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _ready(
    run_id: str, nodes: Sequence[NodeWords], cameras: Sequence[CameraModel]
) -> Iterator[Said]:
    for one in sorted(nodes, key=lambda one: one.node):
        yield topics.NODE_STATUS, message_cdr(topics.NODE_STATUS, {
            'header': header_values(0, ''), 'run_id': run_id, 'state': NODE_READY,
            **dataclasses.asdict(one),
        })
    yield topics.TF_STATIC, camera_transform(*cameras)


def _end(
    run_id: str, specs: Sequence[Spec], seq: int, stamp_ns: int, judgement: Judgement | None,
    ending: RunEnding,
) -> Iterator[Said]:
    header = header_values(stamp_ns)
    if judgement is not None:
        readings = [
            {'header': header, **reading_values(spec, reading, run_id, seq)}
            for spec, reading in zip(specs, judgement.readings, strict=True)
        ]
        yield topics.VERDICT, message_cdr(topics.VERDICT, {
            'header': header, 'specs': readings, **verdict_values(judgement, run_id),
        })
    yield topics.RUN_STATUS, message_cdr(topics.RUN_STATUS, {
        'header': header, 'run_id': run_id, 'state': RUN_ENDED, 'seq': seq,
        **dataclasses.asdict(ending),
    })
