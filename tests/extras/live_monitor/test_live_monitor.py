"""The monitor on its own hears any topic as it is offered, and says what it cannot judge."""

import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.task import Future
from sensor_msgs.msg import Imu, LaserScan
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from taxinet_msgs.msg import Robustness, Verdict

from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.live_monitor.node import LiveMonitor
from taxinet_ros.extras.live_monitor.outputs import robustness_messages, verdict_message
from taxinet_ros.extras.live_monitor.sample_hold import Sample
from taxinet_ros.extras.live_monitor.stretch import Stretch
from taxinet_ros.extras.live_monitor.topic_reader import message_class
from taxinet_ros.nodes.messages.convert import header
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.node_main import spin_until

pytestmark = pytest.mark.ros

LATCHED = QoSProfile(
    depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE
)
ODOM = ['cte=/robot/odom:pose.pose.position.y', 'speed=/robot/odom:twist.twist.linear.x*3.6']
NEAR = 'near=always(abs(cte) <= 1.5)'
S = 10**9


class Robot:
    """A node that publishes and listens, and whatever runs with it, in this process."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = EventsExecutor(context=self.context)
        self.node = self.add(Node('robot', context=self.context))
        self.heard: dict[str, list] = {}

    def add(self, node):
        self.executor.add_node(node)
        return node

    def monitor(self, **parameters) -> LiveMonitor:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        return self.add(LiveMonitor(context=self.context, parameter_overrides=overrides))

    def hear(self, kind, topic, qos=100) -> list:
        found = self.heard[topic] = []
        self.node.create_subscription(kind, topic, found.append, qos)
        return found

    def until(self, condition) -> None:
        """Spin until something is so; the test's own timeout is the limit."""
        done = Future()
        steady = Clock(clock_type=ClockType.STEADY_TIME)

        def look():
            if condition() and not done.done():
                done.set_result(None)

        timer = self.node.create_timer(0.02, look, clock=steady)
        spin_until(self.executor, done)
        self.node.destroy_timer(timer)

    def close(self) -> None:
        self.executor.shutdown()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def robot():
    with own_domain() as domain:
        robot = Robot(domain)
        yield robot
        robot.close()


def odometry(at_s: float, y: float, v: float = 1.0) -> Odometry:
    message = Odometry(header=header(round(at_s * S)))
    message.pose.pose.position.y = y
    message.twist.twist.linear.x = v
    return message


def levels(messages) -> dict[str, bytes]:
    return {status.name: status.level for status in messages[-1].status} if messages else {}


