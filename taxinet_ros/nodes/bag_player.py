"""Executable ``bag_player``: play back a recorded run on its topics, with its clock, at any rate.

Playback follows the wall clock and waits for no answers; other nodes run freely.
(``taxinet bag replay`` replays a run into one node in lockstep.) Messages are published as stored,
in the order of time; what is not a ROS message of its topic's type is left out with a line.
"""

from __future__ import annotations

import heapq
import importlib
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock as RclClock
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.errors import BagCorrupt, BagError
from taxinet_ros.bag.reader import BagInfo, read_info, stored_messages
from taxinet_ros.bag.run.topics import IMAGE, ODOMETRY, SCENARIO, TF, is_of_frames, is_topic
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo, describe_topic, qos_profiles
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages.convert import time_of
from taxinet_ros.nodes.messages.step import TransformBroadcaster
from taxinet_ros.nodes.running.node_main import complain, run_node, spin_until
from taxinet_ros.nodes.running.parameters import Parameter, Usage, declare_all, refuse_unknown
from taxinet_ros.processes.interrupts import interrupts

_MOST_HELD = 1000
"""Maximum history depth taken from a bag, since it costs memory of this process."""
_POLICIES: dict[str, Any] = {
    'history': HistoryPolicy, 'reliability': ReliabilityPolicy, 'durability': DurabilityPolicy,
}


_Bytes = Callable[[bytes], bytes]


def message_class(topic: TopicInfo) -> tuple[type[Any], _Bytes] | None:
    """Message class of a topic, and a check of recorded bytes; None if it is not installed.

    Only packages that provide this message definition are imported. The check returns the bytes,
    or raises :class:`BagError` for bytes that are not such a message.

    Raises:
        UsageError: the installed message definition differs from the recorded one.
    """
    try:
        installed = describe_topic(name=topic.name, type_name=topic.type, qos=topic.qos)
    except UsageError:
        return None
    if topic.type_hash not in ('', installed.type_hash):
        raise UsageError(
            f'{topic.name}: {topic.type} has another version than the installed one; leave it '
            f'out: exclude:=["{topic.name}"]'
        )
    package, _, name = topic.type.split('/')
    # An empty message, such as std_msgs/msg/Empty, has no definition to check.
    check = decoder(installed) if installed.definition.strip() else bytes

    def checked(cdr: bytes) -> bytes:
        try:
            check(cdr)
        except BagCorrupt as error:
            if 'size mismatch' not in str(error):  # rclpy's serialize_message leaves room behind
                raise
        return cdr

    return getattr(importlib.import_module(f'{package}.msg'), name), checked


def recorded_qos(topic: TopicInfo) -> QoSProfile:
    """QoS offered by the first recorded publisher; unknown policies are reliable and volatile."""
    try:
        told = next(iter(qos_profiles(topic.qos)), {})
    except ValueError:
        told = {}
    depth = told.get('depth')
    policies = {name: _policy(kind, told.get(name)) for name, kind in _POLICIES.items()}
    return QoSProfile(
        depth=min(max(depth, 1), _MOST_HELD) if isinstance(depth, int) else 10,
        **{name: policy for name, policy in policies.items() if policy is not None},
    )


def _policy(kind: Any, told: object) -> Any:
    """A policy by name (rosbag2's metadata from version 9 on) or by number (before)."""
    for policy in kind:
        if told in (policy.name.lower(), int(policy)) and policy.name not in (
            'UNKNOWN', 'SYSTEM_DEFAULT', 'BEST_AVAILABLE',
        ):
            return policy
    return None


@dataclass(frozen=True, kw_only=True)
class Portion:
    """Messages recorded at the same time.

    Attributes:
        stamp_ns: time [ns] on the bag's clock.
        messages: in the order of the bag.
    """

    stamp_ns: int
    messages: tuple[StoredMessage, ...]


@dataclass(frozen=True, kw_only=True)
class Window:
    """Time window of a recording, both ends included [ns on the bag's clock]."""

    start_ns: int
    end_ns: int


