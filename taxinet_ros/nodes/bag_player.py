"""Executable ``bag_player``: play back a recorded run on its topics, with its clock, at any rate.

Playback follows the wall clock and waits for no answers; other nodes run freely.
(``taxinet bag replay`` replays a run into one node in lockstep.) Messages are published as stored,
in the order of time; what is not a ROS message of its topic's type is left out with a line.
"""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock as RclClock
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.cdr.image import image_cdr
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.playback import (
    Check,
    Playback,
    Portion,
    known_topics,
    message_check,
    open_bag,
    recorded_quality,
    window,
    without_transforms,
)
from taxinet_ros.bag.run.topics import TF, is_of_frames
from taxinet_ros.core.perception.network import IMAGE_SHAPE, usual_frame
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages.convert import time_of
from taxinet_ros.nodes.messages.step import TransformBroadcaster
from taxinet_ros.nodes.running.node_main import complain, run_node, spin_until
from taxinet_ros.nodes.running.parameters import Parameter, Usage, declare_all, refuse_unknown
from taxinet_ros.processes.interrupts import interrupts
from taxinet_ros.recordings.reader import IMAGES, picture, stamp_of

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
            name='picture', default='', takes='a topic name',
            description='recorded Image of any encoding, or CompressedImage, to publish on '
            'camera/image_raw as rgb8 in the size of our frames',
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
        given = declare_all(self, USAGE.parameters)
        refuse_unknown(self)
        self._loop = given['loop']
        self._patience_s = given['wait_timeout']
        self._info = open_bag(given['bag'])
        self._duration_s = given['playback_duration']
        part = window(self._info, given['start_offset'], self._duration_s)
        made = {place + TF for place in without_transforms(self._info).values()}
        self._excluded = known_topics(self._info, given['exclude'], 'exclude', made)
        self._awaited = known_topics(self._info, given['wait_for'], 'wait_for')
        for name in sorted(self._awaited & self._excluded):
            raise UsageError(
                f'bag_player: {name} is in both exclude and wait_for; remove it from one'
            )
        self._picture = next(iter(
            known_topics(self._info, [given['picture']], 'picture') - self._excluded), '')
        self._checks: dict[str, Check] = {}
        self._latched: set[str] = set()
        self._speakers = self._speak()
        self._finished: Future | None = None
        self._started = self._interrupted = False
        self._heard: set[str] = set()
        self._under_way: set[Publisher] = set()
        self._count = 0
        self._begun_s = time.monotonic()
        self._playback = Playback(
            self._info, part, checks=self._checks, latched=self._latched, rate=given['rate'],
            clock=time.monotonic, on_unfit=lambda line: self.get_logger().warning(line),
        )
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

    def _speak(self) -> dict[str, Publisher]:
        """Create publishers by recorded name; topics without a message class are skipped."""
        publishers = {}
        for topic in self._info.topics:
            if topic.name in self._excluded:
                continue
            check = message_check(topic) if topic.encoding == 'cdr' else None
            if check is None:
                why = 'is not installed' if topic.encoding == 'cdr' else f'in {topic.encoding}'
                self.get_logger().warning(f'skipping {topic.name}: {topic.type or "no type"} {why}')
                continue
            self._checks[topic.name] = check
            quality = recorded_quality(topic)
            if quality.latched:
                self._latched.add(topic.name)
            package, _, name = topic.type.split('/')
            kind, target = getattr(importlib.import_module(f'{package}.msg'), name), topic.name
            if topic.name == self._picture:
                if topic.type not in IMAGES:
                    raise UsageError(f'bag_player: picture: {topic.name} is a {topic.type}')
                self._decode = decoder(topic)
                kind, target = interface.IMAGE.type, interface.IMAGE.name
            publishers[topic.name] = self.create_publisher(
                kind, _relative(target), interface.qos_profile(quality)
            )
        if not publishers:
            raise UsageError(f'bag_player: no playable topics left in {self._info.path} to play')
        clock, self._own_clock = interface.CLOCK, None
        if not {clock.name} & (publishers.keys() | self._excluded):
            self._own_clock = self.create_publisher(clock.type, clock.name, clock.qos)
        self._transforms = {
            name: TransformBroadcaster(
                self, prefix=_relative(place),
                odometry=next(topic for topic in self._info.topics if topic.name == name),
            )
            for name, place in without_transforms(self._info).items()
            if name in publishers and place + TF not in self._excluded
        }
        return publishers

    # Playing ---------------------------------------------------------------------------------

    def _interrupt(self) -> None:
        # For a signal handler: the code that it interrupts may hold the lock of the future.
        self._interrupted = True

    def _finish(self, code: int, trouble: str = '') -> None:
        if self._finished is not None and not self._finished.done():
            self.trouble = trouble
            self._finished.set_result(code)

    def _tick(self) -> None:
        if self._interrupted:
            self._finish(ExitCode.INTERRUPTED)
        if self._finished is None or self._finished.done() or self._playback.paused:
            return
        try:
            if self._started or self._may_start():
                self._play_what_is_due()
        except BagError as error:
            self._finish(ExitCode.USAGE, ' '.join(str(error).split()))

    def _may_start(self) -> bool:
        missing = sorted(
            name for name in self._awaited if not self._speakers[name].get_subscription_count()
        )
        if missing:
            if time.monotonic() - self._begun_s > self._patience_s:
                self._finish(ExitCode.INFRA, (
                    f'bag_player: no subscriber on {", ".join(missing)} within '
                    f'{self._patience_s:g} s; start it with the same ROS_DOMAIN_ID and discovery '
                    'range'
                ))
            return False
        self._started = True
        part = self._playback.part
        seconds = (part.end_ns - part.start_ns) / NS_PER_S
        self.get_logger().info(
            f'playing {self._info.path}: {len(self._speakers)} topics, '
            f'{seconds:g} s at rate {self._playback.rate:g}'
        )
        for name, publisher in self._speakers.items():
            shared = name.lstrip('/') == interface.NODE_STATUS.name or is_of_frames(name)
            if not shared and self.count_publishers(publisher.topic_name) > 1:
                self.get_logger().warning(
                    f'{publisher.topic_name} is also published by another node; exclude it, or '
                    f'remap it: -r {_relative(name)}:=recorded{name}'
                )
        return True

    def _play_what_is_due(self) -> None:
        for _ in range(_MOST_AT_ONCE):
            portion = self._playback.due()
            if portion is not None:
                self._playback.delay(self._publish(portion))
        if self._playback.over and self._loop:
            self._playback.seek(self._playback.part)
        elif self._playback.over:
            self._deliver(*self._speakers.values())
            late_s = self._playback.late_s
            self.get_logger().info(f'played {self._count} messages, at most {late_s:.3f} s late')
            self._finish(ExitCode.OK)

    def _publish(self, portion: Portion) -> float:
        """Publish one portion; return the time [s] spent waiting for its delivery.

        Latched messages configure nodes for what follows, and a topic's first message confirms that
        both ends are matched, so nothing may overtake those.
        """
        waited = 0.0
        if self._own_clock is not None:
            self._own_clock.publish(Clock(clock=time_of(portion.stamp_ns)))
        for message in portion.messages:
            name = message.topic.name
            latched, first = name in self._latched, name not in self._heard
            if not latched:
                waited += self._deliver(*self._under_way)
                self._under_way.clear()
            publisher = self._speakers[name]
            publisher.publish(
                self._as_frame(message.cdr) if name == self._picture else message.cdr)
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

    def _as_frame(self, cdr: bytes) -> bytes:
        """A recorded picture as a frame of ours; black if it cannot be read."""
        message = self._decode(cdr)
        try:
            pixels = usual_frame(picture(message))
        except ValueError as error:
            self.get_logger().warning(f'a black frame: {error}', once=True)
            pixels = np.zeros(IMAGE_SHAPE, np.uint8)
        return image_cdr(pixels, stamp_of(message), message.header.frame_id)

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
        self._playback.pause(request.data)
        answer.success, answer.message = True, 'paused' if request.data else 'playing'
        return answer

    def _on_set(self, parameters: list[Any]) -> SetParametersResult:
        for one in parameters:
            if one.name == 'start_offset':
                try:
                    self._playback.seek(window(self._info, one.value, self._duration_s))
                except UsageError as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _relative(name: str) -> str:
    """Relative name to publish on, so that a namespace can be prepended."""
    return name if name == interface.CLOCK.name else name.lstrip('/')


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros bag_player``."""
    run_node(BagPlayer, BagPlayer.play, usage=USAGE)

if __name__ == '__main__':
    main()
