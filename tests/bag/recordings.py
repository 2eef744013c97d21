"""Recordings of several runs as ``ros2 bag record`` makes them, by the library ``rosbags``.

Every message is logged by the wall clock, or by a simulated time that begins anew; beside our
topics are those of others, some of them silent; there are no attachments and no words of ours.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import yaml
from bag_samples import make, serialise, store
from rosbags.rosbag2 import StoragePlugin, Writer

from taxinet_ros.bag.reader import stored_messages
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo

BEGUN_NS = 1_700_000_000_000_000_000
SILENT = {'/events/write_split': 'std_msgs/msg/String', '/parameter_events': 'std_msgs/msg/String'}
"""Topics of others on which nothing is said."""


class Logged(NamedTuple):
    """A message as it comes to a recorder: its topic, and when it is logged [ns]."""

    topic: TopicInfo
    stamp_ns: int
    cdr: bytes


def heard(
    bags: Sequence[Path], *, keep: Callable[[StoredMessage], bool] = lambda message: True,
    sim_time: bool = False,
) -> list[Logged]:
    """What a recorder hears that is there while the runs of some bags are made one after another.

    Args:
        bags: of our recorder.
        keep: which messages the recorder gets.
        sim_time: logged by the newest clock, not by the wall clock.
    """
    found: list[Logged] = []
    wall_ns, sim_ns = BEGUN_NS, 0
    for bag in bags:
        messages = list(stored_messages(bag))
        status = next(m.topic for m in messages if m.topic.name == '/run_status')
        under_way = make('taxinet_msgs/msg/RunStatus', run_id=bag.name, state=1)
        found.append(Logged(status, sim_ns if sim_time else wall_ns, serialise(under_way)))
        for stored in filter(keep, messages):
            wall_ns += 3_000_000
            if stored.topic.name == '/clock':
                sim_ns = stored.stamp_ns
            found.append(Logged(stored.topic, sim_ns if sim_time else wall_ns, stored.cdr))
        wall_ns += 5_000_000_000
    return found


def record(
    folder: Path, messages: Iterable[Logged], *, files: int = 1, namespace: str = '',
) -> Path:
    """Write a recording, in as many files as ``--max-bag-size`` would have made."""
    logged = list(messages)
    if files == 1:
        _write(folder, logged, namespace)
        return folder
    folder.mkdir()
    descriptions = []
    size = -(-len(logged) // files)
    for number, first in enumerate(range(0, len(logged), size)):
        part = logged[first:first + size]
        draft = folder.with_name(f'{folder.name}-{number}')
        _write(draft, part, namespace)
        name = f'{folder.name}_{number}.mcap'
        shutil.move(next(draft.glob('*.mcap')), folder / name)
        values = yaml.safe_load((draft / 'metadata.yaml').read_text())
        descriptions.append(values['rosbag2_bagfile_information'])
        shutil.rmtree(draft)
    whole = {
        **descriptions[0], 'message_count': sum(one['message_count'] for one in descriptions),
        'relative_file_paths': sorted(file.name for file in folder.iterdir()),
    }
    (folder / 'metadata.yaml').write_text(
        yaml.safe_dump({'rosbag2_bagfile_information': whole}, sort_keys=False))
    return folder


def _write(folder: Path, logged: Sequence[Logged], namespace: str) -> None:
    types = store()
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    with writer:
        for name, kind in SILENT.items():
            writer.add_connection(name, kind, typestore=types)
        rosout = writer.add_connection('/rosout', 'std_msgs/msg/String', typestore=types)
        known = {}
        for topic, stamp_ns, cdr in logged:
            if topic.name not in known:
                known[topic.name] = writer.add_connection(
                    namespace + topic.name, topic.type, typestore=types,
                    msgdef=topic.definition, rihs01=topic.type_hash,
                )
                writer.write(rosout, stamp_ns, serialise(make('std_msgs/msg/String', data='hello')))
            writer.write(known[topic.name], stamp_ns, cdr)
