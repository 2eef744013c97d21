"""Bags for the tests: a golden one, driven again on this machine, with messages altered."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.reader import read_attachment, read_info, stored_messages
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.writer import RUN_METADATA, BagWriter
from taxinet_ros.core.types import TaxiCommand, quaternion
from taxinet_ros.core.world import SimulatedWorld

GOLDEN = Path(__file__).parents[1] / 'bags' / 'golden'
SEEN = GOLDEN / 'taxinet-broken-clouds'
"""A recorded run of the network, without frames."""

STEPS = 21
PERIOD_NS = 100_000_000


def driven_here(folder: Path) -> Path:
    """The first steps of the golden run as this machine drives them, which rounds as it does."""
    commands = open_recording(SEEN).columns
    world = SimulatedWorld(open_recording(SEEN).run.request.scenario, pictures=False)
    states = []
    for seq in range(STEPS):
        states.append(world.observe().state)
        world.advance(TaxiCommand(
            steering_rad=float(commands['steering_rad'][seq]),
            speed_mps=float(commands['speed_cmd_mps'][seq]),
        ))

    def drive(stored: StoredMessage, message: Any) -> bool:
        if stored.topic.name != '/ground_truth/odom':
            return False
        state = states[stored.stamp_ns // PERIOD_NS]
        position, attitude = message.pose.pose.position, message.pose.pose.orientation
        position.x, position.y, position.z = state.x_m, state.y_m, state.z_m
        angles = state.roll_rad, state.pitch_rad, state.yaw_rad
        attitude.x, attitude.y, attitude.z, attitude.w = quaternion(*angles)
        message.twist.twist.linear.x = state.speed_mps
        message.twist.twist.angular.z = state.yaw_rate_radps
        return True

    return altered(SEEN, folder, drive, keep=lambda m: m.stamp_ns < STEPS * PERIOD_NS)


def altered(
    source: Path, folder: Path, change: Callable[[StoredMessage, Any], Any],
    keep: Callable[[StoredMessage], bool] = lambda message: True,
) -> Path:
    """Copy a bag with some messages altered.

    Args:
        source: the bag.
        folder: the new one.
        change: gets a message as stored and as an object; True where it has altered the object.
        keep: which messages to copy.
    """
    info = read_info(source)
    scenario = {'scenario.json': read_attachment(source, 'scenario.json')}
    with BagWriter(
        folder, info.topics, metadata=info.metadata[RUN_METADATA], attachments=scenario,
        min_free_bytes=0,
    ) as bag:
        for stored in filter(keep, stored_messages(source)):
            message = decode(stored.topic, stored.cdr)
            cdr = encoded(stored, message) if change(stored, message) else stored.cdr
            bag.write(stored.topic.name, cdr, stored.stamp_ns)
    return folder


def unaltered(stored: StoredMessage, message: Any) -> bool:
    """Change nothing."""
    return False


def encoded(stored: StoredMessage, message: Any) -> bytes:
    """Serialise an altered message by its topic's own definition."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(stored.topic.definition, stored.topic.type))
    return bytes(store.serialize_cdr(message, stored.topic.type))
