"""Split a recording of several runs into one bag per run, as written by the recorder node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from taxinet_ros.bag.cdr.alignment import Canonical
from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.errors import BagForeign
from taxinet_ros.bag.layout import is_run_name
from taxinet_ros.bag.rewrite.copying import storable_topic, write_steps
from taxinet_ros.bag.run.message_values import scenario_json, scenario_of
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.bag.run.run_bag import OUTCOME_METADATA, bag_topics, outcome_words
from taxinet_ros.bag.run.runs import RANK_IN_STEP, RunPart
from taxinet_ros.bag.run.topics import (
    NODE_STATUS,
    ODOMETRY,
    RUN_STATUS,
    SCENARIO,
    VERDICT,
    is_of_frames,
)
from taxinet_ros.bag.run.transforms import OdometryTransforms, camera_transform
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.errors import UsageError


def write_runs(recording: Recording, folders: Mapping[str, Path]) -> None:
    """Write a bag for each selected run, as by the recorder node.

    Messages are the same. Attachments, metadata and transforms are derived from them; Scenic
    program, versions and machine are in no message and so are missing.

    Args:
        recording: recording of several runs, or by another recorder.
        folders: new run folder by run name.
    """
    numbers = {i: run for i, run in enumerate(recording.runs) if run.name in folders}
    for run in numbers.values():
        if run.scenario is None:
            raise UsageError(
                f'{recording.path}: run {run.name}: no message on {SCENARIO}, so its scenario is '
                'unknown'
            )
        if not is_run_name(run.run_id):
            raise BagForeign(f'{recording.path}: run {run.run_id!r:.80} is not a valid folder name')
        if run.unclear:
            raise BagForeign(f'{recording.path}: run {run.name}: {run.unclear}')
    held: dict[int, list[StoredMessage]] = {i: [] for i in numbers}
    left = Counter(recording.owners)
    for number, stored in recording.messages_of_runs(whole=True):
        left[number] -= 1
        if number in held:
            held[number].append(stored)
            if not left[number]:  # Write each run once complete: frames take much memory.
                _write_run(recording, numbers[number], held.pop(number), folders)


def _write_run(
    recording: Recording, run: RunPart, messages: list[StoredMessage], folders: Mapping[str, Path]
) -> None:
    dropped: list[str] = []
    told = {stored.topic.name: stored.topic for stored in messages}
    ordered = sorted(told.values(), key=lambda topic: RANK_IN_STEP[topic.name.removeprefix('/')])
    topics = [t for topic in ordered if (t := storable_topic(topic, dropped.append)) is not None]
    if dropped:
        raise BagForeign(f'{recording.path}: {dropped[0].removeprefix("left out: ")}')
    canonical = Canonical(topics)
    assert run.scenario is not None
    scenario = decode(run.scenario.topic, run.scenario.cdr)
    words = {
        'run_id': run.run_id, 'program': str(scenario.program), 'seed': str(scenario.seed),
        'index': str(scenario.index), 'split_from': recording.path.name,
    }
    fixed, moving = (topic for topic in bag_topics() if is_of_frames(topic.name))
    in_order = (
        stored._replace(cdr=canonical.message(stored.topic.name, stored.cdr))
        for stored in sorted(messages, key=_place)
    )
    with BagWriter(
        folders[run.name], [*topics, fixed, moving], metadata=words,
        attachments={'scenario.json': scenario_json(scenario)}, min_free_bytes=0,
    ) as bag:
        write_steps(bag, _with_transforms(
            in_order, fixed, moving, camera_transform(*scenario_of(scenario).cameras)
        ))
        for stored in messages:
            if stored.topic.name == f'/{RUN_STATUS}':
                status = decode(stored.topic, stored.cdr)
                bag.add_metadata(OUTCOME_METADATA, outcome_words(status, len(run.stamps_ns)))


def _with_transforms(
    messages: Iterable[StoredMessage], fixed: TopicInfo, moving: TopicInfo, of_cameras: bytes
) -> Iterator[StoredMessage]:
    """The messages of a run with its transforms, where the recorder puts them."""
    transform_of, begun = OdometryTransforms(), False
    for stored in messages:
        if not begun and stored.topic.name.removeprefix('/') not in (SCENARIO, NODE_STATUS):
            begun = True
            yield StoredMessage(fixed, 0, of_cameras, 0)
        yield stored
        if stored.topic.name == f'/{ODOMETRY}':
            yield stored._replace(topic=moving, cdr=transform_of(stored.cdr))


def _place(stored: StoredMessage) -> tuple[int, int, int, str]:
    """Sort key of a message in the recorder's order: head, steps, end."""
    relative = stored.topic.name.removeprefix('/')
    if relative in (SCENARIO, NODE_STATUS):
        node = str(decode(stored.topic, stored.cdr).node) if relative == NODE_STATUS else ''
        return 0, 0, RANK_IN_STEP[relative], node
    end = int(relative in (VERDICT, RUN_STATUS))
    return 1 + end, 0 if end else stored.stamp_ns, RANK_IN_STEP[relative], ''
