"""The one table of the graph: every topic's name, type, quality of service, and who speaks to whom.

Recorder, readiness barrier, README and tests derive from it; no other line spells a topic's name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image
from taxinet_msgs.action import RunScenario
from taxinet_msgs.msg import (
    NodeStatus,
    Robustness,
    RunStatus,
    Scenario,
    TaxiCommand,
    Timing,
    TrackingError,
    Verdict,
)
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from taxinet_ros.bag.run.topics import BASE_FRAME as BASE_FRAME
from taxinet_ros.bag.run.topics import CAMERA_FRAME as CAMERA_FRAME
from taxinet_ros.bag.run.topics import MAP_FRAME as MAP_FRAME
from taxinet_ros.nodes.names import CHAIN as CHAIN
from taxinet_ros.nodes.names import FOLLOWERS as FOLLOWERS
from taxinet_ros.nodes.names import MTL_MONITOR as MTL_MONITOR
from taxinet_ros.nodes.names import PARTICIPANTS as PARTICIPANTS
from taxinet_ros.nodes.names import PERCEPTION as PERCEPTION
from taxinet_ros.nodes.names import RECORDER as RECORDER
from taxinet_ros.nodes.names import SCENARIO_SAMPLER as SCENARIO_SAMPLER
from taxinet_ros.nodes.names import SCENE_MARKERS as SCENE_MARKERS
from taxinet_ros.nodes.names import SIMULATOR as SIMULATOR
from taxinet_ros.nodes.names import STEERING_CONTROLLER as STEERING_CONTROLLER
from taxinet_ros.nodes.names import SUPERVISOR as SUPERVISOR

# Nothing may be lost, so best effort is out; depth holds the lockstep's window with room to spare.
LOCKSTEP = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=16,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
# The window counts frames. Of each frame there is one message per formula, and several nodes report
# how far they are; in a free run nobody waits until an answer that was lost on its way, and is sent
# again within a second, has reached everybody, and there are at most 1000 frames in that.
_QUEUE = 4000
# What the loop's nodes look at: where they are slower than the frames, the newest and no backlog.
NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
# Depth counts messages of all publishers together, and several nodes share node_status.
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=16,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
# As tf2_ros has it.
_TRANSFORMS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
PER_STEP = 'per step'
PER_SPEC = 'per step and formula'
PER_RUN = 'per run'
PER_NODE = 'per run and participant'


@dataclass(frozen=True, kw_only=True)
class Topic:
    """One topic of the graph.

    Attributes:
        name: relative name, so that a whole graph can be put into a namespace.
        type: message class.
        qos: quality of service of both ends, as bags tell it.
        publishers: names of the nodes that speak.
        subscribers: names of the nodes that must hear every message; the recorder is implied
            where ``recorded``.
        recorded: how many messages a run's bag holds, or None where the topic is not recorded.
        carries: one line for people.
        queue: messages that may wait at either end, where those are more than the depth in ``qos``.
    """

    name: str
    type: type[Any]
    qos: QoSProfile
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    recorded: str | None
    carries: str
    queue: int = 0

    @property
    def end_qos(self) -> QoSProfile:
        """What both ends are made with."""
        if not self.queue:
            return self.qos
        return QoSProfile(
            history=self.qos.history, depth=self.queue,
            reliability=self.qos.reliability, durability=self.qos.durability,
        )

    @property
    def type_name(self) -> str:
        """ROS name of the type, e.g. ``sensor_msgs/msg/Image``."""
        package = self.type.__module__.split('.')[0]
        return f'{package}/msg/{self.type.__name__}'

    @property
    def each_step(self) -> bool:
        """Whether there are messages in every control step, by the recorder's account."""
        return self.recorded in (PER_STEP, PER_SPEC)

    def listeners(self, participants: Sequence[str]) -> set[str]:
        """Those of the nodes of a run that subscribe, the recorder included."""
        names = set(self.subscribers) | ({RECORDER} if self.recorded else set())
        return names & {SIMULATOR, *participants}

    def speakers(self, participants: Sequence[str]) -> set[str]:
        """Those of the nodes of a run that publish, one end each."""
        if self.recorded == PER_NODE:
            return {SIMULATOR, *participants}
        return set(self.publishers) & {SIMULATOR, *participants}