def open_bag(path: str) -> BagInfo:
    """Open a bag for playback and return its table of contents.

    Raises:
        UsageError: the bag does not exist, is damaged or empty.
    """
    if not path:
        raise UsageError('bag_player: parameter bag is required: -p bag:=FOLDER or FILE.mcap')
    try:
        info = read_info(Path(path))
    except BagError as error:
        raise UsageError(' '.join(str(error).split())) from error
    if not info.complete:
        hint = f'save the intact part: taxinet bag recover {path} --out NEW'
        raise UsageError(f'{info.trouble}; {hint}')
    scenes = [count for name, count in info.counts.items() if is_topic(name, SCENARIO)]
    if info.back_ns > NS_PER_S and max(scenes, default=0) > 1:
        raise UsageError(
            f'{path}: time jumps back by {info.back_ns / NS_PER_S:g} s, so it holds several runs; '
            f'split it with: taxinet bag split {path} --out DIR'
        )
    if not any(info.counts.values()):
        raise UsageError(f'{path}: no messages to play')
    return info


def window(info: BagInfo, start_offset_s: float, duration_s: float) -> Window:
    """The window from ``start_offset_s`` on; a duration of 0 s means to the end.

    Raises:
        UsageError: it starts after the end of the recording.
    """
    start_ns = info.start_ns + round(start_offset_s * NS_PER_S)
    if start_ns > info.end_ns:
        raise UsageError(
            f'bag_player: start_offset is {start_offset_s:g} s; {info.path} is '
            f'{info.duration_s:g} s long'
        )
    end_ns = start_ns + round(duration_s * NS_PER_S) if duration_s else info.end_ns
    return Window(start_ns=start_ns, end_ns=end_ns)


def known_topics(
    info: BagInfo, names: Collection[str], parameter: str, made: Collection[str] = ()
) -> frozenset[str]:
    """Full names of the topics listed in a parameter, with or without leading slash.

    Args:
        info: table of contents of the bag.
        names: value of the parameter.
        parameter: its name.
        made: topics that the player derives from others.

    Raises:
        UsageError: the bag has no such topic.
    """
    recorded = {topic.name for topic in info.topics}
    wanted = frozenset('/' + name.lstrip('/') for name in names if name)
    for name in sorted(wanted - recorded - {*made}):
        frames = name == f'/{IMAGE}'
        known = 'add the frames with taxinet bag render' if frames else (
            f'it has {", ".join(sorted(recorded))}'
        )
        raise UsageError(f'bag_player: {parameter}: {info.path} has no topic {name}; {known}')
    return wanted


def portions(
    path: Path, topics: Collection[str], part: Window, latched: Collection[str], back_ns: int = 0,
) -> Iterator[Portion]:
    """Yield the messages to play, in the order of time, and at equal times in that of the bag.

    Args:
        path: the bag.
        topics: names of the topics to play.
        part: time window.
        latched: topics whose messages from before the window form its first portion.
        back_ns: that of the bag's :class:`BagInfo`.
    """
    messages = _by_time(stored_messages(path, frozenset(topics).__contains__), back_ns)

    def moment(message: StoredMessage) -> int:
        return max(message.stamp_ns, part.start_ns)

    wanted = (
        message for message in messages
        if message.stamp_ns <= part.end_ns
        and (message.stamp_ns >= part.start_ns or message.topic.name in latched)
    )
    for stamp_ns, group in groupby(wanted, moment):
        yield Portion(stamp_ns=stamp_ns, messages=tuple(group))


def _by_time(messages: Iterator[StoredMessage], back_ns: int) -> Iterator[StoredMessage]:
    held: list[tuple[int, int, StoredMessage]] = []
    newest = 0
    for number, message in enumerate(messages):
        heapq.heappush(held, (message.stamp_ns, number, message))
        newest = max(newest, message.stamp_ns)
        while held[0][0] < newest - back_ns:
            yield heapq.heappop(held)[-1]
    while held:
        yield heapq.heappop(held)[-1]


