"""Recorder node: write every recorded topic of a run to one rosbag2-layout MCAP bag.

Camera frames of failed runs can be added afterwards by re-rendering them from the recording. For a
failed run this costs about as much as recording them, for all other runs nothing. Until then the
bag is complete without them.
"""

from __future__ import annotations

import functools
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.serialization import serialize_message
from taxinet_msgs.msg import NodeStatus, Scenario

from taxinet_ros.bag.layout import mcap_path, run_folder
from taxinet_ros.bag.run.live_bag import PATIENT_LOOKS, LiveBag, stepped_topics
from taxinet_ros.bag.writer import free_bytes
from taxinet_ros.core.pacing.lockstep import reports_progress
from taxinet_ros.core.types import step_stamp_ns
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.lockstep.diagnostics import PARAMETER as DIAGNOSTICS
from taxinet_ros.nodes.lockstep.diagnostics import Health
from taxinet_ros.nodes.lockstep.late_frames import LateFrames
from taxinet_ros.nodes.lockstep.participant import Participant
from taxinet_ros.nodes.messages.convert import lost_run_status
from taxinet_ros.nodes.running.domain import publisher_names
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Parameter, Usage, declare_all, refuse_unknown
from taxinet_ros.trials.options import IMAGES
from taxinet_ros.trials.record.facts import program_attachment

_LOOK_S = 0.05  # between looks for messages that may follow the end of an aborted run
_REPORTS_KEPT = 32  # more than all nodes say in one run
_DRAINED_LOOKS, _DEAF_LOOKS = 4, 80
"""Looks without a message after which this node may leave: without and with a simulator."""
_OPTIONS = (
    Parameter(
        name='out', default='bags', takes='a folder',
        description='folder for the bags, one folder per run',
    ),
    Parameter(
        name='min_free', default=1000, limits=(0, 10_000_000),
        description='minimum free disk space to start a bag; below a tenth of it, recording stops '
        '[MB]',
    ),
    Parameter(
        name='make_out', default=True,
        description='whether to create a missing folder',
    ),
    Parameter(
        name='images', default='all', words=IMAGES,
        description='runs whose camera frames are recorded',
    ),
)
USAGE = Usage.of_node(
    interface.RECORDER,
    does='Writes one rosbag2 bag per run with all messages, step by step.',
    parameters=(*_OPTIONS, DIAGNOSTICS),
)


