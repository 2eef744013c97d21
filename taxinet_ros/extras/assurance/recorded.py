"""What a monitor says of a recorded run: when it raises the alarm, and its scores until then.

The alarm is a function of the run's frames, estimates and commands, which the bag has or gives
again; so of a run under a monitor this tells when and why its switch changed over, to the bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from taxinet_ros.bag.run.message_values import error_of
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.bag.run.topics import ESTIMATE
from taxinet_ros.core.assurance.monitor import RuntimeMonitor, Seen
from taxinet_ros.core.assurance.switch import Alarm, alarm_of
from taxinet_ros.core.control_step import rolling_on
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a monitor says of a run.

    Attributes:
        alarm: the first alarm; None if there is none.
        largest: largest score over its threshold, by check, until the alarm.
        steps: control steps judged.
    """

    alarm: Alarm | None
    largest: Mapping[str, float]
    steps: int


def judge_recording(recording: Recording, monitor: RuntimeMonitor) -> Told:
    """Show a recorded run to a monitor.

    Args:
        recording: a run in lockstep; frames that were not recorded are rendered.
        monitor: the monitor.

    Raises:
        UsageError: it is a free run, or lacks a frame, an estimate or a command.
        WorldDiffers: a missing frame cannot be rendered.
        UserCodeError: user code failed.
    """
    run = recording.run
    if run.timing.free:
        raise UsageError(f'{recording.path}: a free run, whose unanswered frames nobody judged')
    columns = recording.columns
    scenario = run.request.scenario
    frames = {frame.seq: frame.image for frame in recording.frames()}
    estimates = {
        int(message.seq): error_of(message) for _, _, message in recording.messages((ESTIMATE,))
    }
    monitor.begin(scenario)
    before, largest = rolling_on(scenario.speed_mps), dict[str, float]()
    alarm, done = None, 0
    for row, seq in enumerate(np.asarray(columns['seq'], np.int64).tolist()):
        if seq not in frames or seq not in estimates or seq != row:
            raise UsageError(
                f'{recording.path}: step {row} has no frame or estimate; the bag is incomplete'
            )
        values = {
            name: float(np.asarray(columns[name], np.float64)[row])
            for name in ('steering_rad', 'speed_cmd_mps')
        }
        scores = monitor.scores(Seen(
            image=frames[seq], command=before, estimate=estimates[seq],
        ))
        done += 1
        for name, score in scores.items():
            largest[name] = max(largest.get(name, score), score)
        alarm = alarm_of(scores, row)
        if alarm is not None:
            break
        before = TaxiCommand(
            steering_rad=values['steering_rad'], speed_mps=values['speed_cmd_mps']
        )
    return Told(alarm=alarm, largest=largest, steps=done)
