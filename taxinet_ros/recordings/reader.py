"""Read any rosbag2: MCAP or sqlite3, split, compressed by file or by message.

Bags as our recorder writes them go through :mod:`taxinet_ros.bag`, which compares checksums and
reads up to the first damage; the others through the library ``rosbags``.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader, ReaderError

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.errors import BagCorrupt, BagError, BagForeign, BagTruncated
from taxinet_ros.bag.reader import stored_messages
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo, message_definition
from taxinet_ros.core.perception.network import decode_picture
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError

IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
FIX, IMU = 'sensor_msgs/msg/NavSatFix', 'sensor_msgs/msg/Imu'
ODOMETRY, POSE = 'nav_msgs/msg/Odometry', 'geometry_msgs/msg/PoseStamped'
TRANSFORMS, CAMERA_INFO = 'tf2_msgs/msg/TFMessage', 'sensor_msgs/msg/CameraInfo'
SCENARIO, TRACKING_ERROR = 'taxinet_msgs/msg/Scenario', 'taxinet_msgs/msg/TrackingError'
IMAGES = IMAGE, COMPRESSED
TRUTHS = FIX, ODOMETRY, POSE, TRANSFORMS
HEADINGS = IMU, ODOMETRY, POSE

_DAMAGE = (ReaderError, OSError, sqlite3.Error, ValueError, LookupError, zlib.error, EOFError)
_NAMED = 3
_CHANNELS = {
    'rgb8': 3, 'bgr8': 3, 'rgba8': 4, 'bgra8': 4, 'mono8': 1, '8UC1': 1, '8UC3': 3,
    'bayer_rggb8': 1, 'bayer_bggr8': 1, 'bayer_gbrg8': 1, 'bayer_grbg8': 1,
    'yuv422': 2, 'uyvy': 2, 'yuv422_yuy2': 2, 'yuyv': 2,
}
_TO_RGB = {
    'bgr8': cv2.COLOR_BGR2RGB, '8UC3': cv2.COLOR_BGR2RGB, 'rgba8': cv2.COLOR_RGBA2RGB,
    'bgra8': cv2.COLOR_BGRA2RGB, 'mono8': cv2.COLOR_GRAY2RGB, '8UC1': cv2.COLOR_GRAY2RGB,
    # OpenCV names a pattern by the second and third pixel of its second row.
    'bayer_rggb8': cv2.COLOR_BayerBG2RGB, 'bayer_bggr8': cv2.COLOR_BayerRG2RGB,
    'bayer_gbrg8': cv2.COLOR_BayerGR2RGB, 'bayer_grbg8': cv2.COLOR_BayerGB2RGB,
    'yuv422': cv2.COLOR_YUV2RGB_UYVY, 'uyvy': cv2.COLOR_YUV2RGB_UYVY,
    'yuv422_yuy2': cv2.COLOR_YUV2RGB_YUY2, 'yuyv': cv2.COLOR_YUV2RGB_YUY2,
}


class Recording:
    """A bag that is read as often as needed.

    Attributes:
        path: as given, or the only bag in that folder.
        counts: number of messages by topic.
        types: type by topic.
        note: one line about damage, up to which the bag is read, or ''.
    """

    def __init__(self, path: Path) -> None:
        """List the topics.

        Raises:
            UsageError: there is no such bag, or nothing in it can be read.
        """
        self.note = ''
        self.counts: Counter[str] = Counter()
        self.types: dict[str, str] = {}
        if not path.exists():
            raise UsageError(f'{path}: no such bag; name the folder of a rosbag2, or its file')
        if path.is_dir() and not _holds_bag(path) and (
                bags := [str(one) for one in sorted(path.glob('*/')) if _holds_bag(one)]):
            if len(bags) > 1:
                more = ' …' if len(bags) > _NAMED else ''
                raise UsageError(
                    f'{path}: is no recording, but a folder with {len(bags)}; name one or several '
                    f'of the same aircraft: {" ".join(bags[:_NAMED])}{more}')
            path = Path(bags[0])
        self.path = path
        self._foreign = _needs_rosbags(path)
        if self._foreign:
            self._list_foreign()
        else:
            for message in self.messages(lambda name: True):
                self._note(message.topic.name, message.topic.type, 1)
        if not self.counts:
            raise UsageError(f'{path}: {self.note or "there is no message in it"}')

    def messages(self, wanted: Callable[[str], bool]) -> Iterator[StoredMessage]:
        """Messages of the topics that are wanted, up to the first damage, in their order.

        Raises:
            UsageError: the bag cannot be read at all.
        """
        try:
            yield from self._foreign_messages(wanted) if self._foreign else stored_messages(
                self.path, wanted)
        except (BagTruncated, BagCorrupt) as error:
            self.note = f'{error}; what lies before it is used'
        except BagError as error:
            raise UsageError(str(error)) from error

    def decoded(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Topic, time of recording [ns] and decoded message, of some topics.

        Raises:
            UsageError: the definition of a type is missing in the bag and not installed.
        """
        decoders: dict[str, Callable[[bytes], Any]] = {}
        for message in self.messages(frozenset(topics).__contains__):
            name = message.topic.name
            try:
                if name not in decoders:
                    decoders[name] = decoder(_with_definition(message.topic))
                yield name, message.stamp_ns, decoders[name](message.cdr)
            except BagForeign as error:
                raise UsageError(f'{self.path}: {error}') from error
            except BagCorrupt as error:
                self.note = f'{error}; messages of this kind are left out'

    def of_type(self, types: Collection[str]) -> list[str]:
        """Topics with messages of some types, the most frequent first."""
        return [name for name, _ in self.counts.most_common() if self.types[name] in types]

    def topic(self, given: str, types: Sequence[str], option: str) -> str:
        """The topic that is given, without frames behind it, or the only one of some types.

        Raises:
            UsageError: there is none, or several to choose from.
        """
        name, found = given.partition(':')[0], self.of_type(types)
        if name in found:
            return name
        listed = ', '.join(f'{one} ({self.counts[one]})' for one in found)
        if not name and len(found) > 1:
            what = 'two cameras, or the same twice' if option == 'image' else 'several'
            raise UsageError(f'{self.path}: {what}: {listed}; name one as {option}')
        if not name and found:
            return found[0]
        why = f'no such topic: {name} is not in it' if name else 'no topic for it'
        if name in self.types:
            why = f'{name} is a {self.types[name]}, expected one of {", ".join(types)}'
        fits = f'what fits: {listed}' if found else f'it has none of {", ".join(types)}'
        asked = f'{option} {given}'.rstrip()
        raise UsageError(f'{self.path}: {asked}: {why}; {fits}')

    def _note(self, name: str, kind: str, count: int) -> None:
        self.counts[name] += count
        self.types[name] = kind

    def _list_foreign(self) -> None:
        try:
            with Reader(self.path) as reader:
                for one in reader.connections:
                    if one.msgcount:
                        self._note(one.topic, one.msgtype, one.msgcount)
        except _DAMAGE as error:
            raise UsageError(
                f'{self.path}: cannot be read: {_line(error)}; try ros2 bag reindex, or name one '
                'file of it') from error

    def _foreign_messages(self, wanted: Callable[[str], bool]) -> Iterator[StoredMessage]:
        try:
            with Reader(self.path) as reader:
                chosen = [one for one in reader.connections if wanted(one.topic)]
                topics = {
                    (one.topic, one.msgtype): TopicInfo(
                        name=one.topic, type=one.msgtype, qos='', type_hash='',
                        definition=one.msgdef.data,
                    ) for one in chosen
                }
                for one, stamp_ns, data in reader.messages(chosen) if chosen else ():
                    topic = topics[one.topic, one.msgtype]
                    yield StoredMessage(topic, stamp_ns, bytes(data), stamp_ns)
        except _DAMAGE as error:
            raise BagCorrupt(f'{self.path}: damaged: {_line(error)}', path=self.path) from error


