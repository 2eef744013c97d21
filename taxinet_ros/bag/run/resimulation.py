"""The world of a recorded run once more: states and pictures out of scenario and commands.

The recorded attitude is a quaternion, whose rounding does not give the angles back to the bit, and
the picture follows from the angles. So the aircraft is not read off the bag but driven again: the
scenario and the recorded commands determine every state, and the recorded odometry and truth, which
must come out equal to the bit, prove that they did.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from taxinet_ros.bag.errors import BagEmpty, BagError
from taxinet_ros.bag.reader import decoded_messages, read_info
from taxinet_ros.bag.run.facts import RecordedRun, free_account, read_run
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.loop import ROLLING_ON, LateCommands
from taxinet_ros.core.types import AircraftState, TaxiCommand, quaternion
from taxinet_ros.core.world import KMWH, Observation, World, find_world
from taxinet_ros.errors import InfraError, UsageError

_ODOMETRY, _COMMAND = '/ground_truth/odom', '/taxi_command'


class WorldDiffers(BagError):  # noqa: N818 - the state of the bag
    """Driven again, the aircraft is elsewhere: another version or machine has recorded the bag."""


def observations(
    path: Path, wanted: Callable[[int], bool] = lambda seq: True
) -> Iterator[Observation]:
    """Yield every recorded control step once more, in order.

    Args:
        path: a run folder or an ``.mcap`` file.
        wanted: whether the picture of a control step is to be made; the default makes all.

    Raises:
        WorldDiffers: a state does not come out as recorded; those before were yielded.
        BagError, UsageError: the bag cannot be read, see :func:`.recorded_run.read_run`.
    """
    recorded, commands = _states_and_commands(path)
    run = read_run(path)
    world = _world(path, run)
    held = _held(path, run, commands)
    for seq in range(world.last_seq + 1):
        if seq not in recorded:
            return
        now = world.observe(picture=wanted(seq))
        _compare(path, seq, recorded[seq], _numbers(now.state))
        yield now
        command = held(seq)
        if command is None:
            return
        try:
            world.advance(command)
        except InfraError:  # The simulator broke here when it was recorded, too.
            return


def _world(path: Path, run: RecordedRun) -> World:
    """The run's world at its beginning.

    Raises:
        UsageError: a package brought it that is not installed, or is another one now.
    """
    try:
        chosen = find_world(run.world or KMWH)
    except UsageError as error:
        raise UsageError(f'{path}: {error}') from error
    if chosen.fingerprint != run.world_fingerprint:
        raise UsageError(
            f'{path}: world {run.world} is {chosen.fingerprint[:12]} now, it was '
            f'{run.world_fingerprint[:12]}'
        )
    return chosen.make(run.request.scenario)


def _held(
    path: Path, run: RecordedRun, commands: dict[int, TaxiCommand]
) -> Callable[[int], TaxiCommand | None]:
    """Which command held from each step to the next; None where the bag does not tell."""
    if not run.timing.free:
        late = LateCommands(run.timing, run.request.seed, run.request.index)
        return lambda seq: late.at(seq, commands[seq]) if seq in commands else None
    account = free_account(read_info(path))
    if account is None:
        raise BagEmpty(
            f'{path}: a free run that does not tell which command held when, for it was not ended '
            'in order', path=path,
        )
    applied = account.applied
    known = {**commands, -1: ROLLING_ON}

    def held(seq: int) -> TaxiCommand | None:
        return known.get(applied[seq]) if seq < len(applied) else None

    return held


def _states_and_commands(
    path: Path,
) -> tuple[dict[int, dict[str, float]], dict[int, TaxiCommand]]:
    states: dict[int, dict[str, float]] = {}
    commands: dict[int, TaxiCommand] = {}
    for topic, stamp_ns, message in decoded_messages(path, (_ODOMETRY, _COMMAND).__contains__):
        seq = stamp_ns // CONTROL_PERIOD_NS
        if topic == _ODOMETRY:
            states[seq] = _odometry_numbers(message)
        else:
            commands[seq] = TaxiCommand(
                steering_rad=message.steering_angle, speed_mps=message.speed
            )
    return states, commands


def _odometry_numbers(message: Any) -> dict[str, float]:
    position, attitude = message.pose.pose.position, message.pose.pose.orientation
    return {
        'x': position.x, 'y': position.y, 'z': position.z,
        'qx': attitude.x, 'qy': attitude.y, 'qz': attitude.z, 'qw': attitude.w,
        'speed': message.twist.twist.linear.x, 'yaw rate': message.twist.twist.angular.z,
    }


def _numbers(state: AircraftState) -> dict[str, float]:
    x, y, z, w = quaternion(state.roll_rad, state.pitch_rad, state.yaw_rad)
    return {
        'x': state.x_m, 'y': state.y_m, 'z': state.z_m, 'qx': x, 'qy': y, 'qz': z, 'qw': w,
        'speed': state.speed_mps, 'yaw rate': state.yaw_rate_radps,
    }


def _compare(path: Path, seq: int, before: dict[str, float], now: dict[str, float]) -> None:
    for name, value in before.items():
        if now[name] != value:
            raise WorldDiffers(
                f'{path}: step {seq}: {name} of the aircraft is {value!r} in the bag and '
                f'{now[name]!r} when driven again: recorded by another version or on another '
                'machine',
                path=path,
            )
