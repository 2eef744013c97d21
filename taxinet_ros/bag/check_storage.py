"""Checks of a bag as a bag, whoever recorded it: bytes, indexes, description, types."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from taxinet_ros.bag.decode import definition_hash
from taxinet_ros.bag.description import read_description, words_beside
from taxinet_ros.bag.errors import BagError, BagTruncated
from taxinet_ros.bag.findings import RECOVER, Check, Finding
from taxinet_ros.bag.index import index_troubles
from taxinet_ros.bag.layout import METADATA_FILE, storage_files
from taxinet_ros.bag.metadata import VERSION
from taxinet_ros.bag.reader import BagInfo
from taxinet_ros.bag.topics import TopicInfo, qos_profiles
from taxinet_ros.bag.writer import RUN_METADATA
from taxinet_ros.bag.yaml_text import load_yaml


def check_bytes(info: BagInfo, damage: Sequence[BagError]) -> Check:
    """Whether every checksum holds and the file has its end."""
    count = sum(info.counts.values())
    return Check(
        name='bytes', looked_at=f'{count} messages; {info.unchecked}' if info.unchecked else
        f'{count} messages under the checksums of chunks, data and summary',
        findings=tuple(
            Finding(where=_place(error), what=_without_place(error), mend=RECOVER)
            for error in damage
        ),
    )


def check_index(path: Path, *, sound: bool) -> Check:
    """Whether the indexes lead to every message; only asked where the bytes are sound."""
    if not sound:
        return Check(name='index', looked_at='the bytes are not sound', skipped=True)
    files = storage_files(path)
    found: list[Finding] = []
    for file in files:
        try:
            troubles = index_troubles(file)
        except BagError as error:
            found.append(Finding(where=file.name, what=str(error), mend=RECOVER))
            continue
        found += [
            Finding(where=f'{file.name}, byte {offset}', what=what, mend=RECOVER)
            for offset, what in troubles
        ]
    return Check(
        name='index', looked_at='chunks, messages, attachments and counts are where it says',
        findings=tuple(found),
    )


def check_description(info: BagInfo) -> Check:
    """Whether ``metadata.yaml`` says what the storage files hold."""
    if info.path.is_file():
        why = f'a file without its folder has no {METADATA_FILE}'
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
        name='description', looked_at=f'{METADATA_FILE} says what the file holds',
        findings=tuple(wrong),
    )


def check_topics(info: BagInfo) -> Check:
    """Whether definitions can be used, hash to the type hashes, and QoS profiles can be read."""
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
    there: dict[str, object] = {
        'storage_identifier': 'mcap',
        'message_count': sum(info.counts.values()),
        'relative_file_paths': [file.name for file in storage_files(info.path)],
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
        yield 'is not the same as the description within the file'


def _without(told: Mapping[str, Any], beside: Mapping[str, str]) -> dict[str, Any]:
    """The description without the words that stand in it alone."""
    custom = told.get('custom_data')
    if not isinstance(custom, Mapping):
        return dict(told)
    return {**told, 'custom_data': {k: v for k, v in custom.items() if k not in beside}}


def _topic_contradictions(info: BagInfo, told: object) -> Iterator[str]:
    try:
        claimed = {str(entry['topic_metadata']['name']): entry for entry in _list(told)}
    except (TypeError, KeyError, AttributeError):
        yield 'topics_with_message_count is no list of topics'
        return
    for topic in info.topics:
        entry = claimed.pop(topic.name, None)
        if entry is None:
            yield f'does not know topic {topic.name}'
            continue
        told_of, there = entry['topic_metadata'], _topic_fields(topic)
        wrong = [key for key, value in there.items() if told_of.get(key, value) != value]
        if entry.get('message_count') != info.counts[topic.name]:
            wrong.append('message_count')
        if wrong:
            yield f'topic {topic.name}: {", ".join(wrong)} not as in the bag'
    for name in claimed:
        yield f'tells of topic {_short(name)}, which is not in the bag'


def _topic_fields(topic: TopicInfo) -> dict[str, object]:
    fields: dict[str, object] = {'name': topic.name, 'type': topic.type}
    if topic.type_hash:
        fields['type_description_hash'] = topic.type_hash
    with suppress(ValueError):
        # rosbags and rosbag2 pair the two by them: a topic that differs here yields no messages.
        fields['offered_qos_profiles'] = list(qos_profiles(topic.qos))
    return fields


def _inner(info: BagInfo) -> object:
    """The description within the storage file, or None where there is none of use."""
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
