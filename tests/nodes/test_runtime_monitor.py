"""The run-time monitor's node says of a run, while it goes on, what its bag says of it later."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_runs import run, spin
from playing import listening, playing
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message

from taxinet_ros.bag.reader import stored_messages
from taxinet_ros.bag.run.message_values import error_of
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.topics import ESTIMATE
from taxinet_ros.core.assurance.monitor import Seen, make_monitor
from taxinet_ros.core.assurance.switch import alarm_of
from taxinet_ros.core.control_step import rolling_on
from taxinet_ros.core.pacing.timing import free_timing
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.runtime_monitor import RuntimeMonitor

pytestmark = pytest.mark.ros

BESIDE = (*interface.PARTICIPANTS, interface.RUNTIME_MONITOR)
TURNING = """
class Turning:
    def __init__(self):
        self.total = 0.0
    def __call__(self, seen):
        self.total += abs(seen.command.steering_rad)
        self.total += 1e-4 * (seen.image.mean() + abs(seen.estimate.cte_m))
        return self.total
"""


@pytest.fixture(scope='session')
def mine(tmp_path_factory):
    """Word of a monitor that raises an alarm amid the short run."""
    path = tmp_path_factory.mktemp('mine') / 'mine.py'
    path.write_text(TURNING)
    return f'{path}:Turning'


def make_node(context, monitor):
    return RuntimeMonitor(context=context, parameter_overrides=[
        Parameter('monitor', value=str(monitor)), Parameter('diagnostics', value=0.0),
    ])


class Heard:
    """What the node has said on its topic, step by step."""

    def __init__(self, messages, rate_hz=10):
        arrays = [deserialize_message(cdr, DiagnosticArray) for cdr in messages]
        self.statuses = [status for array in arrays for status in array.status]
        assert len(self.statuses) == len(arrays)
        stamps = [one.header.stamp for one in arrays]
        self.steps = [round((stamp.sec + stamp.nanosec / 1e9) * rate_hz) for stamp in stamps]
        self.values = [{x.key: x.value for x in one.values} for one in self.statuses]
        self.levels = [one.level for one in self.statuses]

    def check(self, told, steps, run):
        """It is what the bag says."""
        assert self.steps == list(range(steps))
        assert {one['run'] for one in self.values} == {run}
        assert [int(one['step']) for one in self.values] == self.steps
        until = self.values[:told.steps]
        names = set(told.largest)
        assert names
        found = {name: max(float(one[name]) for one in until) for name in names}
        assert found == dict(told.largest)
        if told.alarm is None:
            assert set(self.levels) == {DiagnosticStatus.OK}
            return
        at = told.alarm.step
        assert self.levels == [DiagnosticStatus.OK] * at + [DiagnosticStatus.ERROR] * (steps - at)
        assert {one['alarm step'] for one in self.values[at:]} == {str(at)}
        assert self.statuses[-1].message == str(told.alarm)


def judged(bag, word):
    """First alarm, largest scores until then and the number of steps, of what a bag holds."""
    recording, monitor, largest = open_recording(bag), make_monitor(str(word)), {}
    scenario = recording.run.request.scenario
    estimates = [error_of(message) for _, _, message in recording.messages((ESTIMATE,))]
    sent = zip(*(recording.columns[one].tolist() for one in (
        'steering_rad', 'speed_cmd_mps')), strict=True)
    commands = [rolling_on(scenario.speed_mps), *(
        TaxiCommand(steering_rad=steering, speed_mps=speed) for steering, speed in sent)]
    monitor.begin(scenario)
    for frame, estimate, command in zip(
        recording.frames(), estimates, commands[:-1], strict=True
    ):
        scores = monitor.scores(Seen(image=frame.image, estimate=estimate, command=command))
        largest = {name: max(score, largest.get(name, score)) for name, score in scores.items()}
        alarm = alarm_of(scores, frame.seq, scenario.period_ns)
        if alarm is not None:
            break
    return SimpleNamespace(alarm=alarm, largest=largest, steps=frame.seq + 1)


@pytest.mark.parametrize('rate_hz', [10, 20])
def test_given_a_run_with_it_then_time_waits_for_it_and_the_bag_says_the_same(
    tmp_path, short_request, mine, rate_hz
):
    scenario = replace(short_request.scenario, control_rate_hz=rate_hz)
    request = replace(short_request, scenario=scenario, run_id='beside', participants=BESIDE)
    messages = []
    with composed_graph(GraphOptions(perception='taxinet', out=tmp_path)) as graph:
        spinning = graph._spinning
        node = make_node(spinning.context, mine)
        spinning.add(node)
        topic = interface.ALARM
        node.create_subscription(topic.type, topic.name, messages.append, topic.end_qos, raw=True)
        (result,) = run(graph, request)
    assert result.outcome.judged, result
    told = judged(tmp_path / 'beside', mine)
    assert told.alarm is not None
    assert 0 < told.alarm.step < 2 * rate_hz
    Heard(messages, rate_hz).check(told, 2 * rate_hz + 1, 'beside')
    told_of = [
        one.cdr for one in stored_messages(tmp_path / 'beside')
        if one.topic.name == '/node_status' and b'runtime_monitor' in one.cdr
    ]
    assert len(told_of) == 1, 'the bag says that it took part'


INPUTS = ['/camera/image_raw', '/perception/tracking_error', '/taxi_command']


def test_given_a_player_then_it_looks_on_and_says_the_same_at_each_turn(bag, mine):
    told = judged(bag, mine)
    assert told.alarm is not None
    with listening(interface.ALARM) as (listener, executor, context):
        node = make_node(context, mine)
        executor.add_node(node)
        heard = listener.heard[interface.ALARM.name]
        for turn in (1, 2):
            with playing(context, executor, bag, rate=10.0, wait_for=INPUTS) as player:
                assert player.play(executor) == 0
                spin(executor, lambda turn=turn: len(heard) == 21 * turn)
        executor.remove_node(node)
        node.destroy_node()
    Heard(heard[:21]).check(told, 21, 'played')
    Heard(heard[21:]).check(told, 21, 'played')


def test_given_a_lost_frame_then_nothing_is_judged_and_it_says_so(bag, mine):
    with listening(interface.ALARM) as (listener, executor, context):
        node = make_node(context, mine)
        executor.add_node(node)
        with playing(
            context, executor, bag, rate=10.0, start_offset=0.5, wait_for=INPUTS
        ) as player:
            assert player.play(executor) == 0
            spin(executor, lambda: node.health().level == DiagnosticStatus.WARN)
        health = node.health()
        executor.remove_node(node)
        node.destroy_node()
    assert health.message == 'run played: not judged from step 0 on: its frame is lost'
    assert listener.heard[interface.ALARM.name] == []


def test_given_a_free_run_then_it_cannot_take_part(tmp_path, short_request, mine):
    options = GraphOptions(perception='truth', out=tmp_path, timing=free_timing('0.0'))
    request = replace(short_request, participants=BESIDE)
    with composed_graph(options) as graph:
        graph._spinning.add(make_node(graph._spinning.context, mine))
        (result,) = run(graph, request)
    assert result.outcome is Outcome.REJECTED
    assert 'runtime_monitor: not in a free run' in result.detail