SCENARIO = Topic(
    name='scenario', type=Scenario, qos=LATCHED, publishers=(SIMULATOR,),
    subscribers=PARTICIPANTS, recorded=PER_RUN,
    carries='the test case; every participant sets itself up for it',
)
NODE_STATUS = Topic(
    name='node_status', type=NodeStatus, qos=LATCHED, publishers=(SIMULATOR, *PARTICIPANTS),
    subscribers=(SIMULATOR,), recorded=PER_NODE,
    carries='ready, done or error of one participant, with implementation and weights hash',
)
CLOCK = Topic(
    name='/clock', type=Clock, qos=LOCKSTEP, publishers=(SIMULATOR,),
    subscribers=(), recorded=PER_STEP,
    carries='simulated time, from 0 at the start of every run',
)
IMAGE = Topic(
    name='camera/image_raw', type=Image, qos=LOCKSTEP, publishers=(SIMULATOR,),
    subscribers=(PERCEPTION,), recorded=PER_STEP,
    carries='wing-camera frame, 200 x 360 rgb8',
)
CAMERA_INFO = Topic(
    name='camera/camera_info', type=CameraInfo, qos=LOCKSTEP, publishers=(SIMULATOR,),
    subscribers=(), recorded=PER_STEP,
    carries='intrinsics that agree with the pixels',
)
ODOMETRY = Topic(
    name='ground_truth/odom', type=Odometry, qos=LOCKSTEP, publishers=(SIMULATOR,),
    subscribers=(MTL_MONITOR,), recorded=PER_STEP,
    carries='true pose in map and velocity in base_link',
)
TRUTH = Topic(
    name='ground_truth/tracking_error', type=TrackingError, qos=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(PERCEPTION, MTL_MONITOR), recorded=PER_STEP,
    carries='true cross-track and heading error; only a ground-truth perception reads it',
)
ESTIMATE = Topic(
    name='perception/tracking_error', type=TrackingError, qos=LOCKSTEP,
    publishers=(PERCEPTION,), subscribers=(SIMULATOR, STEERING_CONTROLLER, MTL_MONITOR),
    recorded=PER_STEP,
    carries="the perception's estimate for the frame that it names",
    queue=_QUEUE,
)
COMMAND = Topic(
    name='taxi_command', type=TaxiCommand, qos=LOCKSTEP, publishers=(STEERING_CONTROLLER,),
    subscribers=(SIMULATOR, MTL_MONITOR), recorded=PER_STEP,
    carries='steering angle and speed for the frame that it names',
    queue=_QUEUE,
)
ROBUSTNESS = Topic(
    name='monitor/robustness', type=Robustness, qos=LOCKSTEP, publishers=(MTL_MONITOR,),
    subscribers=(), recorded=PER_SPEC,
    carries='robust satisfaction interval of one formula so far',
    queue=_QUEUE,
)
VERDICT = Topic(
    name='monitor/verdict', type=Verdict, qos=LATCHED, publishers=(MTL_MONITOR,),
    subscribers=(SIMULATOR,), recorded=PER_RUN,
    carries='judgement of the whole run',
)
PROGRESS = Topic(
    name='lockstep/progress', type=NodeStatus, qos=LOCKSTEP, publishers=FOLLOWERS,
    subscribers=(SIMULATOR,), recorded=None,
    carries='how far monitor and recorder have come',
    queue=_QUEUE,
)
RUN_STATUS = Topic(
    name='run_status', type=RunStatus, qos=LATCHED, publishers=(SIMULATOR,),
    subscribers=(RECORDER,), recorded=PER_RUN,
    carries='preparing, running, or how the run ended',
)
TIMING = Topic(
    name='timing', type=Timing, qos=LATCHED, publishers=(SIMULATOR,),
    subscribers=FOLLOWERS, recorded=None,
    carries='of a free run alone: which frames have no answer, and how it went',
)
OBITUARY = Topic(
    name='obituary', type=NodeStatus, qos=LATCHED, publishers=(SCENARIO_SAMPLER, SUPERVISOR),
    subscribers=(SIMULATOR, RECORDER), recorded=None,
    carries='a node that is dead (DIED) or a simulator that is silent (ERROR)',
)
"""What is said of nodes by those who look after them; it ends a run, and gives it no verdict.

So anybody may speak here, where on each of :data:`TOPICS` only the nodes of the run may.
"""
TOPICS = (
    SCENARIO, NODE_STATUS, CLOCK, IMAGE, CAMERA_INFO, ODOMETRY, TRUTH, ESTIMATE, COMMAND,
    ROBUSTNESS, VERDICT, PROGRESS, TIMING, RUN_STATUS,
)
TF_STATIC = Topic(
    name='tf_static', type=TFMessage, qos=LATCHED, publishers=(SIMULATOR,),
    subscribers=(), recorded=PER_RUN,
    carries='where camera_optical is in base_link',
)
TF = Topic(
    name='tf', type=TFMessage, qos=_TRANSFORMS, publishers=(SIMULATOR,),
    subscribers=(), recorded=PER_STEP,
    carries='where base_link is in map, as odometry says',
)
TRANSFORMS = (TF_STATIC, TF)
"""Where the frames are, for whoever draws them or asks tf2.

By convention anybody may speak here, of frames of his own. So no node of a run goes by them, and
the recorder does not listen: what a bag has of them is made of its odometry.
"""
DIAGNOSTICS = Topic(
    # Not relative: robots gather all diagnostics there, and names tell whose they are.
    name='/diagnostics', type=DiagnosticArray, qos=LOCKSTEP, publishers=(SIMULATOR, *PARTICIPANTS),
    subscribers=(), recorded=None,
    carries='how each node is doing, by the wall clock; anybody may speak here',
)
SCENE_RUNWAY = Topic(
    name='scene/runway', type=MarkerArray, qos=LATCHED, publishers=(SCENE_MARKERS,),
    subscribers=(), recorded=None,
    carries='pavement, crossing and paint, in map',
)
SCENE_AIRCRAFT = Topic(
    name='scene/aircraft', type=MarkerArray, qos=LOCKSTEP, publishers=(SCENE_MARKERS,),
    subscribers=(), recorded=None,
    carries='the aircraft and its path so far, in map',
)
SCENE = (SCENE_RUNWAY, SCENE_AIRCRAFT)
"""What a viewer draws beside the topics of the graph; made from odometry, never recorded."""
RUN_SCENARIO = 'run_scenario'
RUN_SCENARIO_TYPE = RunScenario


def is_latched(qos: QoSProfile) -> bool:
    """Whether those who come late get what was said before."""
    return bool(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)
