"""All checks of a bag from any recorder.

Checks bytes, metadata and types of the bag; stamps, steps and verdict of each run in it;
and optionally the camera frames against re-rendered ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taxinet_ros.bag.cdr.decode import definition_hash
from taxinet_ros.bag.check.findings import RECOVER, Check, Finding
from taxinet_ros.bag.check.lockstep import (
    RunRecord,
    check_stamps,
    check_steps,
    check_verdict,
    run_record,
    run_records,
)
from taxinet_ros.bag.description import VERSION, read_description, words_beside
from taxinet_ros.bag.errors import BagEmpty, BagError, BagTruncated
from taxinet_ros.bag.layout import METADATA_FILE, storage_files
from taxinet_ros.bag.reader import BagInfo
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.resimulation import WorldDiffers, recorded_world
from taxinet_ros.bag.run.topics import IMAGE
from taxinet_ros.bag.run.trace import Frame
from taxinet_ros.bag.topics import TopicInfo, qos_profiles
from taxinet_ros.bag.writer import RUN_METADATA
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import load_yaml


def check_bytes(info: BagInfo, damage: Sequence[BagError]) -> Check:
    """Check that all checksums are valid and the file is complete."""
    count = sum(info.counts.values())
    return Check(
        name='bytes', looked_at=f'{count} messages; {info.unchecked}' if info.unchecked else
        f'{count} messages under the checksums of chunks, data and summary',
        findings=tuple(
            Finding(where=_place(error), what=_without_place(error), mend=RECOVER)
            for error in damage
        ),
    )


def check_description(info: BagInfo) -> Check:
    """Check ``metadata.yaml`` against the storage files."""
    if info.path.is_file():
        why = f'a single file has no {METADATA_FILE}'
        return Check(name='description', looked_at=why, skipped=True)
    try:
        description = read_description(info.path)
    except BagError as error:
        missing = 'missing, so the recording was not finished'
        what = missing if isinstance(error, BagTruncated) else _without_path(error)
        found = (Finding(where=METADATA_FILE, what=what, mend=RECOVER),)
        return Check(name='description', looked_at=METADATA_FILE, findings=found)
    wrong = [
        Finding(where=METADATA_FILE, what=what, mend=RECOVER)
        for what in _contradictions(info, description)
    ]
    return Check(
        name='description', looked_at=f'{METADATA_FILE} matches the file',
        findings=tuple(wrong),
    )


def check_types(info: BagInfo) -> Check:
    """Check that definitions are usable and match their type hashes, and QoS profiles are valid."""
    found = [
        Finding(where=topic.name, what=what)
        for topic in info.topics for what in _topic_troubles(topic)
    ]
    return Check(
        name='types', looked_at=f'definition, type hash and QoS of {len(info.topics)} topics',
        findings=tuple(found),
    )


def _topic_troubles(topic: TopicInfo) -> Iterator[str]:
    try:
        found = definition_hash(topic)
        if topic.type_hash and topic.type_hash != found:
            yield f'type hash {topic.type_hash} is not that of the definition, {found}'
    except BagError as error:
        yield str(error)
    try:
        qos_profiles(topic.qos)
    except ValueError as error:
        yield f'QoS: {error}'


def _contradictions(info: BagInfo, told: Mapping[str, Any]) -> Iterator[str]:
    version = told.get('version')
    if not isinstance(version, int) or not 0 < version <= VERSION:
        yield f'version is {_short(version)}; known up to {VERSION}'
    files = [file.name for file in storage_files(info.path)]
    # rosbag2 unpacks a compressed file next to it, but metadata.yaml still names the original.
    packed = [f'{name}.zstd' for name in files]
    there: dict[str, object] = {
        'storage_identifier': 'mcap',
        'message_count': sum(info.counts.values()),
        'relative_file_paths': packed if told.get('relative_file_paths') == packed else files,
        'duration': {'nanoseconds': info.end_ns - info.start_ns},
    }
    if any(info.counts.values()):
        there['starting_time'] = {'nanoseconds_since_epoch': info.start_ns}
    for key, value in there.items():
        if told.get(key) != value:
            yield f'{key} is {_short(told.get(key))}, in the bag {_short(value)}'
    yield from _topic_contradictions(info, told.get('topics_with_message_count'))
    words = info.metadata.get(RUN_METADATA)
    if words is not None and _inner(info) != _without(told, words_beside(info.path, words)):
        yield 'differs from the description within the file'


def _without(told: Mapping[str, Any], beside: Mapping[str, str]) -> dict[str, Any]:
    """The metadata without the entries that are only in ``metadata.yaml``."""
    custom = told.get('custom_data')
    if not isinstance(custom, Mapping):
        return dict(told)
    return {**told, 'custom_data': {k: v for k, v in custom.items() if k not in beside}}


def _topic_contradictions(info: BagInfo, told: object) -> Iterator[str]:
    try:
        claimed = {str(entry['topic_metadata']['name']): entry for entry in _list(told)}
    except (TypeError, KeyError, AttributeError):
        yield 'topics_with_message_count is not a list of topics'
        return
    for topic in info.topics:
        entry = claimed.pop(topic.name, None)
        if entry is None:
            yield f'lacks topic {topic.name}'
            continue
        told_of, there = entry['topic_metadata'], _topic_fields(topic)
        wrong = [key for key, value in there.items() if told_of.get(key, value) != value]
        if entry.get('message_count') != info.counts[topic.name]:
            wrong.append('message_count')
        if wrong:
            yield f'topic {topic.name}: {", ".join(wrong)} differ from the bag'
    for name, entry in claimed.items():
        if entry.get('message_count') != 0:  # rosbag2's file omits topics without messages.
            yield f'lists topic {_short(name)}, which is not in the bag'


def _topic_fields(topic: TopicInfo) -> dict[str, object]:
    fields: dict[str, object] = {'name': topic.name, 'type': topic.type}
    if topic.type_hash:
        fields['type_description_hash'] = topic.type_hash
    with suppress(ValueError):
        # rosbags and rosbag2 match topics by QoS: with a difference they find no messages.
        fields['offered_qos_profiles'] = list(qos_profiles(topic.qos))
    return fields


def _inner(info: BagInfo) -> object:
    """Metadata in the storage file, or None if missing or invalid."""
    try:
        return load_yaml(info.metadata['rosbag2']['serialized_metadata'])
    except (KeyError, ValueError):
        return None


def _list(value: object) -> list[Any]:
    if not isinstance(value, list):
        raise TypeError(f'{value!r} is no list')
    return value


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f'{text[:57]}...'


def _place(error: BagError) -> str:
    file = error.path.name if error.path is not None else ''
    return f'{file}, byte {error.offset}' if error.offset >= 0 else file


def _without_path(error: BagError) -> str:
    return str(error).removeprefix(f'{error.path}: ')


def _without_place(error: BagError) -> str:
    return _without_path(error).removeprefix(f'at byte {error.offset}: ')


@dataclass(frozen=True, kw_only=True)
class FrameComparison:
    """Comparison of recorded frames with re-rendered ones.

    Attributes:
        recorded: number of frames in the bag.
        equal: number of byte-identical frames.
        first_seq: control step of the first different frame, or None.
        first_pixels: number of different pixels in it.
        first_difference: maximum difference of a colour value in it, 0..255.
        trouble: why frames could not be rendered, or ''.
    """

    recorded: int
    equal: int
    first_seq: int | None = None
    first_pixels: int = 0
    first_difference: int = 0
    trouble: str = ''

    @property
    def ok(self) -> bool:
        """Whether all recorded frames are equal to re-rendered ones."""
        return self.equal == self.recorded and not self.trouble


def check_recorded_frames(recording: Recording) -> Check:
    """Check the recorded frames of a bag; see :func:`compare_recorded_frames`."""
    try:
        again = recorded_world(recording.path, recording.run).again_words
        if again:
            return Check(name='frames', looked_at=f'not compared: {again}', skipped=True)
        found = compare_recorded_frames(recording)
    except (BagError, UsageError) as error:
        return Check(name='frames', looked_at=f'not compared: {error}', skipped=True)
    words = f'{found.equal} of {found.recorded} equal re-rendered ones'
    if not found.recorded:
        return Check(name='frames', looked_at='no frames to compare', skipped=True)
    if found.ok:
        return Check(name='frames', looked_at=f'{words}, bit for bit')
    finding = Finding(where=f'/{IMAGE}', what=found.trouble)
    if found.first_seq is not None:
        finding = Finding(
            where=f'step {found.first_seq}',
            what=f'the first different frame: {found.first_pixels} pixels differ, by up to '
            f'{found.first_difference} of 255',
        )
    return Check(name='frames', looked_at=words, findings=(finding,))


def compare_recorded_frames(recording: Recording) -> FrameComparison:
    """Re-render all recorded frames of a bag and compare them.

    Raises:
        BagError, UsageError: the bag cannot be read.
    """
    recorded = equal = 0
    first: dict[str, int] = {}
    trouble = ''
    states = recording.observations()
    for frame in recording.frames(render=False):
        recorded += 1
        seq, image = frame.seq, frame.image
        try:
            now = None if trouble else next((s.image for s in states if s.seq == seq), None)
        except WorldDiffers as error:
            trouble, now = str(error), None
        if now is None:
            trouble = trouble or f'step {seq} has a frame but no recorded state'
        elif now.shape == image.shape and now.tobytes() == image.tobytes():
            equal += 1
        elif not first:
            first = _difference(seq, image, now)
    return FrameComparison(recorded=recorded, equal=equal, trouble=trouble, **first)


def _difference(seq: int, recorded: Frame, rendered: Frame) -> dict[str, int]:
    if recorded.shape != rendered.shape:
        return {'first_seq': seq, 'first_pixels': rendered[..., 0].size, 'first_difference': 255}
    away = np.abs(recorded.astype(np.int16) - rendered.astype(np.int16)).max(axis=2)
    return {
        'first_seq': seq, 'first_pixels': int(np.count_nonzero(away)),
        'first_difference': int(away.max()),
    }


@dataclass(frozen=True, kw_only=True)
class Checkup:
    """Results of all checks of a bag.

    Attributes:
        info: its table of contents.
        checks: checks in order of execution.
    """

    info: BagInfo
    checks: tuple[Check, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of all checks."""
        return tuple(finding for check in self.checks for finding in check.findings)


