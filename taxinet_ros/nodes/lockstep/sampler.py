"""Client of the action ``run_scenario``: runs scenes on the graph one by one."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable
from typing import Any
from uuid import uuid4

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from taxinet_msgs.msg import NodeStatus, Verdict

from taxinet_ros.bag.run.message_values import account_of
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M
from taxinet_ros.core.types import step_stamp_ns
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import InfraKind, plain_line
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages.convert import (
    death_notice,
    scenario_message,
    statistics_of,
)
from taxinet_ros.nodes.running.domain import End, simulators
from taxinet_ros.nodes.running.parameters import Parameter, declare_all

_WATCH_PERIOD_S = 0.1
_SILENT_LOOKS = 20
"""Number of checks without a message, after an interrupt, until the simulator counts as gone."""
_ASK_AGAIN_S = 2.0
"""Silence [s] after which the result is requested again.

The simulator reports progress several times a second, so it may have ended the run. Its result, and
its acceptance of the run, can be lost (once in 3,900 tests on a busy machine); results are kept for
a while.
"""
PATIENCE = (
    Parameter(
        name='server_timeout', default=30.0, limits=(0.1, 3600.0),
        description='wall-clock timeout to find the simulator [s]',
    ),
    Parameter(
        name='silence_timeout', default=60.0, limits=(0.1, 3600.0),
        description='wall-clock silence of the simulator that ends a run as INFRA_ERROR [s]',
    ),
)


class ScenarioSampler(Node):
    """Drives the graph run by run over the action ``run_scenario``.

    Attributes:
        seq: latest known control step of the current run.
        interrupted: whether :meth:`interrupt` was called.
    """

    def __init__(self, **node: Any) -> None:
        """Declare parameters and join the graph; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.SCENARIO_SAMPLER, **node)
        given = declare_all(self, PATIENCE)
        self._limits = (given['server_timeout'], given['silence_timeout'])
        self._client = ActionClient(self, interface.RUN_SCENARIO_TYPE, interface.RUN_SCENARIO)
        topic = interface.OBITUARY
        self._death_notices = self.create_publisher(topic.type, topic.name, topic.qos)
        self._goal: Any = None
        self._sent: Any = None
        self._asked_of: set[End] = set()
        self._dead: set[End] = set()
        self._answer: Future | None = None
        self._finished: Future | None = None
        self._cancelled = False
        self.interrupted = False
        self._request: RunRequest | None = None
        self.seq = 0
        self._last_heard = self._last_asked = 0.0
        self._silent_looks = 0
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_WATCH_PERIOD_S, self._watch, clock=steady)

    def start(
        self, executor: Any, requests: Iterable[RunRequest],
        on_result: Callable[[RunRequest, RunResult], bool],
    ) -> Future:
        """Start a campaign; the future is done after its last result.

        Args:
            executor: the one that spins this node.
            requests: the runs, in order; drawn one at a time.
            on_result: called with every result; False ends the campaign.
        """
        self._executor = executor
        self._finished = Future(executor=executor)
        self._requests, self._on_result = iter(requests), on_result
        executor.create_task(self._guarded(self._begin_next))
        return self._finished

    # Signal handlers call this. The code that they interrupt may hold locks of rclpy, so it only
    # leaves word for :meth:`_watch`.

    def interrupt(self) -> None:
        """Cancel the current run soon, take its result, and request no more."""
        self.interrupted = True
        self._silent_looks = 0

    def report_death(self, node: str, detail: str) -> None:
        """Report a dead node process: its run ends at once with the reason."""
        if self._request is None or self._answer is None or self._answer.done():
            return
        if node == interface.SIMULATOR:
            self._lose_simulator(InfraKind.DIED, detail)
        else:
            self._death_notices.publish(self._death_notice(node, detail, InfraKind.DIED))

    def _lose_simulator(self, kind: str, detail: str) -> None:
        """End the run on behalf of the simulator."""
        assert self._request is not None
        assert self._answer is not None
        if kind == InfraKind.DIED:
            self._dead |= self._asked_of
        self._death_notices.publish(self._death_notice(interface.SIMULATOR, detail, kind))
        self._answer.set_result(RunResult.infra_error(kind, interface.SIMULATOR, detail, self.seq))

    def _death_notice(self, node: str, detail: str, kind: str) -> NodeStatus:
        asked = self._request
        assert asked is not None
        return death_notice(
            asked.run_id, node, detail, kind=kind, seq=self.seq,
            stamp_ns=step_stamp_ns(self.seq, asked.scenario.period_ns),
        )

    def close(self) -> None:
        """Leave the graph; all results have been taken."""
        self._client.destroy()

    # Run by run --------------------------------------------------------------------------------
    #
    # Uses callbacks, not awaiting tasks: in the events executor of rclpy 7.1, such a task sees
    # another task's result only at the next event, and is polled at every event until then.

    def _guarded(self, action: Callable[..., None], *what: Any) -> Callable[..., None]:
        """Exceptions belong to the caller of the campaign, not to the executor."""
        finished = self._finished
        assert finished is not None

        def guarded(*came: Future) -> None:
            try:
                action(*what, *came)
            except BaseException as error:
                finished.set_exception(error)

        return guarded

    def _begin_next(self) -> None:
        request = next(self._requests, None)
        if request is None:
            self._finish()
            return
        self._request, self.seq, self._cancelled = request, 0, False
        self._asked, self._last_heard = time.monotonic(), 0.0
        self._answer = Future(executor=self._executor)
        self._answer.add_done_callback(self._guarded(self._take_answer, request))
        if self.interrupted:
            self._answer.set_result(RunResult(outcome=Outcome.INTERRUPTED))
        elif self._may_ask():
            self._ask(request, self._answer)

    def _take_answer(self, request: RunRequest, answer: Future) -> None:
        self._goal = self._request = None
        wall_s = time.monotonic() - self._asked
        result = dataclasses.replace(answer.result(), wall_s=wall_s)
        if not self._on_result(request, result) or self.interrupted:
            self._finish()
        else:
            self._begin_next()

    def _finish(self) -> None:
        assert self._finished is not None
        if not self._finished.done():
            self._finished.set_result(None)

    def _may_ask(self) -> bool:
        """Whether there is exactly one simulator, with no remains of a dead one."""
        servers = simulators(self).keys()
        return len(servers) <= 1 and not self._dead & servers and self._client.server_is_ready()

    def _ask(self, request: RunRequest, answer: Future) -> None:
        self._asked_of = set(simulators(self))
        goal = interface.RUN_SCENARIO_TYPE.Goal(scenario=scenario_message(request))
        self._last_heard = self._last_asked = time.monotonic()
        self._sent = interface.RUN_SCENARIO_TYPE.Impl.SendGoalService.Request().goal_id
        self._sent.uuid = list(uuid4().bytes)
        sent = self._client.send_goal_async(
            goal, feedback_callback=self._on_feedback, goal_uuid=self._sent
        )
        sent.add_done_callback(self._guarded(self._take_handle, answer))

    def _take_handle(self, answer: Future, sent: Future) -> None:
        handle = sent.result()
        if answer.done():
            return
        if not handle.accepted:
            answer.set_result(
                RunResult.infra_error(InfraKind.BUSY, interface.SIMULATOR, 'refused the run', 0)
            )
            return
        self._goal = handle
        self._cancel_if_interrupted()
        self._ask_result(handle, answer)

    def _cancel_if_interrupted(self) -> None:
        if self.interrupted and self._goal is not None and not self._cancelled:
            self._cancelled = True
            self._goal.cancel_goal_async()

    def _ask_result(self, handle: Any, answer: Future) -> None:
        handle.get_result_async().add_done_callback(self._guarded(self._take_result, answer))

    def _take_result(self, answer: Future, response: Future) -> None:
        found = response.result()
        if answer.done() or found.status == GoalStatus.STATUS_UNKNOWN:
            return
        request = self._request
        half_m = request.scenario.line.half_width_m if request else KMWH_HALF_WIDTH_M
        result = result_of(found.result, half_m)
        if result.outcome is not Outcome.INFRA_ERROR and len(simulators(self)) > 1:
            result = dataclasses.replace(self._two_servers(''), last_seq=result.last_seq)
        answer.set_result(result)

    def _on_feedback(self, message: Any) -> None:
        self._silent_looks = 0
        self._last_heard = self._last_asked = time.monotonic()
        self.seq = message.feedback.seq

    def _watch(self) -> None:
        answer = self._answer
        if answer is None or answer.done():
            return
        self._cancel_if_interrupted()
        server_timeout_s, silence_timeout_s = self._limits
        now = time.monotonic()
        self._silent_looks += 1
        # Ctrl-C in a terminal may also have ended the simulator; a dead one stays visible for a
        # while.
        silent = self._silent_looks > _SILENT_LOOKS or not self._client.server_is_ready()
        if self.interrupted and silent:
            answer.set_result(RunResult(outcome=Outcome.INTERRUPTED, last_seq=self.seq))
        elif self._last_heard:
            if now - self._last_heard > silence_timeout_s:
                self._lose_simulator(InfraKind.TIMEOUT, f'silent for {silence_timeout_s:g} s')
            elif now - self._last_asked > _ASK_AGAIN_S:
                self._last_asked = now
                self._goal = self._goal or self._handle_of_sent()
                self._ask_result(self._goal, answer)
        elif self._may_ask():
            assert self._request is not None
            self._ask(self._request, answer)
        elif now - self._asked > server_timeout_s:
            answer.set_result(self._not_asked(f'within {server_timeout_s:g} s'))

    def _handle_of_sent(self) -> ClientGoalHandle:
        """Handle of the goal that was sent, where its acceptance does not arrive.

        A simulator that does not know the goal answers so, which is ignored.
        """
        accepted = interface.RUN_SCENARIO_TYPE.Impl.SendGoalService.Response(accepted=True)
        return ClientGoalHandle(self._client, self._sent, accepted)

    def _not_asked(self, within: str) -> RunResult:
        """Reason why there was no simulator, or more than one."""
        if len(simulators(self)) > 1:
            return self._two_servers(f', {within} too')
        return RunResult.infra_error(
            InfraKind.NOT_READY, interface.SIMULATOR, f'not found {within}', 0
        )

    def _two_servers(self, still: str) -> RunResult:
        names = sorted(simulators(self).values())
        others = [name for name in names if name != interface.SIMULATOR] or names
        detail = f'{len(names)} nodes publish {interface.SCENARIO.name}{still}'
        return RunResult.infra_error(InfraKind.INTRUDER, others[0], detail, 0)


