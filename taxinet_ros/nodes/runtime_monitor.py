"""Run-time monitor node: frames, estimates and commands in; the scores of each step, an alarm out.

In a run that names it among its participants, simulated time waits for it as for the recorder. In
any other, and beside ``bag_player``, it only looks on: nobody waits for it, and what it misses it
cannot judge.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from numpy.typing import NDArray
from taxinet_msgs.msg import Scenario

from taxinet_ros.bag.cdr.image import frame_of_cdr
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.core.assurance.monitor import Seen, make_monitor, monitor_names
from taxinet_ros.core.assurance.switch import Alarm, alarm_of
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, last_step, rolling_on
from taxinet_ros.core.pacing.lockstep import reports_progress
from taxinet_ros.core.types import TaxiCommand, TrackingError, step_stamp_ns
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep.diagnostics import PARAMETER as DIAGNOSTICS
from taxinet_ros.nodes.lockstep.diagnostics import Health
from taxinet_ros.nodes.lockstep.participant import Participant
from taxinet_ros.nodes.messages.convert import header
from taxinet_ros.nodes.messages.step import StepMessage
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Parameter, Usage, declare_all, refuse_unknown

_MOST_HELD = 64
"""Most frames and messages that wait for others of their step."""
_Key = tuple[str, int]
"""Run and step of a message."""
_OPTIONS = (
    Parameter(
        name='monitor', default='taxinet',
        takes=f'{", ".join(monitor_names())}, an .npz file of taxinet assure calibrate, '
        'sigma:METRES, or FILE.py:NAME',
        description='the monitor',
    ),
)
USAGE = Usage.of_node(
    interface.RUNTIME_MONITOR,
    does='Judges each estimate of any perception beside any controller, and publishes scores and '
    'alarm; nothing acts on them. Beside bag_player too.',
    parameters=(*_OPTIONS, DIAGNOSTICS),
)


class RuntimeMonitor(Participant):
    """Publishes the scores of every step until the alarm, and from then on the alarm."""

    def __init__(self, **node: Any) -> None:
        """Make the monitor; ``node`` goes to :class:`rclpy.node.Node`.

        Raises:
            UsageError: the monitor is unknown, or cannot be used.
        """
        super().__init__(interface.RUNTIME_MONITOR, **node)
        given = declare_all(self, _OPTIONS)
        refuse_unknown(self)
        self._monitor = make_monitor(given['monitor'])
        self.implementation, self.fingerprint = self._monitor.word, self._monitor.fingerprint
        topic = interface.ALARM
        self._alarms = self.create_publisher(topic.type, topic.name, topic.end_qos)
        self._progress = self.speak(interface.PROGRESS)
        self._looks_on, self._period_ns = True, CONTROL_PERIOD_NS
        self._frames: dict[int, NDArray[np.uint8]] = {}
        self._estimates: dict[_Key, TrackingError] = {}
        self._commands: dict[_Key, TaxiCommand] = {}
        self._restart()
        self.listen(interface.IMAGE, self._see, raw=True)
        self.listen(interface.ESTIMATE, self._hear_estimate)
        self.listen(interface.COMMAND, self._hear_command)

    def prepare(self, scenario: Scenario) -> None:
        """Begin a run."""
        self._scene = scenario_of(scenario)
        self._last_seq, self._period_ns = last_step(self._scene), self._scene.period_ns
        self._stop_on = Judging.from_message(scenario).stop_on
        self._monitor.begin(self._scene)
        self._restart()

    def clear(self) -> None:
        """See :class:`Participant`."""
        self._frames.clear()
        self._estimates.clear()
        self._commands.clear()
        self._restart()

    def report(self, state: int, *, seq: int = 0, stamp_ns: int = 0, detail: str = '') -> None:
        """See :class:`Participant`; who only looks on is no business of the run."""
        if not self._looks_on:
            super().report(state, seq=seq, stamp_ns=stamp_ns, detail=detail)

    def figures(self) -> Mapping[str, object]:
        """See :class:`Participant`."""
        return {'steps judged': self._next, **{
            f'{name}, largest over its threshold': x for name, x in self._largest.items()
        }}

    def health(self) -> Health:
        """See :class:`Participant`; an alarm and a lost message are warnings."""
        found = super().health()
        told = self._lost or (f'monitor: {self._alarm}' if self._alarm else '')
        if not told or found.level != DiagnosticStatus.OK:
            return found
        line = f'run {self.run_id}: {told}'
        return Health(level=DiagnosticStatus.WARN, message=line, values=found.values)

    def _take(self, scenario: Scenario) -> None:
        self._looks_on = self.get_name() not in scenario.participants
        if self._looks_on:
            self.run_id = scenario.run_id
            self.prepare(scenario)
            self._judge()
        super()._take(scenario)

    def _restart(self) -> None:
        self._next = 0
        self._lost = ''
        self._alarm: Alarm | None = None
        self._largest: dict[str, float] = {}

    def _see(self, cdr: bytes) -> None:
        stamp_ns, image = frame_of_cdr(cdr)
        if not stamp_ns and self._looks_on:
            # Leftovers of a run that was broken off, or of the player's turn before.
            self._frames.clear()
            self._estimates = {key: one for key, one in self._estimates.items() if not key[1]}
            self._commands = {key: one for key, one in self._commands.items() if not key[1]}
            if self._next and self.run_id:
                self._monitor.begin(self._scene)
                self._restart()
        _keep(self._frames, stamp_ns, image)
        self._judge()

    def _hear_estimate(self, said: StepMessage) -> None:
        _keep(self._estimates, (said.run_id, said.seq), said.value)
        self._judge()

    def _hear_command(self, said: StepMessage) -> None:
        _keep(self._commands, (said.run_id, said.seq), said.value)
        self._judge()

    def _judge(self) -> None:
        """Judge every step that is whole."""
        while self.run_id and not self._lost:
            seq, run = self._next, self.run_id
            stamp_ns = step_stamp_ns(seq, self._period_ns)
            known = (
                stamp_ns in self._frames and (run, seq) in self._estimates
                and (not seq or (run, seq - 1) in self._commands)
            )
            if not known:
                self._look_for_losses()
                return
            before = self._commands.pop((run, seq - 1)) if seq else \
                rolling_on(self._scene.speed_mps)
            seen = Seen(
                image=self._frames.pop(stamp_ns), estimate=self._estimates.pop((run, seq)),
                command=before,
            )
            if self._alarm is None:
                self._score(seen)
            self._publish(seq)
            self._next += 1
            if not self._looks_on and reports_progress(seq, self._last_seq, self._stop_on):
                self._progress.publish(self.progress(seq, stamp_ns))

    def _score(self, seen: Seen) -> None:
        scores = self._scores = self._monitor.scores(seen)
        for name, score in scores.items():
            self._largest[name] = max(self._largest.get(name, score), score)
        self._alarm = alarm_of(scores, self._next, self._period_ns)
        if self._alarm is not None:
            self.get_logger().warning(f'run {self.run_id}: alarm: {self._alarm}')

    def _publish(self, seq: int) -> None:
        alarm = self._alarm
        values = {'run': self.run_id, 'step': str(seq)}
        values |= {name: repr(float(score)) for name, score in self._scores.items()}
        if alarm is not None:
            values |= {'alarm': alarm.reason, 'alarm step': str(alarm.step)}
        self._alarms.publish(DiagnosticArray(
            header=header(step_stamp_ns(seq, self._period_ns), ''),
            status=[DiagnosticStatus(
                level=DiagnosticStatus.OK if alarm is None else DiagnosticStatus.ERROR,
                name=f'{self.get_name()}: {self.implementation}',
                message='no alarm' if alarm is None else str(alarm), hardware_id='',
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )],
        ))

    def _look_for_losses(self) -> None:
        """A later message of its kind says that one is lost: each kind comes in order."""
        run = self.run_id
        kinds = (
            ('frame', [stamp // self._period_ns for stamp in self._frames], self._next),
            ('estimate', [seq for name, seq in self._estimates if name == run], self._next),
            ('command', [seq for name, seq in self._commands if name == run], self._next - 1),
        )
        for kind, there, wanted in kinds:
            if wanted >= 0 and wanted not in there and max(there, default=-math.inf) > wanted:
                self._lost = f'not judged from step {self._next} on: its {kind} is lost'
                if not self._looks_on:
                    raise RuntimeError(self._lost)
                self.get_logger().warning(f'run {run}: {self._lost}')
                return


def _keep(held: dict[Any, Any], key: Any, value: Any) -> None:
    """Keep a value, and the newest others."""
    held[key] = value
    if len(held) > _MOST_HELD:
        del held[next(iter(held))]


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros runtime_monitor``."""
    run_node(RuntimeMonitor, usage=USAGE)


if __name__ == '__main__':
    main()
