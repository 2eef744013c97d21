"""All checks of a bag from any recorder.

Checks bytes, metadata and types of the bag; stamps, steps and verdict of each run in it;
and optionally the camera frames against re-rendered ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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


def check_description(info: BagInfo, *, sound: bool) -> Check:
    """Check ``metadata.yaml`` against the storage files; ``sound``: whether these are intact."""
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
        for what in _contradictions(info, description, sound=sound)
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


def _contradictions(info: BagInfo, told: Mapping[str, Any], *, sound: bool) -> Iterator[str]:
    version = told.get('version')
    if not isinstance(version, int) or not 0 < version <= VERSION:
        yield f'version is {_short(version)}; known up to {VERSION}'
    files = [file.name for file in storage_files(info.path)]
    # rosbag2 unpacks a compressed file next to it, but metadata.yaml still names the original.
    if told.get('relative_file_paths') not in (files, [f'{name}.zstd' for name in files]):
        yield f'relative_file_paths is {_short(told.get("relative_file_paths"))}, not {files}'
    count = sum(info.counts.values())
    if told.get('message_count') != count:
        yield f'message_count is {_short(told.get("message_count"))}, in the bag {count}'
    words = info.metadata.get(RUN_METADATA)
    if words is not None and sound:
        beside = words_beside(info.path, words)
        inner = _inner(info)
        for key in dict.fromkeys([*inner, *told]):
            value = told.get(key)
            if key == 'custom_data' and isinstance(value, Mapping):
                value = {name: text for name, text in value.items() if name not in beside}
            if value != inner.get(key):
                yield f'{_short(key)} differs from the description within the file'


def _inner(info: BagInfo) -> Mapping[str, Any]:
    """Copy of the metadata in the storage file; empty if missing or invalid."""
    try:
        return dict(load_yaml(info.metadata['rosbag2']['serialized_metadata']))
    except (KeyError, ValueError, TypeError):
        return {}


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


def check_recorded_frames(recording: Recording) -> Check:
    """Render the recorded frames of a bag again and compare every byte."""
    try:
        again = recorded_world(recording.path, recording.run).again_words
        if again:
            return Check(name='frames', looked_at=f'not compared: {again}', skipped=True)
        return _compared_frames(recording)
    except (BagError, UsageError) as error:
        return Check(name='frames', looked_at=f'not compared: {error}', skipped=True)


def _compared_frames(recording: Recording) -> Check:
    recorded = equal = 0
    lost, findings = '', list[Finding]()
    states = recording.observations()
    for frame in recording.frames(render=False):
        recorded += 1
        try:
            here = () if lost else (one.image for one in states if one.seq == frame.seq)
            now = next(iter(here), None)
        except WorldDiffers as error:
            lost, now = str(error), None
        if now is None:
            lost = lost or f'step {frame.seq} has a frame but no recorded state'
        elif now.shape == frame.image.shape and now.tobytes() == frame.image.tobytes():
            equal += 1
        elif not findings:
            what = f'the first different frame: {_difference(frame.image, now)}'
            findings.append(Finding(where=f'step {frame.seq}', what=what))
    if not recorded:
        return Check(name='frames', looked_at='no frames to compare', skipped=True)
    if lost:
        findings.append(Finding(where=f'/{IMAGE}', what=lost))
    return Check(
        name='frames', findings=tuple(findings), looked_at=f'{equal} of {recorded} equal '
        f're-rendered ones{"" if findings else ", bit for bit"}',
    )


def _difference(recorded: Frame, rendered: Frame) -> str:
    if recorded.shape != rendered.shape:
        return f'its shape is {recorded.shape}, re-rendered {rendered.shape}'
    away = np.abs(recorded.astype(np.int16) - rendered.astype(np.int16)).max(axis=2)
    return f'{np.count_nonzero(away)} pixels differ, by up to {away.max()} of 255'


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
            check_description(info, sound=not damage),
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