def result_of(answer: Any, half_width_m: float = KMWH_HALF_WIDTH_M) -> RunResult:
    """Convert the result of the action ``run_scenario``, from any server, of a run on a runway."""
    status, verdict = answer.status, answer.verdict
    if status.outcome not in list(Outcome):
        detail = plain_line(f'answered {status.outcome!r}, which is not an outcome')
        return RunResult.infra_error(InfraKind.PROTOCOL, interface.SIMULATOR, detail, status.seq)
    outcome = Outcome(status.outcome)
    judged = outcome.judged
    return RunResult(
        outcome=outcome,
        kind=plain_line(status.kind),
        who=plain_line(status.who),
        detail=plain_line(status.detail),
        last_seq=status.seq,
        perception=status.perception,
        fingerprint=status.fingerprint,
        timing=plain_line(answer.timing),
        free=account_of(answer.account).figures() if answer.account.ended else {},
        **(_judged(verdict, half_width_m) if judged else {}),
    )


def _judged(verdict: Verdict, half_width_m: float) -> dict[str, Any]:
    return {
        'robustness': {
            one.spec: RobustnessInterval.of_message(one) for one in verdict.specs
        },
        'stopped_early': verdict.stopped_early,
        'statistics': statistics_of(verdict, half_width_m),
    }