class Recorder(Participant):
    """Writes one bag per run, ``<out>/<run_id>``, and confirms its completeness at the end.

    Attributes:
        bag: the bag under way, if any.
    """

    def __init__(self, **node: Any) -> None:
        """Declare parameters and join the graph; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.RECORDER, **node)
        given = declare_all(self, _OPTIONS)
        refuse_unknown(self)
        self._out = Path(given['out'])
        self._min_free = given['min_free'] * 1_000_000
        self._make_out = given['make_out']
        self._images = given['images']
        self._late_frames = LateFrames(self, self._on_frame, self._on_frames)
        self.bag: LiveBag | None = None
        # Another node may be ready before this one knows of the run.
        self._reports: deque[bytes] = deque(maxlen=_REPORTS_KEPT)
        self._progress = self.speak(interface.PROGRESS)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        look = functools.partial(self._guarded(self._look), None)
        self._rest = self.create_timer(_LOOK_S, look, clock=steady)
        self._rest.cancel()
        stepped = {topic.name for topic in stepped_topics(self._images == 'all')}
        for topic in (
            *(one for one in interface.TOPICS if one.name in stepped),
            interface.NODE_STATUS, interface.VERDICT, interface.RUN_STATUS, interface.TIMING,
        ):
            self.listen(topic, functools.partial(self._record, topic), raw=True)
        topic = interface.OBITUARY
        heard = self._guarded(self._on_death_notice)
        self.create_subscription(topic.type, topic.name, heard, topic.qos)

    def prepare(self, scenario: Scenario) -> None:
        """Open the bag of a run."""
        self._abandon()
        self.bag = LiveBag(
            run_folder(self._out, scenario.run_id), scenario, serialize_message(scenario),
            images=self._images == 'all', min_free_bytes=self._min_free,
            attachments=program_attachment(scenario.program, self._out),
            make_parents=self._make_out,
        )
        for cdr in self._reports:
            self.bag.take(interface.NODE_STATUS, cdr)

    def clear(self) -> None:
        """See :class:`Participant`."""
        if self.bag is not None:
            self.bag.clear()

    def figures(self) -> dict[str, object]:
        """See :class:`Participant`: figures of the current bag and the disk."""
        file = mcap_path(self.bag.folder) if self.bag is not None else None
        return {
            'bag': str(file or ''), 'bag size [MB]': file.stat().st_size / 1e6 if file else 0.0,
            'steps written': self.bag.written if self.bag is not None else 0,
            'disk free [MB]': free_bytes(self._out) / 1e6,
            'disk free, minimum [MB]': self._min_free / 1e6,
        }

    def health(self) -> Health:
        """See :class:`Participant`; also whether there is space for another bag."""
        health, free = super().health(), free_bytes(self._out)
        if health.level == DiagnosticStatus.OK and free < self._min_free:
            line = f'{self._out}: {free / 1e6:.0f} MB free, min_free is {self._min_free / 1e6:.0f}'
            return replace(health, level=DiagnosticStatus.WARN, message=line)
        return health

    def may_leave(self) -> bool:
        """Whether the bag is closed, or its run has gone silent.

        On a busy machine, a present simulator may still report the end of the run.
        """
        self.silent_looks += 1
        closed = self.bag is None and not self._late_frames.under_way
        return closed or self.silent_looks > (
            _DRAINED_LOOKS if self.without_simulator() else _DEAF_LOOKS
        )

    def close(self) -> None:
        """Finish the bag of an aborted run, without waiting for more messages."""
        bag = self.bag
        if bag is not None and bag.broken:
            bag.silent_looks = PATIENT_LOOKS
            self._guarded(lambda _: self._close_if_whole(bag))(None)
        self._abandon()

    def report(self, state: int, **what: Any) -> None:
        """See :class:`Participant`; READY says where the bags are, and an own error ends them."""
        if state == NodeStatus.ERROR:
            self.close()
        if state == NodeStatus.READY:
            what['detail'] = str(self._out.resolve())
        super().report(state, **what)

    def _abandon(self) -> None:
        """Close an unfinished bag so that it is readable but not marked as complete."""
        self._rest.cancel()
        self._late_frames.cancel()
        if self.bag is not None:
            self.bag.abandon()
            self.bag = None

    # Messages --------------------------------------------------------------------------------

    def _take(self, scenario: Scenario) -> None:
        """See :class:`Participant`; a bag that is played back is not recorded again."""
        others = {*publisher_names(self, interface.SCENARIO)} - {interface.SIMULATOR}
        if not others:
            super()._take(scenario)
        elif self.get_name() in scenario.participants:
            words = f'{", ".join(sorted(others))} publishes {interface.SCENARIO.name} too'
            self.get_logger().warning(f'run {scenario.run_id} is not recorded: {words}')

    def _record(self, topic: Topic, cdr: bytes) -> None:
        if topic is interface.NODE_STATUS:
            self._reports.append(cdr)
        bag = self.bag
        if bag is None:
            return
        for seq, arrived in bag.progress(bag.take(topic, cdr)):
            self._progress.publish(self.progress(seq, step_stamp_ns(arrived, bag.period_ns)))
        if not topic.each_step:
            self._close_if_whole(bag)

    def _on_death_notice(self, notice: NodeStatus) -> None:
        if notice.node == interface.SIMULATOR:
            self._record(interface.RUN_STATUS, serialize_message(lost_run_status(notice)))

    # The bag ---------------------------------------------------------------------------------

    def _look(self, _: None) -> None:
        self._rest.cancel()
        if self.bag is not None:
            self.bag.silent_looks += 1
            self._close_if_whole(self.bag)

    def _close_if_whole(self, bag: LiveBag) -> None:
        """Close the bag once the run has ended and the bag is complete."""
        if not bag.is_whole():
            if bag.broken:
                self._rest.reset()
            return
        bag.close()
        self.bag, self._closed = None, bag
        outcome = Outcome(bag.ended.outcome)
        if self._images == 'failures' and outcome in (Outcome.FAIL, Outcome.INFRA_ERROR):
            self._late_frames.begin(bag.folder, self._min_free)
        else:
            self._done()

    def _done(self) -> None:
        """Report that the bag is complete on disk, with the recorded end of the run."""
        ended = self._closed.ended
        stamp_ns = step_stamp_ns(ended.seq, self._closed.period_ns)
        self.report(NodeStatus.DONE, seq=ended.seq, stamp_ns=stamp_ns, detail=ended.outcome)

    def _on_frame(self, seq: int) -> None:
        """Tell the simulator that this node is working."""
        if reports_progress(seq, self._closed.last_seq):
            self._progress.publish(self.progress(seq, step_stamp_ns(seq, self._closed.period_ns)))

    def _on_frames(self, trouble: str) -> None:
        if trouble:
            self.get_logger().error(trouble)
        # An infrastructure error has its own reason to report.
        if trouble and self._closed.judged:
            self.report(NodeStatus.ERROR, detail=trouble)
        else:
            self._done()


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros recorder``."""
    run_node(Recorder, usage=USAGE)

if __name__ == '__main__':
    main()