def _holds_bag(folder: Path) -> bool:
    return any(folder.glob('*.mcap*')) or any(folder.glob('*.db3*'))


def _needs_rosbags(path: Path) -> bool:
    if path.is_file():
        return path.suffix == '.db3'
    if any(path.glob('*.db3*')):
        return True
    try:
        return bool(read_description(path).get('compression_mode'))
    except BagError:
        return False


def _with_definition(topic: TopicInfo) -> TopicInfo:
    """The topic with the installed definition of its type, where the bag has none."""
    if topic.definition:
        return topic
    return replace(topic, definition=message_definition(topic.type))


def _line(error: BaseException) -> str:
    return ' '.join(str(error).split())[:200] or type(error).__name__


def stamp_of(message: Any) -> int:
    """Stamp of a message's header [ns]; 0 if it has none."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def picture(message: Any) -> NDArray[np.uint8]:
    """Pixels (H, W, 3) uint8 RGB of a decoded Image or CompressedImage.

    Raises:
        ValueError: another encoding, or the sizes do not fit; in one line.
    """
    if not hasattr(message, 'encoding'):
        try:
            return decode_picture(bytes(message.data))
        except ValueError as error:
            raise ValueError(
                f'compressed image of format {message.format!r:.40} {error}') from error
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        known = ', '.join(_CHANNELS)
        raise ValueError(f'image encoding is {message.encoding!r:.40}; read are {known}')
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, np.uint8)
    if not (0 < width * channels <= step and height > 0 and len(data) >= height * step):
        raise ValueError(f'image of {width} x {height} has step {step} and {len(data)} bytes')
    rows = data[:height * step].reshape(height, step)[:, :width * channels]
    pixels = np.ascontiguousarray(rows).reshape(height, width, channels)
    if message.encoding == 'rgb8':
        return pixels
    if min(height, width) < 2 or (channels == 2 and width % 2):
        raise ValueError(f'image is {width} x {height}')
    return np.asarray(cv2.cvtColor(pixels, _TO_RGB[message.encoding]), np.uint8)
