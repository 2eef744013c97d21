"""Table of the graph's topics: name, type, quality of service, publishers and subscribers.

Plain data without ROS, used by nodes, recorder, bag readers, docs and tests. Topic names are
defined only here; ``nodes/interface.py`` creates the rclpy objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

SIMULATOR = 'simulator'
PERCEPTION = 'perception'
STEERING_CONTROLLER = 'steering_controller'
MTL_MONITOR = 'mtl_monitor'
RECORDER = 'recorder'
RUNTIME_MONITOR = 'runtime_monitor'
SCENARIO_SAMPLER = 'scenario_sampler'
SCENE_MARKERS = 'scene_markers'
SUPERVISOR = 'supervisor'

PARTICIPANTS = (PERCEPTION, STEERING_CONTROLLER, MTL_MONITOR, RECORDER)
"""Nodes of the lockstep, besides the simulator that controls it."""

BESIDE = (RUNTIME_MONITOR,)
"""Nodes that may take part in a lockstep, if a run names them; else they only look on."""

CHAIN = (PERCEPTION, STEERING_CONTROLLER)
"""Nodes of the control loop, which answer within a control step."""

FOLLOWERS = (MTL_MONITOR, RECORDER, RUNTIME_MONITOR)
"""Nodes that only subscribe, and report progress."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Quality:
    """Quality of service; values are the names of rosbag2 and rclpy in lower case."""

    depth: int
    history: str = 'keep_last'
    reliability: str = 'reliable'
    durability: str = 'volatile'

    @property
    def latched(self) -> bool:
        """Whether late subscribers get earlier messages."""
        return self.durability == 'transient_local'


# Reliable, since no message may be lost; the depth exceeds the lockstep's window.
LOCKSTEP = Quality(depth=16)
# The lockstep's window counts frames, but each frame has one message per formula, and several nodes
# report progress. In a free run, no node waits while a lost answer is resent; this takes up to a
# second, which is at most 1000 frames.
_QUEUE = 4000
# Inputs of the loop's nodes: a node slower than the frames gets the newest, without a backlog.
NEWEST = Quality(depth=1)
# Depth counts messages of all publishers together, and several nodes share node_status.
LATCHED = Quality(depth=16, durability='transient_local')
# Best effort: viewers request no retransmission, so publishers never wait for them.
LOOKING_ON = Quality(depth=16, reliability='best_effort')
# Same as in tf2_ros.
TF2 = Quality(depth=100)
PER_STEP = 'per step'
PER_SPEC = 'per step and formula'
PER_SAMPLE = 'per measurement'
PER_RUN = 'per run'
PER_NODE = 'per run and participant'


@dataclass(frozen=True, kw_only=True)
class Topic:
    """One topic of the graph.

    Attributes:
        name: relative name, so that a whole graph can be put into a namespace.
        type_name: ROS name of the type, e.g. ``sensor_msgs/msg/Image``.
        quality: quality of service of both ends.
        publishers: names of the publishing nodes.
        subscribers: names of the nodes that must receive every message; the recorder is implied
            if ``recorded``.
        recorded: number of messages in a run's bag, or None if the topic is not recorded.
        carries: one-line description.
        queue: queue length at either end, if greater than the depth in ``quality``.
    """

    name: str
    type_name: str
    quality: Quality
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    recorded: str | None
    carries: str
    queue: int = 0

    @property
    def each_step(self) -> bool:
        """Whether its recorded messages belong to control steps."""
        return self.recorded in (PER_STEP, PER_SPEC, PER_SAMPLE)

    def listeners(self, participants: Sequence[str]) -> set[str]:
        """Nodes of a run that subscribe, including the recorder."""
        names = set(self.subscribers) | ({RECORDER} if self.recorded else set())
        return names & {SIMULATOR, *participants}

    def speakers(self, participants: Sequence[str]) -> set[str]:
        """Nodes of a run that publish, one publisher each."""
        if self.recorded == PER_NODE:
            return {SIMULATOR, *participants}
        return set(self.publishers) & {SIMULATOR, *participants}