def check_bag(path: Path) -> Checkup:
    """Check a bag without modifying it.

    Raises:
        BagEmpty: the bag is damaged and no message can be read.
        BagForeign, UsageError: as ``reader.read_messages``.
    """
    recording = open_recording(path)
    info, damage = recording.info, recording.damaged_places
    if damage and not any(info.counts.values()):
        raise BagEmpty(str(damage[0]), path=path)
    return Checkup(
        info=info,
        checks=(
            check_bytes(info, damage),
            check_description(info),
            check_types(info),
            *_run_checks(recording),
        ),
    )


def _run_checks(recording: Recording) -> Iterator[Check]:
    if recording.plain or not recording.runs:
        topics = [topic.name for topic in recording.topics]
        yield from _checks_of(recording, run_record(recording), topics, '')
        return
    yield Check(
        name='messages', looked_at="every message matches its topic's type",
        findings=tuple(
            Finding(where=recording.path.name, what=str(error)) for error in recording.broken
        ),
    )
    # Topics that do not belong to a run are not checked.
    records = run_records(recording)
    for run, one, record in zip(recording.runs, recording, records, strict=True):
        if not run.absent:
            yield from _checks_of(one, record, list(record.counts), f'{run.name}: ')


def _checks_of(
    recording: Recording, record: RunRecord, topics: Sequence[str], of: str
) -> Iterator[Check]:
    for check in (
        check_stamps(record), check_steps(record, topics), check_verdict(record, recording)
    ):
        yield replace(check, looked_at=f'{of}{check.looked_at}')
