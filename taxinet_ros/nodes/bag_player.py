"""Executable ``bag_player``: play back a recorded run on its topics, with its clock, at any rate.

Playback follows the wall clock and waits for no answers; other nodes run freely.
(``taxinet bag replay`` replays a run into one node in lockstep.) Messages are published as stored,
in the order of time; what is not a ROS message of its topic's type is left out with a line.
"""

from __future__ import annotations

import time
from typing import Any

from rclpy.clock import Clock as RclClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.playback import Playback, known_topics, open_bag, window
from taxinet_ros.bag.run.topics import is_of_frames
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages.recorded import RecordedTopics, relative
from taxinet_ros.nodes.running.node_main import complain, run_node, spin_until
from taxinet_ros.nodes.running.parameters import Parameter, Usage, declare_all, refuse_unknown
from taxinet_ros.processes.interrupts import interrupts

_TICK_S = 0.002
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
            description='start offset in the recording [s]',
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
        part = window(self._info, given['start_offset'], given['playback_duration'])
        excluded = known_topics(self._info, given['exclude'], 'exclude')
        self._awaited = known_topics(self._info, given['wait_for'], 'wait_for')
        for name in sorted(self._awaited & excluded):
            raise UsageError(
                f'bag_player: {name} is in both exclude and wait_for; remove it from one'
            )
        picture = known_topics(self._info, [given['picture']], 'picture') - excluded
        self._topics = RecordedTopics(
            self, self._info, excluded=excluded, picture=next(iter(picture), '')
        )
        self._finished: Future | None = None
        self._started = self._interrupted = False
        self._begun_s = time.monotonic()
        self._playback = Playback(
            self._info, part, checks=self._topics.checks, latched=self._topics.latched,
            rate=given['rate'], clock=time.monotonic,
            on_unfit=lambda line: self.get_logger().warning(line),
        )
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
        publishers = self._topics.publishers
        missing = sorted(
            name for name in self._awaited if not publishers[name].get_subscription_count()
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
            f'playing {self._info.path}: {len(publishers)} topics, '
            f'{seconds:g} s at rate {self._playback.rate:g}'
        )
        for name, publisher in publishers.items():
            shared = name.lstrip('/') == interface.NODE_STATUS.name or is_of_frames(name)
            if not shared and self.count_publishers(publisher.topic_name) > 1:
                self.get_logger().warning(
                    f'{publisher.topic_name} is also published by another node; exclude it, or '
                    f'remap it: -r {relative(name)}:=recorded{name}'
                )
        return True

    def _play_what_is_due(self) -> None:
        for _ in range(_MOST_AT_ONCE):
            portion = self._playback.due()
            if portion is not None:
                self._playback.delay(self._topics.publish(portion))
        if self._playback.over and self._loop:
            self._playback.begin()
        elif self._playback.over:
            self._topics.deliver()
            self.get_logger().info(
                f'played {self._topics.count} messages, at most {self._playback.late_s:.3f} s late'
            )
            self._finish(ExitCode.OK)

    def _on_pause(self, request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
        self._playback.pause(request.data)
        answer.success, answer.message = True, 'paused' if request.data else 'playing'
        return answer


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros bag_player``."""
    run_node(BagPlayer, BagPlayer.play, usage=USAGE)

if __name__ == '__main__':
    main()
