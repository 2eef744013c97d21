"""Worker process of a search without ROS: runs closed loops one by one.

Started by :class:`taxinet_ros.campaign.worker_pool.WorkerProcess`, which defines the pipe protocol.
Its runs are bit-identical to those of a graph, but leave no bags.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import cv2
from threadpoolctl import threadpool_limits

from taxinet_ros.campaign.options import CampaignOptions
from taxinet_ros.campaign.worker_pool import encode_line, request_from_json, result_to_json
from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.motion.controller import Controller, SteeringGains, make_controller
from taxinet_ros.core.pacing.timing import Timing, parse_timing
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.user_code import UserCodeError
from taxinet_ros.core.verdict.outcome import RunRequest, RunResult, outcome_of
from taxinet_ros.core.world import SimulatedWorld, WorldMaker, find_world
from taxinet_ros.errors import ExitCode, InfraError, InfraKind, UsageError
from taxinet_ros.processes.child import module_command

_BEAT_S = 1.0


def loop_worker_command(
    campaign: CampaignOptions, controller_sha256: str, world_sha256: str = ''
) -> list[str]:
    """Command line of a worker for the runs of a campaign.

    Args:
        campaign: gives perception, controller, gains and timing.
        controller_sha256: recorded hash of its controller.
        world_sha256: recorded hash of the package that provides its world, or ''.
    """
    return module_command(
        'taxinet_ros.campaign.loop_worker',
        f'--perception={campaign.perception}', f'--controller={campaign.controller}',
        f'--controller-sha256={controller_sha256}',
        f'--world={campaign.world}', f'--world-sha256={world_sha256}',
        f'--gains={json.dumps(dict(campaign.gains))}', f'--timing={campaign.timing.words}',
    )


def run_in_loop(
    request: RunRequest, perception: Perception, controller: Controller, timing: Timing,
    on_step: Callable[[int], None] = lambda seq: None,
    make_world: WorldMaker = SimulatedWorld,
) -> RunResult:
    """Run a request in this process.

    Args:
        request: the requested run.
        perception: the perception.
        controller: the controller.
        timing: when answers take effect.
        on_step: called with the number of every control step.
        make_world: creates the world of the run.

    Returns:
        The same result as from a graph; INFRA_ERROR if a user function or the simulator failed, or
        a sample could not be judged.
    """
    begun_s = time.monotonic()
    judging = request.judging
    specs = judging.parsed_specs
    seq = -1

    def count(step: Step) -> None:
        nonlocal seq
        seq = step.observation.seq
        on_step(seq)

    def broken(kind: str, who: str, detail: str) -> RunResult:
        return RunResult.infra_error(kind, who, detail, seq)

    try:
        judged = run_closed_loop(
            request.scenario, perception, specs=specs, controller=controller,
            stop_on=judging.stop_on, assumptions=judging.assumptions,
            on_step=count, timing=timing, draws=(request.seed, request.index),
            make_world=make_world,
        )
    except UserCodeError as error:
        return broken(InfraKind.NODE_ERROR, 'python', str(error))
    except InfraError as error:
        return broken(error.kind, error.who, error.detail)
    outcome = outcome_of(judged)
    if not outcome.judged:
        detail = 'no whole, finite sequence of samples to judge'
        return broken(InfraKind.INVALID_RUN, 'mtl_monitor', detail)
    readings = zip(specs, judged.readings, strict=True)
    return RunResult(
        outcome=outcome, last_seq=seq,
        robustness={spec.name: reading.interval for spec, reading in readings},
        stopped_early=judged.stopped_early, statistics=judged.statistics,
        perception=perception.word, fingerprint=perception.fingerprint, timing=timing.words,
        wall_s=time.monotonic() - begun_s,
    )


def main(words: Sequence[str] | None = None) -> int:
    """Serve run requests until the input ends.

    Returns:
        Exit code: 0, or 2 after a usage error.
    """
    arguments = _arguments(words)
    cv2.setNumThreads(1)  # the workers share the cores among themselves
    threadpool_limits(limits=1)
    try:
        _work(arguments)
    except UsageError as error:
        os.write(arguments.answers, encode_line({'error': str(error)}))
        return ExitCode.USAGE
    return ExitCode.OK


def _work(arguments: argparse.Namespace) -> None:
    perception = make_perception(arguments.perception)
    controller = make_controller(
        arguments.controller, SteeringGains(**json.loads(arguments.gains))
    )
    if controller.fingerprint != arguments.controller_sha256:
        raise UsageError(
            f'controller {arguments.controller} has changed since this began; put it back'
        )
    world = find_world(arguments.world, arguments.world_sha256)
    timing = parse_timing(arguments.timing)
    told_s = time.monotonic()

    def say(**message: Any) -> None:
        os.write(arguments.answers, encode_line(message))

    def beat(seq: int) -> None:
        # Silence is taken for a hang.
        nonlocal told_s
        if time.monotonic() - told_s > _BEAT_S:
            told_s = time.monotonic()
            say(seq=seq)

    for line in sys.stdin.buffer:
        message = json.loads(line)
        if 'run' not in message:
            return  # an interrupt: the current run has ended
        request = request_from_json(message['run'])
        result = run_in_loop(request, perception, controller, timing, beat, world.make)
        say(result=result_to_json(result))


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument('--answers', type=int, required=True)
    for name in (
        'perception', 'controller', 'controller-sha256', 'world', 'world-sha256', 'gains', 'timing',
    ):
        parser.add_argument(f'--{name}', required=True)
    return parser.parse_args(words)


if __name__ == '__main__':
    sys.exit(main())
