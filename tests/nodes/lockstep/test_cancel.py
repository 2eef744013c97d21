"""A goal that is cancelled at any moment: what was cancelled has no verdict, what was over has."""

from __future__ import annotations

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from graph_runs import request
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.messages.convert import scenario_message
from taxinet_ros.nodes.running.node_main import spin_for, spin_until

pytestmark = pytest.mark.ros

ENDS = {
    GoalStatus.STATUS_CANCELED: ('INTERRUPTED',),
    GoalStatus.STATUS_SUCCEEDED: ('PASS', 'FAIL'),
}


class Client(Node):
    """Somebody who asks for runs, and thinks better of it."""

    def __init__(self, graph) -> None:
        super().__init__('client', context=graph.nodes[0].context)
        self._executor = graph.nodes[0].executor
        self.action = ActionClient(self, interface.RUN_SCENARIO_TYPE, interface.RUN_SCENARIO)
        graph._spinning.add(self)

    def close(self) -> None:
        self.action.destroy()

    def await_(self, future):
        spin_until(self._executor, future)
        return future.result()

    def cancelled_after(self, request: RunRequest, wait_s: float):
        """Whether the cancel was taken, and how the goal ended."""
        while not self.action.server_is_ready():
            spin_for(self._executor, Future(), 0.02)
        goal = interface.RUN_SCENARIO_TYPE.Goal(scenario=scenario_message(request))
        handle = self.await_(self.action.send_goal_async(goal))
        assert handle.accepted
        ended = handle.get_result_async()
        if wait_s:
            spin_for(self._executor, Future(), wait_s)
        taken = self.await_(handle.cancel_goal_async())
        return bool(taken.goals_canceling), self.await_(ended)


@pytest.mark.nightly
def test_given_a_cancel_at_any_moment_then_what_is_cancelled_has_no_verdict(tmp_path):
    taken_of = {True: 0, False: 0}
    rng = np.random.default_rng(20)
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    with composed_graph(options) as graph:
        client = Client(graph)
        for index, wait_s in enumerate([0.0, 2.0, *rng.uniform(0.0, 0.4, 23)]):
            asked = request(f'r{index}', 0.5)
            taken, ended = client.cancelled_after(asked, wait_s)
            status = ended.result.status
            assert status.outcome in ENDS[ended.status]
            assert taken == (ended.status == GoalStatus.STATUS_CANCELED), (wait_s, status.outcome)
            bag = tmp_path / asked.run_id
            assert open_recording(bag).facts.outcome == status.outcome
            assert check_bag(bag).findings == ()
            taken_of[taken] += 1
    assert min(taken_of.values()) > 0, taken_of
