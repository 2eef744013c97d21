"""MTL monitor node: ground truth in; robustness during the run and a verdict at its end out.

If the scenario stops the run early, the verdict is sent at the deciding step instead of the
progress report: the simulator waits for either, and ends the run.
"""

from __future__ import annotations

import functools
from typing import Any

from taxinet_msgs.msg import Scenario, Timing, Verdict

from taxinet_ros.bag.run.message_values import scenario_of, verdict_values
from taxinet_ros.bag.run.messages import robustness_cdr
from taxinet_ros.core.clearance import Clearance
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, last_step, rolling_on, signals
from taxinet_ros.core.mtl import Reading, Spec
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.core.pacing.lockstep import reports_progress
from taxinet_ros.core.pacing.step_collector import FreeProgress, StepCollector
from taxinet_ros.core.types import NO_ESTIMATE, step_stamp_ns
from taxinet_ros.core.verdict.judge import Judge
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.lockstep import diagnostics
from taxinet_ros.nodes.lockstep.participant import Participant
from taxinet_ros.nodes.messages.convert import header, robustness_message
from taxinet_ros.nodes.messages.step import StepMessage
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Usage, refuse_unknown

_INPUTS = (interface.ODOMETRY, interface.TRUTH, interface.ESTIMATE, interface.COMMAND)

USAGE = Usage.of_node(
    interface.MTL_MONITOR,
    does='Evaluates each run of the graph by its formulas. For topics of any robot, without a '
    'simulator, there is live_monitor.',
    parameters=(diagnostics.PARAMETER,),
)


class MtlMonitor(Participant):
    """Evaluates the formulas of each run's scenario on the truth, not the estimate."""

    def __init__(self, **node: Any) -> None:
        """Create the node; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.MTL_MONITOR, **node)
        refuse_unknown(self)
        self._robustness = self.speak(interface.ROBUSTNESS)
        self._verdict = self.speak(interface.VERDICT)
        self._progress = self.speak(interface.PROGRESS)
        self._specs: tuple[Spec, ...] = ()
        self._readings: tuple[Reading, ...] = ()
        self._last_seq, self._period_ns = -1, CONTROL_PERIOD_NS
        self._stop_on = StopOn.NEVER
        for topic in _INPUTS:
            self.listen(topic, functools.partial(self._collect, topic.name))
        self.listen(interface.TIMING, self._settle)

    def prepare(self, scenario: Scenario) -> None:
        """Create a new monitor for every formula of the run."""
        judging = Judging.from_message(scenario)
        self._specs = judging.parsed_specs
        scene = scenario_of(scenario)
        self._track = scene.line
        self._last_seq, self._period_ns = last_step(scene), scene.period_ns
        self._stop_on = judging.stop_on
        self._judge = Judge(
            self._specs, scene.duration_ns, self._period_ns, self._stop_on,
            judging.assumptions, scene.line.half_width_m,
        )
        self._clearance = Clearance(scene)
        self._steps = StepCollector({topic.name: 1 for topic in _INPUTS})
        self._free = False
        followed = interface.ODOMETRY, interface.TRUTH, interface.TIMING
        self._free_progress = FreeProgress([topic.name for topic in followed])
        self._judged = 0
        self._command = rolling_on(scene.speed_mps)
        self._readings = ()

    def figures(self) -> dict[str, object]:
        """See :class:`Participant`: the current interval of each formula."""
        judged = zip(self._specs, self._readings, strict=False)
        return {
            spec.name: ' ... '.join(rho_text(end, '.3f') for end in now) for spec, now in judged
        }

    def clear(self) -> None:
        """See :class:`Participant`."""
        if self._scenario is not None:
            self.prepare(self._scenario)

    def _collect(self, topic: str, said: StepMessage) -> None:
        # Leftovers of an aborted run are not part of this one; odometry has no run_id.
        of_this_run = topic == interface.ODOMETRY.name or said.run_id == self.run_id
        if not (self._specs and of_this_run):
            return
        seq = said.stamp_ns // self._period_ns
        whole = self._steps.add(topic, seq, said)
        for step, messages in whole:
            self._judge_step(step, messages)
        if self._free_progress.arrived(topic, seq) or whole:
            self._report_free()

    def _settle(self, timing: Timing) -> None:
        """In a free run, frames may have no answer, and time does not wait for the monitor."""
        if timing.run_id != self.run_id or timing.ended:
            return
        self._free = True
        for step, messages in self._steps.settle(timing.unestimated, timing.uncommanded):
            self._judge_step(step, messages)
        self._free_progress.arrived(interface.TIMING.name, timing.seq)
        self._report_free()

    def _report_free(self) -> None:
        now = self._free_progress.news(self._judged) if self._free else None
        if now is not None:
            self._progress.publish(self.progress(now[0], step_stamp_ns(now[1], self._period_ns)))

    def _judge_step(self, seq: int, messages: dict[str, list[Any]]) -> None:
        odometry, truth = (messages[topic.name][0] for topic in _INPUTS[:2])
        estimate, command = (messages.get(topic.name) for topic in _INPUTS[2:])
        stamp_ns = truth.stamp_ns
        self._judged = seq
        if command:
            self._command = command[0].value
        sample = signals(
            cte_m=truth.value.cte_m,
            he_rad=truth.value.he_rad,
            x_m=self._track.measure(odometry.value.x_m, odometry.value.y_m).distance_m,
            speed_mps=odometry.value.speed_mps,
            estimate=estimate[0].value if estimate else NO_ESTIMATE,
            command=self._command,  # the last one counts
            clearance_m=self._clearance.at(
                stamp_ns, odometry.value.x_m, odometry.value.y_m, odometry.value.attitude
            ),
            hold_distance_m=self._clearance.to_hold_line(
                stamp_ns, odometry.value.x_m, odometry.value.y_m
            ),
        )
        readings = self._readings = self._judge.push(stamp_ns, sample)
        for breach in self._judge.new_breaches():
            self.get_logger().warning(f'{self.run_id}: {breach}; intervals continue without it')
        for spec, reading in zip(self._specs, readings, strict=True):
            self._robustness.publish(robustness_cdr(spec, reading, self.run_id, seq, stamp_ns))
        stopped = self._judge.stopped_early
        if stopped or seq == self._last_seq:
            self._conclude(seq, stamp_ns)
        if not (stopped or self._free) and reports_progress(seq, self._last_seq, self._stop_on):
            self._progress.publish(self.progress(seq, stamp_ns))

    def _conclude(self, seq: int, stamp_ns: int) -> None:
        judgement = self._judge.judgement
        results = [
            robustness_message(spec, reading, self.run_id, seq, stamp_ns)
            for spec, reading in zip(self._specs, judgement.readings, strict=True)
        ]
        self._verdict.publish(Verdict(
            header=header(stamp_ns), specs=results, **verdict_values(judgement, self.run_id)
        ))


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros mtl_monitor``."""
    run_node(MtlMonitor, usage=USAGE)


if __name__ == '__main__':
    main()
