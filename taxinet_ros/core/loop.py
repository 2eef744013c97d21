"""The closed loop in one process, without ROS: the bit-exact reference for the ROS graph.

Each control step: observe the world, estimate, compute the command, evaluate the requirements on
the truth, advance the world (paper, section 3.1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from taxinet_ros.core.clearance import Clearance
from taxinet_ros.core.control_step import Observation, rolling_on, signals
from taxinet_ros.core.faults import loop_delay_ns
from taxinet_ros.core.motion.controller import Controller, SteeringGains, SteeringLaw
from taxinet_ros.core.mtl import NO_ASSUMPTIONS, Assumptions, Reading, Spec
from taxinet_ros.core.mtl.specs import MOST_CLEARANCE_M, MOST_HOLD_DISTANCE_M
from taxinet_ros.core.pacing.timing import AT_ONCE, LateAnswers, Timing
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand, TrackingError, step_stamp_ns
from taxinet_ros.core.verdict.judge import Judge, Judgement
from taxinet_ros.core.verdict.judging import StopOn
from taxinet_ros.core.world import SimulatedWorld, WorldMaker, check_picture, closing


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Step:
    """One control step: state, observation, estimate, command, readings, distances."""

    observation: Observation
    estimate: TrackingError
    command: TaxiCommand
    readings: tuple[Reading, ...]
    clearance_m: float = MOST_CLEARANCE_M
    hold_distance_m: float = MOST_HOLD_DISTANCE_M

    @property
    def sample(self) -> dict[str, float]:
        """The monitored signals."""
        now = self.observation
        along_m, cte_m, he_rad = now.on_track
        return signals(
            cte_m=cte_m, he_rad=he_rad, x_m=along_m, speed_mps=now.state.speed_mps,
            estimate=self.estimate, command=self.command, clearance_m=self.clearance_m,
            hold_distance_m=self.hold_distance_m,
        )


class LateCommands:
    """Selects the command in effect at each control step with delayed answers.

    The latency of the campaign and the loop's delay in the scenario add up.

    Attributes:
        answers: pending commands.
    """

    def __init__(self, timing: Timing, seed: int, index: int, scenario: Scenario) -> None:
        """Start run ``index`` of a campaign with this seed."""
        self.answers = LateAnswers(rolling_on(scenario.speed_mps))
        self._scenario = scenario
        self._latencies_ns = timing.latencies_ns(seed, index)
        self._period_ns = scenario.period_ns

    def at(self, seq: int, command: TaxiCommand) -> TaxiCommand:
        """Return the command in effect from step ``seq``; ``command`` is the answer to that step.

        Call once per step, in order.
        """
        now_ns = step_stamp_ns(seq, self._period_ns)
        delay_ns = next(self._latencies_ns) + loop_delay_ns(self._scenario, now_ns)
        self.answers.put(seq, now_ns + delay_ns, command)
        return self.answers.newest(now_ns)


def run_closed_loop(
    scenario: Scenario,
    perception: Perception,
    *,
    specs: Sequence[Spec],
    controller: Controller | None = None,
    stop_on: StopOn = StopOn.NEVER,
    assumptions: Assumptions = NO_ASSUMPTIONS,
    on_step: Callable[[Step], None] | None = None,
    timing: Timing = AT_ONCE,
    draws: tuple[int, int] = (0, 0),
    make_world: WorldMaker = SimulatedWorld,
) -> Judgement:
    """Run one scenario to its end.

    Args:
        scenario: initial condition and environment.
        perception: computes estimates from camera frames or the truth.
        specs: formulas to evaluate.
        controller: computes commands from estimates; None: the steering law with default gains.
        stop_on: stop rule; the deciding step is the last.
        assumptions: assumptions on the signals.
        on_step: called with every step, in order, before the world moves on.
        timing: timing of answers.
        draws: seed and index of the run, which determine random latencies.
        make_world: factory of the world.

    Returns:
        The judgement of the run.
    """
    controller = controller or SteeringLaw(SteeringGains())
    perception.begin(scenario.rig)
    controller.begin(scenario)
    pictures = perception.needs_image or controller.needs_image
    sensing = [part for part in (perception, controller) if part.needs_sensors]
    with closing(make_world(scenario, pictures=pictures)) as world:
        commands = LateCommands(timing, *draws, scenario)
        period_ns = scenario.period_ns
        judge = Judge(
            specs, step_stamp_ns(world.last_seq, period_ns), period_ns, stop_on, assumptions,
            scenario.line.half_width_m,
        )
        clearance = Clearance(scenario)
        while True:
            now = world.observe()
            if perception.needs_image:
                check_picture(now, f'perception {perception.word}')
            if now.measured is not None:
                for part in sensing:
                    part.sense(now.measured)
            along_m, cte_m, he_rad = now.on_track
            estimate = perception.estimate(now.image, TrackingError(cte_m=cte_m, he_rad=he_rad))
            if controller.needs_image:
                check_picture(now, f'controller {controller.word}')
                assert now.image is not None
                controller.see(now.image)
            command = controller.command(estimate)
            clearance_m = clearance.of_state(now.stamp_ns, now.state)
            hold_distance_m = clearance.to_hold_line(now.stamp_ns, now.state.x_m, now.state.y_m)
            sample = signals(
                cte_m=cte_m,
                he_rad=he_rad,
                x_m=along_m,
                speed_mps=now.state.speed_mps,
                estimate=estimate,
                command=command,
                clearance_m=clearance_m,
                hold_distance_m=hold_distance_m,
            )
            readings = judge.push(now.stamp_ns, sample)
            if on_step is not None:
                on_step(Step(
                    observation=now, estimate=estimate, command=command, readings=readings,
                    clearance_m=clearance_m, hold_distance_m=hold_distance_m,
                ))
            if now.seq == world.last_seq or judge.stopped_early:
                return judge.judgement
            world.advance(commands.at(now.seq, command))
