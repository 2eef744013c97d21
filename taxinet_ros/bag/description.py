"""rosbag2's bag metadata, stored in ``metadata.yaml`` and in the storage file; version 9 (Jazzy).

Fields and their order are those of rosbag2_storage's ``BagMetadata``; ``ros2 bag info`` needs
all of them. The content of ``metadata.yaml`` is treated as untrusted.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from taxinet_ros.bag.errors import BagCorrupt, BagError, BagTruncated
from taxinet_ros.bag.layout import METADATA_FILE, STORAGE_ID
from taxinet_ros.bag.topics import TopicInfo, qos_profiles
from taxinet_ros.core.provenance import known
from taxinet_ros.files.plain_values import MAX_CHARS, dump_yaml, load_yaml

VERSION = 9
ROS_DISTRO = 'jazzy'
NOT_STARTED_NS = 2**63 - 1
"""Start time that rosbag2 writes for a bag without messages."""


@dataclass(frozen=True, kw_only=True)
class BagContent:
    """Content of a bag, as far as its metadata describes it.

    Attributes:
        file: name of the storage file.
        start_ns: stamp of the first message [ns of simulated time].
        duration_ns: last stamp minus first stamp [ns].
        topics: every topic with its number of messages.
        custom: metadata of the run, such as scenario, seed and version.
    """

    file: str
    start_ns: int
    duration_ns: int
    topics: Sequence[tuple[TopicInfo, int]]
    custom: Mapping[str, str]


def record_text(content: BagContent) -> str:
    """YAML for the ``serialized_metadata`` record in the storage file."""
    # Topics are most of it and equal in all bags of a campaign; dumping takes ms, so it is cached.
    topics = [f'{_topic_text(topic)}  message_count: {count}\n' for topic, count in content.topics]
    listed = '\n' + ''.join(topics) if topics else ' []\n'
    before, after = dump_yaml(_before(content)), dump_yaml(_after(content))
    return f'{before}topics_with_message_count:{listed}{after}'


def file_text(record: str) -> str:
    """YAML of ``metadata.yaml`` with the same content as the given :func:`record_text`."""
    return 'rosbag2_bagfile_information:\n' + textwrap.indent(record, '  ')


def _before(content: BagContent) -> dict[str, Any]:
    return {
        'version': VERSION,
        'storage_identifier': STORAGE_ID,
        **_times(content),
        'message_count': _total(content),
    }


def _after(content: BagContent) -> dict[str, Any]:
    times = _times(content)
    return {
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [content.file],
        'files': [
            {
                'path': content.file,
                'starting_time': times['starting_time'],
                'duration': times['duration'],
                'message_count': _total(content),
            }
        ],
        'custom_data': dict(content.custom),
        'ros_distro': ROS_DISTRO,
    }


def _times(content: BagContent) -> dict[str, Any]:
    return {
        'duration': {'nanoseconds': content.duration_ns},
        'starting_time': {'nanoseconds_since_epoch': content.start_ns},
    }


def _total(content: BagContent) -> int:
    return sum(count for _, count in content.topics)


@lru_cache(maxsize=64)
def _topic_text(topic: TopicInfo) -> str:
    """YAML list item of a topic, without its last line."""
    return dump_yaml([{
        'topic_metadata': {
            'name': topic.name,
            'type': topic.type,
            'serialization_format': 'cdr',
            # Same text as in the channel: readers match the two by equal profiles.
            'offered_qos_profiles': list(qos_profiles(topic.qos)),
            'type_description_hash': topic.type_hash,
        },
    }])


_ROOT = 'rosbag2_bagfile_information'


def words_beside(path: Path, words: Mapping[str, str]) -> dict[str, str]:
    """Metadata of a run that is only in ``metadata.yaml``, such as the commit.

    Args:
        path: a run folder; empty for an ``.mcap`` file.
        words: metadata in the storage file.
    """
    try:
        custom = read_description(path).get('custom_data') if path.is_dir() else None
    except BagError:
        return {}
    return {name: value for name, value in known(custom).items() if name not in words}


def read_description(folder: Path) -> Mapping[str, Any]:
    """Read ``metadata.yaml`` in ``folder``; the values include ``message_count``.

    Raises:
        BagTruncated: no such file, which a recorder writes last.
        BagCorrupt: invalid bag metadata.
    """
    file = folder / METADATA_FILE
    if not file.is_file():
        text = f'{folder}: no {METADATA_FILE}, which a recorder writes last'
        raise BagTruncated(text, path=folder)
    try:
        with file.open(encoding='utf-8') as stream:
            values = load_yaml(stream.read(MAX_CHARS + 1))[_ROOT]
        values['message_count']
    except (OSError, ValueError, KeyError, TypeError) as error:
        kind = type(error).__name__
        raise BagCorrupt(f'{file}: not a bag description: {kind}', path=file) from error
    return dict(values)