def test_given_a_formula_that_no_sample_decides_then_a_stretch_is_neither_complete_nor_satisfied():
    known = parse_spec('known=always(v <= 100)', signals=['v'])
    never = parse_spec('never=always[0.05:0.06](v <= 1)', signals=['v'])
    for specs, passed in (([known], True), ([never], False), ([known, never], False)):
        stretch = Stretch(specs, horizon_ns=S)
        for tenth in range(11):
            stretch.push(Sample(stamp_ns=tenth * S // 10, values={'v': 99.0}))
        verdict = verdict_message(robustness_messages(specs, stretch.standings, S, 'run', 10))
        assert (verdict.complete, verdict.satisfied) == (passed, passed)


def test_given_two_topics_of_different_qos_then_formulas_are_judged_and_all_is_told(robot):
    odom = robot.node.create_publisher(Odometry, '/robot/odom', 10)
    scan = robot.node.create_publisher(LaserScan, '/scan', qos_profile_sensor_data)
    robustness = robot.hear(Robustness, 'monitor/robustness')
    diagnostics = robot.hear(DiagnosticArray, '/diagnostics')
    monitor = robot.monitor(
        signals=[*ODOM, 'gap=/scan:ranges[1]'], horizon=1.5, max_age=2.0,
        specs=[NEAR, 'fast=eventually[0:1](speed >= 7)', 'clear=always(gap > 0.5)'],
    )
    beam = LaserScan(header=header(100 * S), ranges=[0.25, 2.0])
    robot.until(lambda: odom.get_subscription_count() and scan.get_subscription_count())
    robot.until(lambda: 'live_monitor: near' in levels(diagnostics))
    assert levels(diagnostics)['live_monitor: near'] == b'\x01', 'it waits for a first sample'
    # Best effort may lose a message, so the beam is there before the odometry samples it.
    robot.until(lambda: scan.publish(beam) or monitor._readers['/scan'].received)
    for at_s, y, v in ((100, 0.0, 1.0), (100.5, 1.0, 2.0), (101, 2.0, 1.0), (101.5, 1.0, 1.0)):
        odom.publish(odometry(at_s, y, v))
    robot.until(lambda: len(robustness) == 12)
    assert [m.seq for m in robustness] == [0] * 3 + [1] * 3 + [2] * 3 + [3] * 3
    assert (robustness[-1].header.stamp.sec, robustness[-1].header.stamp.nanosec) == (101, S // 2)

    late = robot.hear(Verdict, 'monitor/verdict', LATCHED)
    told = robot.hear(String, 'monitor/specs', LATCHED)
    robot.until(lambda: late and told)
    (verdict,) = late
    assert (verdict.complete, verdict.satisfied, verdict.run_id) == (True, False, 'stretch-1')
    assert {m.spec: (m.rho_lower, m.verdict) for m in verdict.specs} == {
        'near': (-0.5, Robustness.VIOLATED),
        'fast': (2.0 * 3.6 - 7, Robustness.SATISFIED), 'clear': (1.5, Robustness.SATISFIED),
    }
    assert all(m.final and m.valid and m.rho_lower == m.rho_upper for m in verdict.specs)
    assert math.isnan(verdict.max_cross_track_error)
    document = json.loads(told[0].data)
    assert document['specs']['clear'] == 'always(gap > 0.5)'
    assert document['signals'][2] == {
        'name': 'gap', 'topic': '/scan', 'type': 'sensor_msgs/msg/LaserScan',
        'field': 'ranges[1]', 'factor': 1.0,
    }
    assert document['sampled_on'] == 'cte'
    robot.until(lambda: levels(diagnostics)['live_monitor: near'] == b'\x02')
    assert levels(diagnostics)['live_monitor: fast'] == b'\x00'
    (signals,) = [s for s in diagnostics[-1].status if s.name == 'live_monitor: signals']
    inputs = {pair.key: pair.value for pair in signals.values}
    assert inputs['/scan'].endswith('sensor_msgs/msg/LaserScan, best effort, volatile')
    assert inputs['/robot/odom'] == '4 messages, nav_msgs/msg/Odometry, reliable, volatile'


def test_given_nan_then_there_is_no_verdict_until_the_service_begins_anew(robot):
    imu = robot.node.create_publisher(Imu, '/imu', LATCHED)
    verdicts = robot.hear(Verdict, 'monitor/verdict')
    diagnostics = robot.hear(DiagnosticArray, '/diagnostics')
    robot.monitor(signals=['tilt=/imu:orientation.x'], specs=['flat=always(tilt <= 0.5)'])
    restart = robot.node.create_client(Trigger, 'monitor/restart')

    def say(at_s, tilt):
        message = Imu(header=header(round(at_s * S)))
        message.orientation.x = tilt
        imu.publish(message)

    def begin_anew():
        answer = restart.call_async(Trigger.Request())
        robot.until(answer.done)
        return answer.result()

    robot.until(lambda: restart.service_is_ready() and imu.get_subscription_count())
    answer = begin_anew()
    assert (answer.success, answer.message) == (False, 'nothing to restart: no sample yet')
    say(5, 0.0)
    say(5.1, math.nan)
    say(5.2, 0.75)
    robot.until(lambda: verdicts and not verdicts[-1].specs[0].valid)
    (flat,) = verdicts[-1].specs
    assert (flat.verdict, flat.rho_upper, flat.rejected) == (Robustness.UNKNOWN, 0.5, 1)
    robot.until(lambda: levels(diagnostics).get('live_monitor: flat') == b'\x02')
    assert 'not valid, at 0.1 s: tilt is nan' in diagnostics[-1].status[0].message

    count = len(verdicts)
    answer = begin_anew()
    assert answer.success
    assert answer.message.startswith('stretch-1 ended at 0.2 s: flat not valid')
    robot.until(lambda: len(verdicts) == count + 1)
    assert (verdicts[-1].run_id, verdicts[-1].complete) == ('stretch-1', False)
    say(1, 0.75)  # stamps may begin anew too
    robot.until(lambda: verdicts[-1].run_id == 'stretch-2')
    (flat,) = verdicts[-1].specs
    assert (flat.verdict, flat.valid, flat.samples) == (Robustness.VIOLATED, True, 1)
    assert (flat.rho_lower, flat.rho_upper) == (-math.inf, -0.25)


def test_given_repeat_and_no_header_then_stretches_follow_one_another_by_the_clock(robot):
    value = robot.node.create_publisher(Float64, 'level', 10)
    verdicts = robot.hear(Verdict, 'monitor/verdict')
    robot.monitor(
        signals=['x=level:data'], specs=['low=always(x < 2)'], horizon=0.2, max_age=0.0,
        repeat=True,
    )
    robot.until(value.get_subscription_count)
    robot.until(
        lambda: value.publish(Float64(data=1.0)) or sum(v.complete for v in verdicts) >= 2
    )
    ended = [verdict for verdict in verdicts if verdict.complete][:2]
    assert [verdict.run_id for verdict in ended] == ['stretch-1', 'stretch-2']
    assert [verdict.specs[0].rho_lower for verdict in ended] == [1.0, 1.0]
    assert all(verdict.specs[0].samples >= 2 for verdict in ended)


@pytest.mark.parametrize(
    ('source', 'words'),
    [
        ('cte=/robot/odom:pose.position.y', 'pose (geometry_msgs/PoseWithCovariance) has no field '
         "'position'"),
        ('cte=/robot/odom:child_frame_id', 'child_frame_id is a string, no number'),
        ('cte=/robot/odom:pose.covariance[36]', 'there are 36 elements'),
        ('cte=/both:data', 'topic /both has publishers of 2 types: std_msgs/msg/Float64, '
         'std_msgs/msg/String'),
    ],
)
def test_given_a_field_that_cannot_be_judged_then_the_node_ends_and_says_why(robot, source, words):
    robot.node.create_publisher(Odometry, '/robot/odom', 10)
    robot.node.create_publisher(Float64, '/both', 10)
    other = Robot(robot.context.get_domain_id())
    other.node.create_publisher(String, '/both', 10)
    try:
        # Both of /both have to be known before the monitor looks.
        robot.until(lambda: len(robot.node.get_publishers_info_by_topic('/both')) == 2)
        monitor = robot.monitor(signals=[source], specs=[NEAR])
        with pytest.raises(UsageError) as raised:
            spin_until(robot.executor, monitor.ended)
    finally:
        other.close()
    assert words in str(raised.value)
    assert source.split(':')[0].split('=')[1] in str(raised.value)


@pytest.mark.parametrize(
    ('parameters', 'words'),
    [
        ({'signals': ODOM}, 'specs: at least one is required'),
        ({'specs': [NEAR]}, 'signals: at least one is required'),
        ({'signals': ['cte']}, "signals: 'cte': expected NAME=/topic:field"),
        ({'signals': ['cte=/a b:x']}, 'expected NAME=/topic:field'),
        ({'signals': ['cte=/a-b:x'], 'specs': [NEAR]}, "'cte=/a-b:x'"),
        ({'signals': ODOM, 'specs': ['a=always(he < 1)']}, "unknown 'he'; known: cte, speed"),
        ({'signals': ODOM[1:], 'specs': ['phi_always']}, 'reads cte, which is no signal'),
        (
            {'signals': ODOM, 'specs': ['far=always[9:12](cte < 1)'], 'horizon': 5.0},
            'parameter specs: spec far: always[9:12] begins 9 s into the run, which lasts 5 s',
        ),
        ({'signals': ['cte[m]=/a:x'], 'specs': ['a=cte < 1 deg']}, 'expected a length'),
        ({'signals': ODOM, 'specs': [NEAR, NEAR]}, 'near is given twice'),
        ({'signals': ODOM, 'specs': [NEAR], 'sampled_on': 'y'}, 'known: cte, speed'),
        ({'signals': ODOM, 'specs': [NEAR], 'repeat': True}, 'needs a horizon'),
        ({'signals': ODOM, 'specs': [NEAR], 'bounds': ['he=0:1']}, "bounds 'he=0:1': unknown"),
        (
            {'signals': ODOM, 'specs': [NEAR], 'rates': ['speed=1']},
            'rates speed: has no effect: no requirement reads speed',
        ),
        ({'signals': ODOM, 'specs': [NEAR], 'rates': ['speed=-1']}, "rates 'speed=-1': expected"),
        ({'signals': ODOM, 'specs': [NEAR], 'time_source': 'sun'}, 'known: header, clock'),
        ({'signal': ODOM}, "unknown parameter 'signal'; did you mean signals?"),
        ({'signals': ODOM, 'specs': [NEAR], 'max_age': -1.0}, 'max_age'),
    ],
)
def test_given_bad_parameters_then_the_node_is_not_made_and_says_which(robot, parameters, words):
    with pytest.raises(UsageError) as raised:
        robot.monitor(**parameters)
    assert str(raised.value).startswith('live_monitor: ')
    assert words in str(raised.value)
    assert '\n' not in str(raised.value)


@pytest.mark.parametrize(
    ('name', 'words'),
    [
        ('os/msg/Path', 'message package os is not installed'),
        ('nobodys_msgs/msg/Thing', 'message package nobodys_msgs is not installed'),
        ('nav_msgs/msg/Nothing', 'has no Nothing'),
        ('nav_msgs/srv/GetMap', 'is not the name of a message type'),
        ('../evil', 'is not the name of a message type'),
    ],
)
def test_given_a_type_that_is_no_message_here_then_nothing_of_it_is_imported(name, words):
    with pytest.raises(UsageError) as raised:
        message_class(name)
    assert words in str(raised.value)


def start(domain: int, *parameters: str) -> subprocess.Popen[str]:
    words = [str(Path(sys.prefix, 'bin', 'taxinet')), 'node', 'live_monitor', '--ros-args']
    for parameter in parameters:
        words += ['-p', parameter]
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain)}
    return subprocess.Popen(words, env=environment, text=True, stderr=subprocess.PIPE)


@pytest.mark.parametrize('field', ['pose.pose.position.y', 'pose.pose.position.up'])
def test_given_a_process_of_its_own_then_it_judges_or_leaves_with_one_line(robot, field):
    odom = robot.node.create_publisher(Odometry, '/robot/odom', qos_profile_sensor_data)
    verdicts = robot.hear(Verdict, 'monitor/verdict', LATCHED)
    process = start(
        robot.context.get_domain_id(), f'signals:=["cte=/robot/odom:{field}"]',
        f'specs:=["{NEAR}"]',
    )
    try:
        if field.endswith('y'):
            times = iter(range(10**6))
            robot.until(lambda: odom.publish(odometry(next(times) / 50, 2.0)) or verdicts)
            process.send_signal(signal.SIGINT)
        _, errors = process.communicate()
    finally:
        process.kill()
    if field.endswith('y'):
        assert process.returncode == 0, errors
        assert verdicts[0].specs[0].verdict == Robustness.VIOLATED
        assert 'near violated at 0 s, rho within [-inf, -0.5]' in errors
    else:
        assert process.returncode == 2, errors
        last = errors.strip().splitlines()[-1]
        assert last.startswith("error: live_monitor: parameter signals: 'cte=/robot/odom:")
        assert "has no field 'up'; its fields: x, y, z" in last
        assert 'Traceback' not in errors
