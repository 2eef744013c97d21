"""Re-simulate a recorded run: states and images from scenario and commands.

The recorded attitude is a quaternion, from which the exact angles cannot be restored, but images
depend on the angles. So the aircraft is re-simulated from the scenario and the recorded commands,
and checked bit for bit against the recorded odometry and truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.bag.errors import BagEmpty, BagError, BagForeign
from taxinet_ros.bag.run.facts import RecordedRun, free_account
from taxinet_ros.bag.run.message_values import command_of, stamp_of
from taxinet_ros.bag.run.topics import COMMAND, ODOMETRY
from taxinet_ros.core.control_step import Observation, rolling_on
from taxinet_ros.core.loop import LateCommands
from taxinet_ros.core.types import AircraftState, TaxiCommand, quaternion
from taxinet_ros.core.world import ChosenWorld, closing, find_world
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.registry import FORK, KMWH

if TYPE_CHECKING:
    from taxinet_ros.bag.run.recording import Recording

class WorldDiffers(BagError):  # noqa: N818 - the state of the bag
    """A frame cannot be had again.

    The re-simulated aircraft deviates, as the bag is from another version or machine; or the camera
    does not take the same picture twice.
    """


def observations(
    recording: Recording, run: RecordedRun, wanted: Callable[[int], bool]
) -> Iterator[Observation]:
    """See :meth:`.recording.Recording.observations`."""
    path = recording.path
    recorded, commands = states_and_commands(recording)
    chosen = recorded_world(path, run)
    held = _held(recording, run, commands)
    with closing(chosen.make(run.request.scenario)) as world:
        for seq in range(world.last_seq + 1):
            if seq not in recorded:
                return
            if not chosen.reproducible and wanted(seq):
                raise WorldDiffers(
                    f'{path}: step {seq} has no recorded frame: {chosen.again_words}',
                    path=path,
                )
            now = world.observe(picture=wanted(seq))
            check_state(path, seq, recorded[seq], now.state)
            yield now
            command = held(seq)
            if command is None:
                return
            try:
                world.advance(command)
            except InfraError:  # The simulator failed here during the recording, too.
                return


def recorded_world(path: Path, run: RecordedRun) -> ChosenWorld:
    """World of the run in the bag at ``path``; refused if its package is gone or has changed."""
    try:
        if run.world == FORK:
            return _world_of_fork(run)
        return find_world(run.world or KMWH, run.world_fingerprint)
    except UsageError as error:
        raise UsageError(f'{path}: {error}') from error


def _world_of_fork(run: RecordedRun) -> ChosenWorld:
    from taxinet_ros.core.fork import fork_of_text, forked_world

    fork = fork_of_text(run.fork)
    if fork.fingerprint != run.world_fingerprint:
        raise UsageError('the record of the fork is not that of the run')
    return forked_world(fork)


def _held(
    recording: Recording, run: RecordedRun, commands: dict[int, TaxiCommand]
) -> Callable[[int], TaxiCommand | None]:
    """Function giving the command in effect from each step to the next; None if unknown."""
    path = recording.path
    scenario = run.request.scenario
    if not run.timing.free:
        late = LateCommands(run.timing, run.request.seed, run.request.index, scenario)
        return lambda seq: late.at(seq, commands[seq]) if seq in commands else None
    account = free_account(recording.info)
    if account is None:
        raise BagEmpty(
            f'{path}: a free run without the record of its commands in effect, since it did not '
            'end in order', path=path,
        )
    applied = account.applied
    known = {**commands, -1: rolling_on(scenario.speed_mps)}

    def held(seq: int) -> TaxiCommand | None:
        return known.get(applied[seq]) if seq < len(applied) else None

    return held


def states_and_commands(
    recording: Recording,
) -> tuple[dict[int, dict[str, float]], dict[int, TaxiCommand]]:
    """Numbers of the recorded odometry, and the recorded commands, by control step."""
    states: dict[int, dict[str, float]] = {}
    commands: dict[int, TaxiCommand] = {}
    recording.check_damage()
    for topic, _, message in recording.messages((ODOMETRY, COMMAND)):
        try:
            seq = stamp_of(message) // recording.period_ns
            if topic == ODOMETRY:
                states[seq] = _odometry_numbers(message)
            else:
                commands[seq] = command_of(message)
        except (AttributeError, TypeError, ValueError) as error:
            text = f'{recording.path}: topic {topic}: {error}'
            raise BagForeign(text, path=recording.path) from error
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


def check_state(path: Path, seq: int, before: dict[str, float], state: AircraftState) -> None:
    """Raise WorldDiffers if a state is not that of :func:`states_and_commands` to the bit."""
    now = _numbers(state)
    for name, value in before.items():
        if now[name] != value:
            raise WorldDiffers(
                f'{path}: step {seq}: {name} of the aircraft is {value!r} in the bag and '
                f'{now[name]!r} when re-simulated: recorded by another version or on another '
                'machine',
                path=path,
            )