SCENARIO = Topic(
    name='scenario', type_name='taxinet_msgs/msg/Scenario', quality=LATCHED,
    publishers=(SIMULATOR,), subscribers=(*PARTICIPANTS, *BESIDE), recorded=PER_RUN,
    carries='the test case; every participant sets itself up for it',
)
NODE_STATUS = Topic(
    name='node_status', type_name='taxinet_msgs/msg/NodeStatus', quality=LATCHED,
    publishers=(SIMULATOR, *PARTICIPANTS, *BESIDE), subscribers=(SIMULATOR,), recorded=PER_NODE,
    carries='ready, done or error of one participant, with implementation and weights hash',
)
CLOCK = Topic(
    name='/clock', type_name='rosgraph_msgs/msg/Clock', quality=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(), recorded=PER_STEP,
    carries='simulated time, from 0 at the start of every run',
)
IMAGE = Topic(
    name='camera/image_raw', type_name='sensor_msgs/msg/Image', quality=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(PERCEPTION, RUNTIME_MONITOR), recorded=PER_STEP,
    carries='wing-camera frame, 200 x 360 rgb8',
)
CAMERA2 = Topic(
    name='camera2/image_raw', type_name='sensor_msgs/msg/Image', quality=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(), recorded=PER_SAMPLE,
    carries='frame of the second camera, if any',
)
CAMERA2_INFO = Topic(
    name='camera2/camera_info', type_name='sensor_msgs/msg/CameraInfo', quality=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(), recorded=None,
    carries='its intrinsics, with each of its frames',
)
FRAMES = IMAGE, CAMERA2
"""Topics that are recorded only with frames."""
CAMERA_INFO = Topic(
    name='camera/camera_info', type_name='sensor_msgs/msg/CameraInfo', quality=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(), recorded=PER_STEP,
    carries='intrinsics that agree with the pixels',
)
ODOMETRY = Topic(
    name='ground_truth/odom', type_name='nav_msgs/msg/Odometry', quality=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(MTL_MONITOR,), recorded=PER_STEP,
    carries='true pose in map and velocity in base_link',
)
TRUTH = Topic(
    name='ground_truth/tracking_error', type_name='taxinet_msgs/msg/TrackingError',
    quality=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(PERCEPTION, MTL_MONITOR), recorded=PER_STEP,
    carries='true cross-track and heading error; only a ground-truth perception reads it',
)
GNSS = Topic(
    name='gnss/fix', type_name='sensor_msgs/msg/NavSatFix', quality=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(), recorded=PER_SAMPLE,
    carries='position of base_link, if the scenario has a GNSS',
    queue=_QUEUE,
)
IMU = Topic(
    name='imu/data', type_name='sensor_msgs/msg/Imu', quality=LOCKSTEP,
    publishers=(SIMULATOR,), subscribers=(), recorded=PER_SAMPLE,
    carries='rates, specific force and orientation (east-north-up), if the scenario has an IMU',
    queue=_QUEUE,
)
WHEEL = Topic(
    name='wheel/twist', type_name='geometry_msgs/msg/TwistWithCovarianceStamped',
    quality=LOCKSTEP, publishers=(SIMULATOR,), subscribers=(), recorded=PER_SAMPLE,
    carries='speed along the body x axis, if the scenario has a wheel speed',
    queue=_QUEUE,
)
SENSORS = {'gnss': GNSS, 'imu': IMU, 'wheel': WHEEL, 'camera': CAMERA2}
"""Topics of the sensors beside the camera, by their keys."""
ESTIMATE = Topic(
    name='perception/tracking_error', type_name='taxinet_msgs/msg/TrackingError',
    quality=LOCKSTEP,
    publishers=(PERCEPTION,),
    subscribers=(SIMULATOR, STEERING_CONTROLLER, MTL_MONITOR, RUNTIME_MONITOR),
    recorded=PER_STEP,
    carries="the perception's estimate for the frame that it names",
    queue=_QUEUE,
)
COMMAND = Topic(
    name='taxi_command', type_name='taxinet_msgs/msg/TaxiCommand', quality=LOCKSTEP,
    publishers=(STEERING_CONTROLLER,), subscribers=(SIMULATOR, MTL_MONITOR, RUNTIME_MONITOR),
    recorded=PER_STEP,
    carries='steering angle and speed for the frame that it names',
    queue=_QUEUE,
)
ROBUSTNESS = Topic(
    name='monitor/robustness', type_name='taxinet_msgs/msg/Robustness', quality=LOCKSTEP,
    publishers=(MTL_MONITOR,), subscribers=(), recorded=PER_SPEC,
    carries='robust satisfaction interval of one formula so far',
    queue=_QUEUE,
)
VERDICT = Topic(
    name='monitor/verdict', type_name='taxinet_msgs/msg/Verdict', quality=LATCHED,
    publishers=(MTL_MONITOR,), subscribers=(SIMULATOR,), recorded=PER_RUN,
    carries='judgement of the whole run',
)
PROGRESS = Topic(
    name='lockstep/progress', type_name='taxinet_msgs/msg/NodeStatus', quality=LOCKSTEP,
    publishers=FOLLOWERS, subscribers=(SIMULATOR,), recorded=None,
    carries='how far the nodes have come that only subscribe',
    queue=_QUEUE,
)
RUN_STATUS = Topic(
    name='run_status', type_name='taxinet_msgs/msg/RunStatus', quality=LATCHED,
    publishers=(SIMULATOR,), subscribers=(RECORDER,), recorded=PER_RUN,
    carries='preparing, running, or how the run ended',
)
TIMING = Topic(
    name='timing', type_name='taxinet_msgs/msg/Timing', quality=LATCHED,
    publishers=(SIMULATOR,), subscribers=(MTL_MONITOR, RECORDER), recorded=None,
    carries='of a free run alone: which frames have no answer, and how it went',
)
OBITUARY = Topic(
    name='obituary', type_name='taxinet_msgs/msg/NodeStatus', quality=LATCHED,
    publishers=(SCENARIO_SAMPLER, SUPERVISOR), subscribers=(SIMULATOR, RECORDER), recorded=None,
    carries='a node that is dead (DIED) or a simulator that is silent (ERROR)',
)
"""Messages of supervisors about nodes; they end a run without a verdict.

Any node may publish here, unlike on :data:`TOPICS`, which are reserved for the nodes of the run.
"""
TOPICS = (
    SCENARIO, NODE_STATUS, CLOCK, IMAGE, CAMERA2, CAMERA_INFO, CAMERA2_INFO, ODOMETRY, TRUTH, GNSS,
    IMU, WHEEL, ESTIMATE, COMMAND, ROBUSTNESS, VERDICT, PROGRESS, TIMING, RUN_STATUS,
)
TF_STATIC = Topic(
    name='tf_static', type_name='tf2_msgs/msg/TFMessage', quality=LATCHED,
    publishers=(SIMULATOR,), subscribers=(), recorded=PER_RUN,
    carries='where camera_optical, and camera2_optical if there is one, are in base_link',
)
TF = Topic(
    name='tf', type_name='tf2_msgs/msg/TFMessage', quality=TF2,
    publishers=(SIMULATOR,), subscribers=(), recorded=PER_STEP,
    carries='where base_link is in map, as odometry says',
)
TRANSFORMS = (TF_STATIC, TF)
"""Transforms of the frames, for viewers and tf2.

By convention any node may publish its own frames here. So no node of a run uses them, and the
recorder does not subscribe: transforms in a bag are computed from its odometry.
"""
DIAGNOSTICS = Topic(
    # Absolute: ROS collects all diagnostics there; the names identify the node.
    name='/diagnostics', type_name='diagnostic_msgs/msg/DiagnosticArray', quality=LOCKSTEP,
    publishers=(SIMULATOR, *PARTICIPANTS, *BESIDE), subscribers=(), recorded=None,
    carries='how each node is doing, by the wall clock; anybody may speak here',
)
ALARM = Topic(
    name='runtime_monitor/alarm', type_name='diagnostic_msgs/msg/DiagnosticArray', quality=LOCKSTEP,
    publishers=(RUNTIME_MONITOR,), subscribers=(), recorded=None,
    carries="scores of each step over their thresholds, and the run's alarm, stamped as the frame",
    queue=_QUEUE,
)
"""Not recorded: a function of frames, estimates and commands."""
SCENE_RUNWAY = Topic(
    name='scene/runway', type_name='visualization_msgs/msg/MarkerArray', quality=LATCHED,
    publishers=(SCENE_MARKERS,), subscribers=(), recorded=None,
    carries='pavement, crossing and paint, in map',
)
SCENE_AIRCRAFT = Topic(
    name='scene/aircraft', type_name='visualization_msgs/msg/MarkerArray', quality=LOCKSTEP,
    publishers=(SCENE_MARKERS,), subscribers=(), recorded=None,
    carries='the aircraft and its path so far, in map',
)
SCENE = (SCENE_RUNWAY, SCENE_AIRCRAFT)
"""Additional topics for viewers; computed from odometry, never recorded."""
