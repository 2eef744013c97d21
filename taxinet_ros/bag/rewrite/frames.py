"""Restore camera frames, bit for bit, in a bag recorded without them.

The camera is deterministic, so frames can be rendered from the recorded scenario and commands
(:mod:`taxinet_ros.bag.run.resimulation`). The resulting bag is byte-identical to one recorded with
frames.
"""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.cdr.image import image_cdr
from taxinet_ros.bag.errors import BagForeign, BagWriteError
from taxinet_ros.bag.layout import METADATA_FILE, mcap_path
from taxinet_ros.bag.reader import BagInfo
from taxinet_ros.bag.rewrite.copying import copy_of, written_steps
from taxinet_ros.bag.run import topics
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.resimulation import WorldDiffers
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo, describe_topic
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import sync_folder

IMAGE, CAMERA2, CAMERA_INFO = (
    f'/{name}' for name in (topics.IMAGE, topics.CAMERA2, topics.CAMERA_INFO))
_IMAGE_TYPE = 'sensor_msgs/msg/Image'
_DRAFT = '.with-frames'


def missing_frames(info: BagInfo) -> int:
    """Number of control steps of a bag without a camera frame."""
    if CAMERA_INFO not in info.counts:
        raise BagForeign(
            f'{info.path}: no topic {CAMERA_INFO}, so it is not a run of '
            'taxinet_ros', path=info.path
        )
    return info.counts[CAMERA_INFO] - info.counts.get(IMAGE, 0)


def frame_messages(
    recording: Recording, wanted: Collection[str] = (IMAGE,)
) -> Iterator[tuple[int, str, bytes]]:
    """Yield control step, topic and serialised message of each frame and of others.

    Args:
        recording: a run.
        wanted: topics in the bag; frames are recorded or, if missing, rendered.
    """
    frames = _Frames(recording)
    for message in recording.whole_messages({CAMERA_INFO, *wanted}.__contains__):
        seq, topic = message.stamp_ns // recording.period_ns, message.topic.name
        if topic == CAMERA_INFO:
            yield from ((seq, name, cdr) for name, cdr in frames.missing(message)
                        if name in wanted)
        if topic in wanted:
            yield seq, topic, message.cdr


def restore_frames(recording: Recording, folder: Path, min_free_bytes: int = 0) -> Iterator[int]:
    """Write the run to the new run ``folder`` with a frame in every control step.

    Recorded frames are kept, missing ones are rendered; under the same name the bag is
    byte-identical to a recording. A generator, so that a node can interleave other work: it yields
    the number of each completed control step.

    Raises:
        UsageError: the bag is damaged, or ``folder`` exists or has too little space.
        WorldDiffers: the frames cannot be reproduced.
        BagError: the bag cannot be read or written.
    """
    source, info = recording.path, recording.info
    missing_frames(info)
    if info.trouble:
        raise UsageError(f'{info.trouble}; repair it first: taxinet bag recover {source} --out NEW')
    try:
        topics = _topics(recording)
        with copy_of(info, folder, topics, min_free_bytes) as bag:
            for stamp_ns in written_steps(bag, _with_frames(recording, topics)):
                yield stamp_ns // recording.period_ns
    except WorldDiffers:
        shutil.rmtree(folder)  # It would look like an unfinished recording.
        raise


def restore_in_place(folder: Path, min_free_bytes: int = 0) -> Iterator[int]:
    """Like :func:`restore_frames`, but replaces the old bag by the new one.

    At any time, the storage file is completely the old or the new one. ``metadata.yaml`` is missing
    only between the last three system calls; a bag interrupted then can be recovered.
    """
    if not folder.is_dir():
        raise UsageError(f'{folder}: is not a run folder; name one, or a new folder as out')
    draft = folder / _DRAFT / folder.name
    shutil.rmtree(draft.parent, ignore_errors=True)
    try:
        yield from restore_frames(open_recording(folder), draft, min_free_bytes)
        (folder / METADATA_FILE).unlink()
        mcap_path(draft).replace(mcap_path(folder))
        (draft / METADATA_FILE).replace(folder / METADATA_FILE)
        sync_folder(folder)
    except OSError as error:
        raise BagWriteError(f'{folder}: {error}', path=folder, errno=error.errno or 0) from error
    finally:
        shutil.rmtree(draft.parent, ignore_errors=True)


class _Frames:
    """Renders the missing frames of a bag, in the order of its control steps."""

    def __init__(self, recording: Recording) -> None:
        self.recorded = recording.recorded_steps
        self._period_ns = recording.period_ns
        self._states = recording.observations(lambda seq: seq not in self.recorded)

    def missing(self, camera_info: StoredMessage) -> Iterator[tuple[str, bytes]]:
        """Topic and frame with this camera info, also the second camera's; none if recorded.

        A failed run may have a step without the aircraft's state.
        """
        seq = camera_info.stamp_ns // self._period_ns
        if seq in self.recorded:
            return
        for now in self._states:
            if now.seq == seq and now.image is not None:
                header = decode(camera_info.topic, camera_info.cdr).header
                yield IMAGE, image_cdr(now.image, now.stamp_ns, header.frame_id)
                for one in now.measured.camera if now.measured is not None else ():
                    yield CAMERA2, image_cdr(one.image, one.stamp_ns, topics.CAMERA2_FRAME)
                return


def _topics(recording: Recording) -> list[TopicInfo]:
    """Topics of a bag including images, inserted before camera info with the same QoS."""
    info = recording.info
    topics = list(info.topics)
    second = len(recording.run.request.scenario.cameras) > 1
    for name in (IMAGE, *((CAMERA2,) if second else ())):
        if name not in info.counts:
            place = [topic.name for topic in topics].index(CAMERA_INFO)
            image = describe_topic(name=name, type_name=_IMAGE_TYPE, qos=topics[place].qos)
            topics.insert(place, image)
    return topics


def _with_frames(recording: Recording, topics: Sequence[TopicInfo]) -> Iterator[StoredMessage]:
    """All messages, with each frame before its camera info."""
    frames, named = _Frames(recording), {topic.name: topic for topic in topics}
    for message in recording.all_messages():
        if message.topic.name == CAMERA_INFO:
            for name, cdr in frames.missing(message):
                yield message._replace(topic=named[name], cdr=cdr)
        yield message
