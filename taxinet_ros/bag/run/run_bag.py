"""Content of a run's bag (topics and metadata), and writing the bag of a run in one process.

The recorder node writes received messages (``nodes/recorder.py``); :func:`write_run` writes the
same messages for a run of :mod:`taxinet_ros.core.loop`, which has no ROS graph.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.cdr.alignment import Canonical
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
from taxinet_ros.bag.run.transforms import OdometryTransforms, camera_transform
from taxinet_ros.bag.topics import TopicInfo, describe_topic, offered_qos
from taxinet_ros.bag.writer import FORK_METADATA, BagWriter
from taxinet_ros.core import topics
from taxinet_ros.core.loop import Step
from taxinet_ros.core.motion.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.mtl import Spec
from taxinet_ros.core.provenance import COMMIT, provenance, without_commit
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.topics import Topic
from taxinet_ros.core.verdict.judge import Judgement
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import disk_words, draft_path, sync_folder
from taxinet_ros.version import __version__

_TOPICS = (*topics.TOPICS, *topics.TRANSFORMS)


def bag_name(topic: Topic) -> str:
    """Name of a topic in a bag, independent of the graph's namespace."""
    return '/' + topic.name.lstrip('/')


@functools.cache
def bag_topics(images: bool = True) -> tuple[TopicInfo, ...]:
    """Recorded topics of the graph, as bag topic descriptions.

    Args:
        images: whether to include camera frames.
    """
    return tuple(
        describe_topic(
            name=bag_name(topic), type_name=topic.type_name,
            qos=offered_qos(**dataclasses.asdict(topic.quality)),
        )
        for topic in _TOPICS if topic.recorded and (images or topic.name != topics.IMAGE.name)
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


@dataclass(frozen=True, kw_only=True)
class RunEnding:
    """End of a run; fields of its last ``RunStatus``."""

    outcome: str
    kind: str = ''
    who: str = ''
    detail: str = ''
    perception: str
    fingerprint: str


def write_run(
    folder: Path, request: RunRequest, *, nodes: Sequence[NodeWords], steps: Sequence[Step],
    frames: Iterable[NDArray[np.uint8] | None] | None, judgement: Judgement, ending: RunEnding,
    fork: str = '',
) -> None:
    """Write the bag of a finished run atomically.

    Args:
        folder: the run folder, named like the run; it must not exist, its parents are created.
        request: the run request.
        nodes: reports of the nodes that a ROS graph would have, without nodes that report nothing.
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
    named = bag_topics(frames is not None)
    canonical = Canonical(named)
    scenario_cdr = message_cdr(
        topics.SCENARIO, {'header': header_values(0), **scenario_values(request)}
    )
    scenario = decode(named[0], scenario_cdr)
    try:
        if draft.exists():
            shutil.rmtree(draft)
        with BagWriter(
            made, named, metadata=run_words(scenario),
            attachments={'scenario.json': scenario_json(scenario)}, beside=commit_words(),
        ) as writer:

            def write(seq: int, messages: Iterable[Said]) -> None:
                for topic, cdr in messages:
                    name = bag_name(topic)
                    writer.write(name, canonical.message(name, cdr), seq * CONTROL_PERIOD_NS)

            camera = request.scenario.camera_model
            write(0, [(topics.SCENARIO, scenario_cdr), *_ready(request.run_id, nodes, camera)])
            specs, transform_of = request.judging.parsed_specs, OdometryTransforms()
            pictures = itertools.repeat(None) if frames is None else frames
            for step, picture in zip(steps, pictures, strict=frames is not None):
                said = _step(step, picture, request.run_id, specs, transform_of, camera)
                write(step.observation.seq, said)
                writer.flush()
            last_seq = steps[-1].observation.seq
            write(last_seq, _end(request.run_id, specs, last_seq, judgement, ending))
            if fork:
                writer.add_metadata(FORK_METADATA, {'fork': fork})
            writer.add_metadata(OUTCOME_METADATA, outcome_words(ending, len(steps)))
        made.rename(folder)
        sync_folder(folder.parent)
    except OSError as error:
        raise BagWriteError(
            f'{folder}: cannot write: {disk_words(error)}', path=folder, errno=error.errno or 0
        ) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


Said = tuple[Topic, bytes]


def _ready(
    run_id: str, nodes: Sequence[NodeWords], camera: CameraModel
) -> Iterator[Said]:
    for one in sorted(nodes, key=lambda one: one.node):
        yield topics.NODE_STATUS, message_cdr(topics.NODE_STATUS, {
            'header': header_values(0, ''), 'run_id': run_id, 'state': NODE_READY,
            **dataclasses.asdict(one),
        })
    yield topics.TF_STATIC, camera_transform(camera)


def _step(
    step: Step, picture: NDArray[np.uint8] | None, run_id: str, specs: Sequence[Spec],
    transform_of: OdometryTransforms, camera: CameraModel,
) -> Iterator[Said]:
    """Messages of a control step, in the recorder's order (that of the topic table)."""
    now = step.observation
    at = run_id, now.seq, now.stamp_ns
    said = dict(observation_messages(dataclasses.replace(now, image=picture), run_id, camera))
    said |= {
        topics.ESTIMATE: error_cdr(step.estimate, *at),
        topics.COMMAND: command_cdr(step.command, *at),
    }
    for topic in topics.TOPICS:
        if topic in said:
            yield topic, said[topic]
        if topic is topics.ODOMETRY:
            yield topics.TF, transform_of(said[topic])
    for spec, reading in zip(specs, step.readings, strict=True):
        yield topics.ROBUSTNESS, robustness_cdr(spec, reading, *at)


def _end(
    run_id: str, specs: Sequence[Spec], seq: int, judgement: Judgement, ending: RunEnding
) -> Iterator[Said]:
    header = header_values(seq * CONTROL_PERIOD_NS)
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
