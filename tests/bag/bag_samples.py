"""Bags for the tests: a few control steps of a made-up run, serialised without ROS."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.topics import TopicInfo, offered_qos
from taxinet_ros.bag.writer import BagWriter

ROOT = Path(__file__).parents[2]
STEP_NS = 100_000_000
QOS = offered_qos(history='keep_last', depth=16, reliability='reliable', durability='volatile')
LATCHED = offered_qos(
    history='keep_last', depth=1, reliability='reliable', durability='transient_local'
)
TYPES = {
    '/scenario': 'taxinet_msgs/msg/Scenario',
    '/ground_truth/odom': 'nav_msgs/msg/Odometry',
    '/ground_truth/tracking_error': 'taxinet_msgs/msg/TrackingError',
    '/perception/tracking_error': 'taxinet_msgs/msg/TrackingError',
    '/taxi_command': 'taxinet_msgs/msg/TaxiCommand',
    '/monitor/robustness': 'taxinet_msgs/msg/Robustness',
    '/camera/image_raw': 'sensor_msgs/msg/Image',
}
METADATA = {'scenario': 'corner "7": día\n2', 'seed': '7', 'perception': 'truth'}
ATTACHMENTS = {'scenario.scenic': b'ego = new Plane\n' * 3}

T = TypeVar('T')
Sample = tuple[str, int, bytes]
"""Topic, stamp [ns], serialised message."""


@cache
def store() -> Typestore:
    """Jazzy's types and ours."""
    types = get_typestore(Stores.ROS2_JAZZY)
    ours: dict[str, Any] = {}
    for file in sorted((ROOT / 'msg_defs' / 'msg').glob('*.msg')):
        ours.update(get_types_from_msg(file.read_text(), f'taxinet_msgs/msg/{file.stem}'))
    types.register(ours)
    return types


def make(type_name: str, **fields: Any) -> Any:
    """A message of this type, zero but for the fields given (dots as double underscores)."""
    types = store()

    def zero(name: str) -> Any:
        values = {}
        for field, (kind, detail) in types.fielddefs[name][1]:
            values[field] = _zero(kind, detail, zero)
        return types.types[name](**values)

    message = zero(type_name)
    for path, value in fields.items():
        *owners, last = path.split('__')
        target = message
        for owner in owners:
            target = getattr(target, owner)
        setattr(target, last, value)
    return message


def _zero(kind: int, detail: Any, zero: Any) -> Any:
    if kind == 1:
        return '' if 'string' in detail[0] else 0
    if kind == 2:
        return zero(detail)
    (inner, inner_detail), size = detail
    if inner == 1 and 'string' not in inner_detail[0]:
        dtype = {'byte': 'uint8', 'char': 'uint8'}.get(inner_detail[0], inner_detail[0])
        return np.zeros(size if kind == 3 else 0, dtype=dtype)
    return [zero(inner_detail) for _ in range(size)] if kind == 3 else []


def serialise(message: Any) -> bytes:
    """CDR of a message."""
    return bytes(store().serialize_cdr(message, message.__msgtype__))


def topics(namespace: str = '') -> list[TopicInfo]:
    """The topics of a sample run."""
    found = []
    for name, type_name in TYPES.items():
        definition, _ = store().generate_msgdef(type_name, ros_version=2)
        found.append(TopicInfo(
            name=namespace + name, type=type_name, definition=definition,
            qos=LATCHED if name == '/scenario' else QOS,
            type_hash=store().hash_rihs01(type_name),
        ))
    return found


def frame(step: int, shape: tuple[int, int] = (4, 6)) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Pixels of one step, (H, W, 3)."""
    rng = np.random.default_rng(step)
    return rng.integers(0, 256, (*shape, 3), dtype=np.uint8)


def step_messages(step: int, shape: tuple[int, int] = (4, 6)) -> dict[str, Any]:
    """Message by topic of one step."""
    pixels = frame(step, shape)
    sec, nanosec = divmod(step * STEP_NS, 10**9)
    stamp = {'header__stamp__sec': sec, 'header__stamp__nanosec': nanosec}
    named = {**stamp, 'run_id': 'r', 'seq': step}
    return {
        '/ground_truth/odom': make(
            'nav_msgs/msg/Odometry', **stamp, pose__pose__position__x=10.0 * step,
            pose__pose__position__y=-0.5 * step, twist__twist__linear__x=5.0 + step,
        ),
        '/ground_truth/tracking_error': make(
            'taxinet_msgs/msg/TrackingError', cross_track_error=-0.5 * step,
            heading_error=0.01 * step, valid=True, **named,
        ),
        '/perception/tracking_error': make(
            'taxinet_msgs/msg/TrackingError', cross_track_error=-0.4 * step,
            heading_error=0.02 * step, valid=step != 1, **named,
        ),
        '/taxi_command': make(
            'taxinet_msgs/msg/TaxiCommand', steering_angle=0.1 * step, speed=5.0, **named
        ),
        '/monitor/robustness': make(
            'taxinet_msgs/msg/Robustness', spec='phi_eventually', rho_lower=-1.0 * step,
            rho_upper=8.0 - step, **named,
        ),
        '/camera/image_raw': make(
            'sensor_msgs/msg/Image', **stamp, height=shape[0], width=shape[1], encoding='rgb8',
            step=3 * shape[1], data=pixels.reshape(-1),
        ),
    }


def samples(steps: int, namespace: str = '', shape: tuple[int, int] = (4, 6)) -> list[Sample]:
    """Everything that a sample run holds, in order."""
    first = serialise(make('taxinet_msgs/msg/Scenario', run_id='r', specs=['phi_eventually']))
    found: list[Sample] = [(f'{namespace}/scenario', 0, first)]
    for step in range(steps):
        for name, message in step_messages(step, shape).items():
            found.append((namespace + name, step * STEP_NS, serialise(message)))
    return found


def drain(messages: Iterator[T]) -> tuple[list[T], BagError | None]:
    """Everything that comes, and the error that ended it."""
    found: list[T] = []
    try:
        for message in messages:
            found.append(message)
    except BagError as error:
        return found, error
    return found, None


def write_bag(folder: Path, messages: list[Sample], namespace: str = '') -> Path:
    """Record ``messages``, with a flush whenever the stamp changes; return the storage file."""
    with BagWriter(
        folder, topics(namespace), metadata=METADATA, attachments=ATTACHMENTS, min_free_bytes=0
    ) as bag:
        last = 0
        for topic, stamp_ns, cdr in messages:
            if stamp_ns != last:
                bag.flush()
            last = stamp_ns
            bag.write(topic, cdr, stamp_ns)
        return bag.close().mcap