_TICK_S = 0.002
_DELIVERY_S = 5.0
_MOST_AT_ONCE = 8
"""Maximum portions published at once when late: subscribers queue 16 messages per topic."""
USAGE = Usage(
    executable='bag_player',
    does='Plays back a recorded run on its topics, with its clock, at any rate; other nodes run '
    'freely.',
    publishes=('what the bag holds',),
    other='serves ~/pause (std_srvs/srv/SetBool)',
    parameters=(
        Parameter(
            name='bag', default='', takes='a run folder or an .mcap file',
            description='what to play',
        ),
        Parameter(
            name='rate', default=1.0, limits=(0.01, 1000.0),
            description='recorded seconds per wall-clock second',
        ),
        Parameter(
            name='start_offset', default=0.0, limits=(0.0, 1e9),
            description='start offset in the recording [s]; set while it plays, it goes on there',
            settable=True,
        ),
        Parameter(
            name='playback_duration', default=0.0, limits=(0.0, 1e9),
            description='duration to play [s]; 0: to the end',
        ),
        Parameter(
            name='loop', default=False, description='play in a loop until stopped',
        ),
        Parameter(
            name='exclude', default=[''], takes='topic names',
            description='recorded topics to leave out',
        ),
        Parameter(
            name='wait_for', default=[''], takes='topic names',
            description='topics that need a subscriber before the first message is published',
        ),
        Parameter(
            name='wait_timeout', default=30.0, limits=(0.1, 3600.0),
            description='wall-clock timeout for those subscribers [s]',
        ),
    ),
)


