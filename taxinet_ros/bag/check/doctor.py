"""All checks of a bag from any recorder.

Its bytes, its structure (``metadata.yaml`` and types), the lockstep and the verdict of each run in
it. ``taxinet run --from`` compares frames, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from taxinet_ros.bag.cdr.decode import definition_hash
from taxinet_ros.bag.check.findings import RECOVER, RERUN, Check, Finding
from taxinet_ros.bag.check.lockstep import check_run, checked_runs
from taxinet_ros.bag.description import VERSION, read_description
from taxinet_ros.bag.errors import BagEmpty, BagError
from taxinet_ros.bag.layout import METADATA_FILE, storage_files
from taxinet_ros.bag.reader import BagInfo
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.runs import is_run_topic
from taxinet_ros.bag.topics import TopicInfo, qos_profiles
from taxinet_ros.bag.writer import RUN_METADATA
from taxinet_ros.files.plain_values import load_yaml


def _check_bytes(info: BagInfo) -> Check:
    """Check that all checksums are valid and the file is complete."""
    return Check(
        name='bytes', looked_at=f'{info.count} messages; {info.unchecked}' if info.unchecked else
        f'{info.count} messages under the checksums of chunks, data and summary',
        findings=tuple(
            Finding(where=_place(error), what=_without_place(error), fix=RECOVER)
            for error in info.damage
        ),
    )


def _place(error: BagError) -> str:
    file = error.path.name if error.path is not None else ''
    return f'{file}, byte {error.offset}' if error.offset >= 0 else file


def _without_place(error: BagError) -> str:
    return str(error).removeprefix(f'{error.path}: ').removeprefix(f'at byte {error.offset}: ')


def _check_structure(recording: Recording) -> Check:
    """Check ``metadata.yaml``, the definitions of all topics, and that messages match them."""
    info, others = recording.info, list[str]()
    described = info.path.is_dir() and not info.damage
    found = [*_description_troubles(info)] if described else []
    for topic in info.topics:
        found += _topic_troubles(topic, others)
    if not recording.plain:  # A message that cannot be decoded belongs to no run.
        found += [Finding(where=info.path.name, what=str(error), fix=RERUN)
                  for error in recording.damage[len(info.damage):]]
    what = f'{METADATA_FILE}, definitions' if described else 'definitions'
    return Check(
        name='structure', looked_at=f'{what} and type hashes of {len(info.topics)} topics'
        + (f'; not checked: {", ".join(others)}' if others else ''), findings=tuple(found),
    )


def _topic_troubles(topic: TopicInfo, others: list[str]) -> Iterator[Finding]:
    """Findings on a topic; one that is not of a run may have any form, and is added to others."""
    try:
        found = definition_hash(topic)
        if topic.type_hash and topic.type_hash != found:
            what = f'type hash {topic.type_hash} is not that of the definition, {found}'
            yield Finding(where=topic.name, what=what, fix=RERUN)
        if topic.qos:
            qos_profiles(topic.qos)
    except BagError as error:
        if topic.encoding == 'cdr' and is_run_topic(topic.name):
            yield Finding(where=topic.name, what=str(error), fix=RERUN)
        else:
            others.append(f'{topic.name} ({topic.type or topic.encoding})')
    except ValueError as error:
        yield Finding(where=topic.name, what=f'QoS: {error}', fix=RECOVER)


def _description_troubles(info: BagInfo) -> Iterator[Finding]:
    """Contradictions between ``metadata.yaml`` and the storage files, which are intact."""
    try:
        told = read_description(info.path)
        for what in _contradictions(info, told):
            yield Finding(where=METADATA_FILE, what=what, fix=RECOVER)
    except BagError as error:
        what = str(error).removeprefix(f'{error.path}: ')
        yield Finding(where=METADATA_FILE, what=what, fix=RECOVER)


def _contradictions(info: BagInfo, told: Mapping[str, Any]) -> Iterator[str]:
    version = told.get('version')
    if not isinstance(version, int) or not 0 < version <= VERSION:
        yield f'version is {_short(version)}; known up to {VERSION}'
    files = [file.name for file in storage_files(info.path)]
    # rosbag2 unpacks a compressed file next to it, but metadata.yaml still names the original.
    if told.get('relative_file_paths') not in (files, [f'{name}.zstd' for name in files]):
        yield f'relative_file_paths is {_short(told.get("relative_file_paths"))}, not {files}'
    if told.get('message_count') != info.count:
        yield f'message_count is {_short(told.get("message_count"))}, in the bag {info.count}'
    if RUN_METADATA in info.metadata:
        inner = _inner(info)
        for key in dict.fromkeys([*inner, *told]):
            if _comparable(key, told.get(key), inner) != _comparable(key, inner.get(key), inner):
                yield f'{_short(key)} differs from the description within the file'


def _inner(info: BagInfo) -> Mapping[str, Any]:
    """Copy of the metadata in the storage file; empty if missing or invalid."""
    try:
        return dict(load_yaml(info.metadata['rosbag2']['serialized_metadata']))
    except (KeyError, ValueError, TypeError):
        return {}


def _comparable(key: str, value: Any, inner: Mapping[str, Any]) -> Any:
    """A value of a description without what may differ: names of files, words of one side only."""
    if key == 'relative_file_paths':
        return None
    if key == 'files' and isinstance(value, list):
        return [{**one, 'path': ''} if isinstance(one, dict) else one for one in value]
    if key == 'custom_data' and isinstance(value, Mapping):  # ros2 bag reindex leaves it empty
        known = inner.get(key) or {}
        return {name: (value or known).get(name) for name in known}
    return value


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f'{text[:57]}...'


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
    info = recording.info
    if info.damage and not info.count:
        raise BagEmpty(str(info.damage[0]), path=path)
    runs = chain.from_iterable(map(check_run, checked_runs(recording)))
    return Checkup(info=info, checks=(_check_bytes(info), _check_structure(recording), *runs))