class BagPlayer(Node):
    """Node that publishes the messages of a bag when they are due.

    Attributes:
        trouble: one line on why playback failed, or ''.
    """

    def __init__(self, **node: Any) -> None:
        """Read parameters and bag; ``node`` goes to :class:`rclpy.node.Node`.

        Raises:
            UsageError: a parameter or the bag is invalid.
        """
        super().__init__('bag_player', **node)
        self.trouble = ''
        self._declare()
        self._publishers_by_topic = self._speak()
        self._finished: Future | None = None
        self._paused_at: float | None = None
        self._started = False
        self._heard: set[str] = set()
        self._under_way: set[Publisher] = set()
        self._count, self._late_s, self._interrupted = 0, 0.0, False
        self._begun_at = time.monotonic()
        self._rewind()
        self.add_on_set_parameters_callback(self._on_set)
        self.create_service(SetBool, '~/pause', self._on_pause)
        steady = RclClock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(_TICK_S, self._tick, clock=steady)

    def play(self, executor: Any) -> int:
        """Spin until playback ends.

        Returns:
            Exit code: 0, 4 if subscribers are missing, 130 after an interrupt.
        """
        finished = self._finished = Future(executor=executor)
        with interrupts(self._interrupt):
            if self._awaited:
                names = ', '.join(sorted(self._awaited))
                self.get_logger().info(f'waiting for subscribers of {names}')
            spin_until(executor, finished)
        code = int(finished.result())
        return complain(self.trouble, code) if self.trouble else code

    def close(self) -> None:
        """Stop playback."""
        self._timer.cancel()

    # Parameters ------------------------------------------------------------------------------

    def _declare(self) -> None:
        given = declare_all(self, USAGE.parameters)
        refuse_unknown(self)
        self._rate, self._loop = given['rate'], given['loop']
        self._patience_s = given['wait_timeout']
        self._info = open_bag(given['bag'])
        self._duration_s = given['playback_duration']
        self._part = window(self._info, given['start_offset'], self._duration_s)
        made = {place + TF for place in self._without_transforms().values()}
        self._excluded = known_topics(self._info, given['exclude'], 'exclude', made)
        self._awaited = known_topics(self._info, given['wait_for'], 'wait_for')
        for name in sorted(self._awaited & self._excluded):
            raise UsageError(
                f'bag_player: {name} is in both exclude and wait_for; remove it from one'
            )

    def _without_transforms(self) -> dict[str, str]:
        """Odometry topics without ``tf``, as of ``taxinet bag split``: namespace by topic name."""
        recorded = {topic.name for topic in self._info.topics}
        places = {
            topic.name: topic.name.removesuffix(ODOMETRY) for topic in self._info.topics
            if is_topic(topic.name, ODOMETRY) and topic.type == interface.ODOMETRY.type_name
        }
        return {name: place for name, place in places.items() if place + TF not in recorded}

    def _speak(self) -> dict[str, Publisher]:
        """Create publishers by recorded name; topics without a message class are skipped."""
        publishers, self._latched, self._checks = {}, set(), {}
        self._types = {topic.name: topic.type for topic in self._info.topics}
        self._unfit: set[str] = set()
        for topic in self._info.topics:
            if topic.name in self._excluded:
                continue
            found = message_class(topic) if topic.encoding == 'cdr' else None
            if found is None:
                why = 'is not installed' if topic.encoding == 'cdr' else f'in {topic.encoding}'
                self.get_logger().warning(f'skipping {topic.name}: {topic.type or "no type"} {why}')
                continue
            qos = recorded_qos(topic)
            if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                self._latched.add(topic.name)
            kind, self._checks[topic.name] = found
            publishers[topic.name] = self.create_publisher(kind, _relative(topic.name), qos)
        if not publishers:
            raise UsageError(f'bag_player: no playable topics left in {self._info.path} to play')
        self._own_clock = None
        if not {interface.CLOCK.name} & (publishers.keys() | self._excluded):
            clock = interface.CLOCK
            self._own_clock = self.create_publisher(clock.type, clock.name, clock.qos)
        odometry = {topic.name: topic for topic in self._info.topics}
        self._transforms = {
            name: TransformBroadcaster(self, prefix=_relative(place), odometry=odometry[name])
            for name, place in self._without_transforms().items()
            if name in publishers and place + TF not in self._excluded
        }
        return publishers

    # Playing ---------------------------------------------------------------------------------

    def _rewind(self) -> None:
        self._portions = portions(
            self._info.path, self._publishers_by_topic.keys(), self._part, self._latched,
            self._info.back_ns,
        )
        self._next = next(self._portions, None)
        self._origin: float | None = None

    def _interrupt(self) -> None:
        # For a signal handler: the code that it interrupts may hold the lock of the future.
        self._interrupted = True

    def _tick(self) -> None:
        if self._interrupted:
            self._finish(ExitCode.INTERRUPTED)
        if self._finished is None or self._finished.done() or self._paused_at is not None:
            return
        try:
            if self._started or self._may_start():
                self._play_what_is_due()
        except BagError as error:
            self.trouble = ' '.join(str(error).split())
            self._finish(2)

    def _may_start(self) -> bool:
        missing = sorted(
            name for name in self._awaited
            if not self._publishers_by_topic[name].get_subscription_count()
        )
        if missing and time.monotonic() - self._begun_at > self._patience_s:
            self.trouble = (
                f'bag_player: no subscriber on {", ".join(missing)} within '
                f'{self._patience_s:g} s; start it with the same ROS_DOMAIN_ID and discovery range'
            )
            self._finish(ExitCode.INFRA)
        if missing:
            return False
        self._started = True
        seconds = (self._part.end_ns - self._part.start_ns) / NS_PER_S
        self.get_logger().info(
            f'playing {self._info.path}: {len(self._publishers_by_topic)} topics, '
            f'{seconds:g} s at rate {self._rate:g}'
        )
        self._warn_of_rivals()
        return True

    def _warn_of_rivals(self) -> None:
        for name, publisher in self._publishers_by_topic.items():
            shared = name.lstrip('/') == interface.NODE_STATUS.name or is_of_frames(name)
            if not shared and self.count_publishers(publisher.topic_name) > 1:
                self.get_logger().warning(
                    f'{publisher.topic_name} is also published by another node; exclude it, or '
                    f'remap it: -r {_relative(name)}:=recorded{name}'
                )

    def _play_what_is_due(self) -> None:
        for _ in range(_MOST_AT_ONCE):
            if self._next is None:
                self._end()
                return
            now = time.monotonic()
            if self._origin is None:
                self._origin = now
            due = self._origin + (self._next.stamp_ns - self._part.start_ns) / 1e9 / self._rate
            if due > now:
                return
            self._late_s = max(self._late_s, now - due)
            waited = self._publish(self._next)
            self._origin += waited
            self._next = next(self._portions, None)

    def _end(self) -> None:
        if self._loop:
            self._rewind()
            return
        self._deliver(*self._publishers_by_topic.values())
        self.get_logger().info(f'played {self._count} messages, at most {self._late_s:.3f} s late')
        self._finish(0)

    def _publish(self, portion: Portion) -> float:
        """Publish one portion; return the time [s] spent waiting for its delivery.

        Latched messages configure nodes for what follows, and a topic's first message confirms that
        both ends are matched, so nothing may overtake those.
        """
        waited = 0.0
        if self._own_clock is not None:
            self._own_clock.publish(Clock(clock=time_of(portion.stamp_ns)))
        for message in portion.messages:
            name, cdr = message.topic.name, self._checked_bytes(message)
            if cdr is None:
                continue
            latched, first = name in self._latched, name not in self._heard
            if not latched:
                waited += self._deliver(*self._under_way)
                self._under_way.clear()
            publisher = self._publishers_by_topic[name]
            publisher.publish(cdr)
            if name in self._transforms:
                self._transforms[name].follow(message.cdr)
            self._count += 1
            self._heard.add(name)
            if latched:
                # Fast DDS requests acknowledgement every 3 s, so all are awaited together.
                self._under_way.add(publisher)
            elif first:
                waited += self._deliver(publisher)
        return waited

    def _checked_bytes(self, message: StoredMessage) -> bytes | None:
        """What to publish; None, and once a line, for what is no message of the topic's type."""
        name, kind = message.topic.name, self._types[message.topic.name]
        try:
            if message.topic.type == kind:
                return self._checks[name](message.cdr)
            why = f'topic {name}: a {message.topic.type} among {kind}'
        except BagError as error:
            why = str(error)
        if name not in self._unfit:
            self._unfit.add(name)
            self.get_logger().warning(f'skipping messages: {why}')
        return None

    def _deliver(self, *publishers: Publisher) -> float:
        """Wait until reliable subscribers have acknowledged everything, with a time limit.

        Returns:
            The time waited [s].
        """
        begun = time.monotonic()
        for publisher in publishers:
            left = max(0.0, begun + _DELIVERY_S - time.monotonic())
            publisher.wait_for_all_acked(Duration(seconds=left))
        return time.monotonic() - begun

    def _on_pause(self, request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
        if request.data and self._paused_at is None:
            self._paused_at = time.monotonic()
        elif not request.data and self._paused_at is not None:
            if self._origin is not None:
                self._origin += time.monotonic() - self._paused_at
            self._paused_at = None
        answer.success, answer.message = True, 'paused' if request.data else 'playing'
        return answer

    def _on_set(self, parameters: list[Any]) -> SetParametersResult:
        for one in parameters:
            if one.name == 'start_offset':
                try:
                    self._part = window(self._info, one.value, self._duration_s)
                except UsageError as error:
                    return SetParametersResult(successful=False, reason=str(error))
                self._rewind()
        return SetParametersResult(successful=True)

    def _finish(self, code: int) -> None:
        if self._finished is not None and not self._finished.done():
            self._finished.set_result(code)


def _relative(name: str) -> str:
    """Relative name to publish on, so that a namespace can be prepended."""
    return name if name == interface.CLOCK.name else name.lstrip('/')


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros bag_player``."""
    run_node(BagPlayer, BagPlayer.play, usage=USAGE)

if __name__ == '__main__':
    main()
