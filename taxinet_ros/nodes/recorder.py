"""Recorder node: write every recorded topic of a run to one rosbag2-layout MCAP bag.

Messages arrive in any order; they are written step by step in the order of the topic table, so
that equal runs give equal bytes. The bag is flushed after each complete step: a crash loses only
the current step.

Camera frames of failed runs can be added afterwards by re-rendering them from the recording. For a
failed run this costs about as much as recording them, for all other runs nothing. Until then the
bag is complete without them.
"""

from __future__ import annotations

import functools
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.serialization import deserialize_message, serialize_message
from taxinet_msgs.msg import NodeStatus, RunStatus, Scenario, Timing

from taxinet_ros.bag.cdr.alignment import stamp_of_cdr
from taxinet_ros.bag.layout import mcap_path, run_folder
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.bag.run.run_bag import (
    OUTCOME_METADATA,
    bag_name,
    canonical_bytes,
    open_run_bag,
    outcome_words,
)
from taxinet_ros.bag.run.transforms import OdometryTransforms, camera_transform
from taxinet_ros.bag.writer import FREE_RUN_METADATA, BagWriter
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, last_step
from taxinet_ros.core.pacing.free_run import FreeRunAccount
from taxinet_ros.core.pacing.lockstep import reports_progress
from taxinet_ros.core.pacing.timing import is_free
from taxinet_ros.core.verdict.judging import StopOn, parse_stop_on
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraError, InfraKind
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.lockstep.diagnostics import PARAMETER as DIAGNOSTICS
from taxinet_ros.nodes.lockstep.diagnostics import Health
from taxinet_ros.nodes.lockstep.endpoints import publisher_names
from taxinet_ros.nodes.lockstep.late_frames import LateFrames
from taxinet_ros.nodes.lockstep.participant import Participant
from taxinet_ros.nodes.messages.convert import account_of, lost_run_status
from taxinet_ros.nodes.messages.step import FreeProgress, Step, StepCollector
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import (
    Parameter,
    Usage,
    declare_all,
    published_topics,
    refuse_unknown,
    subscribed_topics,
)
from taxinet_ros.trials.options import IMAGES
from taxinet_ros.trials.record.facts import program_attachment

_FAILURES = (Outcome.FAIL, Outcome.INFRA_ERROR)


_REST_LOOK_S = 0.05
_REST_LOOKS, _BROKEN_LOOKS = 70, 5
"""Number of checks without a message after which an aborted or failed run counts as complete.

DDS resends lost messages after 3 s at most.
"""
_DRAINED_LOOKS = 4
"""Number of checks without a message after the simulator has left."""
_DEAF_LOOKS = 80
"""Number of checks (about 4 s) after which a present simulator counts as silent."""
_STEPPED = tuple(topic for topic in interface.TOPICS if topic.each_step)


_TOPICS = (*interface.TOPICS, *interface.TRANSFORMS)
_BAG_NAMES = {topic.name: bag_name(topic) for topic in _TOPICS}
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
USAGE = Usage(
    executable=interface.RECORDER,
    does='Writes one rosbag2 bag per run with all messages, step by step.',
    publishes=published_topics(interface.RECORDER),
    subscribes=subscribed_topics(interface.RECORDER),
    parameters=(*_OPTIONS, DIAGNOSTICS),
)


class Recorder(Participant):
    """Writes one bag per run, ``<out>/<run_id>``, and confirms its completeness at the end."""

    def __init__(self, **node: Any) -> None:
        """Declare parameters and join the graph; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.RECORDER, **node)
        given = declare_all(self, _OPTIONS)
        refuse_unknown(self)
        self._out = Path(given['out'])
        self._min_free = given['min_free'] * 1_000_000
        self._make_out = given['make_out']
        self._images = images = given['images']
        self._late_frames = LateFrames(self, self._on_frame, self._on_frames)
        self._stepped = tuple(
            topic for topic in _STEPPED if images == 'all' or topic is not interface.IMAGE
        )
        self._canonical = canonical_bytes(images == 'all')
        self._transform_of = OdometryTransforms()
        self._writer: BagWriter | None = None
        self._ended: RunStatus | None = None
        self._reports: dict[str, tuple[str, bytes]] = {}
        self._progress = self.speak(interface.PROGRESS)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        await_rest = functools.partial(self._guarded(self._await_rest), None)
        self._rest = self.create_timer(_REST_LOOK_S, await_rest, clock=steady)
        self._rest.cancel()
        for topic in self._stepped:
            self.listen(topic, functools.partial(self._step_message, topic), raw=True)
        self.listen(interface.NODE_STATUS, self._on_status, raw=True)
        self.listen(interface.VERDICT, self._on_verdict, raw=True)
        self.listen(interface.RUN_STATUS, self._on_run_status, raw=True)
        self.listen(interface.TIMING, self._on_timing)
        topic = interface.OBITUARY
        told = self._guarded(self._on_death_notice)
        self.create_subscription(topic.type, topic.name, told, topic.qos)

    def prepare(self, scenario: Scenario) -> None:
        """Open the bag of a run."""
        self._abandon()
        self._scenario_message = scenario
        self._expected = {
            topic.name: len(scenario.specs) if topic.recorded == interface.PER_SPEC else 1
            for topic in self._stepped
        }
        self.clear()
        self._ended = None
        self._written = 0
        self._head_complete = self._free = False
        self._rest_looks = 0
        self._last_seq = last_step(scenario_of(scenario))
        self._stop_on = parse_stop_on(scenario.stop_on)
        self._writer = open_run_bag(
            run_folder(self._out, scenario.run_id), scenario, images=self._images == 'all',
            attachments=program_attachment(scenario.program, self._out),
            min_free_bytes=self._min_free, make_parents=self._make_out,
        )

    def clear(self) -> None:
        """See :class:`Participant`."""
        self._steps = StepCollector(self._expected)
        self._held: list[Step] = []
        self._verdict: bytes | None = None
        self._account: FreeRunAccount | None = None
        self._free_progress = FreeProgress(
            topic for topic in (*self._stepped, interface.TIMING)
            if topic.publishers == (interface.SIMULATOR,)
        )

    def figures(self) -> dict[str, object]:
        """See :class:`Participant`: figures of the current bag and the disk."""
        bag = mcap_path(self._writer.folder) if self._writer is not None else None
        return {
            'bag': str(bag or ''), 'bag size [MB]': bag.stat().st_size / 1e6 if bag else 0.0,
            'steps written': self._written if bag else 0,
            'disk free [MB]': self._free_bytes() / 1e6,
            'disk free, minimum [MB]': self._min_free / 1e6,
        }

    def health(self) -> Health:
        """See :class:`Participant`; also whether there is space for another bag."""
        health, free = super().health(), self._free_bytes()
        if health.level == DiagnosticStatus.OK and free < self._min_free:
            line = f'{self._out}: {free / 1e6:.0f} MB free, min_free is {self._min_free / 1e6:.0f}'
            return replace(health, level=DiagnosticStatus.WARN, message=line)
        return health

    def _free_bytes(self) -> int:
        """Free disk space of the bags' folder, existing or not."""
        there = next((at for at in (self._out, *self._out.parents) if at.is_dir()), Path())
        return shutil.disk_usage(there).free

    def may_leave(self) -> bool:
        """Whether the bag is closed, or its run has gone silent.

        On a busy machine, a present simulator may still report the end of the run.
        """
        self.silent_looks += 1
        closed = self._writer is None and not self._late_frames.under_way
        enough = _DRAINED_LOOKS if self.without_simulator() else _DEAF_LOOKS
        return closed or self.silent_looks > enough

    def close(self) -> None:
        """Finish the bag of an aborted run, without waiting for more messages."""
        ended = self._ended if self._writer is not None else None
        if ended is not None and not Outcome(ended.outcome).judged:
            self._rest_looks = _REST_LOOKS
            self._guarded(lambda _: self._finish_if_whole())(None)
        self._abandon()

    def _abandon(self) -> None:
        """Close an unfinished bag so that it is readable but not marked as complete."""
        self._rest.cancel()
        self._late_frames.cancel()
        if self._writer is not None:
            self._writer.abandon()
            self._writer = None

    # Messages --------------------------------------------------------------------------------

    def _take(self, scenario: Scenario) -> None:
        """See :class:`Participant`; a bag that is played back is not recorded again."""
        others = {*publisher_names(self, interface.SCENARIO)} - {interface.SIMULATOR}
        if not others:
            super()._take(scenario)
        elif self.get_name() in scenario.participants:
            words = f'{", ".join(sorted(others))} publishes {interface.SCENARIO.name} too'
            self.get_logger().warning(f'run {scenario.run_id} is not recorded: {words}')

    def _step_message(self, topic: Topic, cdr: bytes) -> None:
        if self._writer is None:
            return
        seq, off_ns = divmod(stamp_of_cdr(cdr), CONTROL_PERIOD_NS)
        if off_ns:
            what = f'stamped {seq * CONTROL_PERIOD_NS + off_ns} ns, which is not a control step'
            raise InfraError(InfraKind.PROTOCOL, topic.publishers[0], -1, f'{topic.name} {what}')
        self._rest_looks = 0
        whole = self._steps.add(topic.name, seq, cdr)
        if whole:
            self._held += whole
            self._write_steps()
        if self._free_progress.arrived(topic.name, seq):
            self._report_free()

    def _on_timing(self, timing: Timing) -> None:
        """In a free run frames may have no answer, and time does not wait for the recorder."""
        if self._writer is None or timing.run_id != self.run_id:
            return
        if timing.ended:
            self._account = account_of(timing)
            self._finish_if_whole()
            return
        self._held += self._steps.settle(timing)
        self._free_progress.arrived(interface.TIMING.name, timing.seq)
        self._write_steps()
        self._report_free()

    def _report_free(self) -> None:
        now = self._free_progress.news(self._written - 1) if self._free else None
        if now is not None:
            self._progress.publish(self.progress(now[0], now[1] * CONTROL_PERIOD_NS))

    def _on_status(self, cdr: bytes) -> None:
        status = deserialize_message(cdr, NodeStatus)
        if status.state != NodeStatus.READY:
            return
        if status.node in self._ready_for(status.run_id):
            return
        if status.node == self.get_name():
            # The bag's topics contain the one, and frames added later must not change anything
            # else; the other is the bag's place, not its content.
            status.listens, status.detail = [], ''
            cdr = serialize_message(status)
        # Another node may be ready before this one knows of the run.
        self._reports[status.node] = (status.run_id, cdr)
        if self._writer is not None and status.run_id == self.run_id and self._head_known():
            self._write_head()
            self._write_steps()

    def _on_verdict(self, cdr: bytes) -> None:
        message = deserialize_message(cdr, interface.VERDICT.type)
        if self._writer is not None and message.run_id == self.run_id:
            self._verdict = cdr
            self._finish_if_whole()

    def _on_run_status(self, cdr: bytes) -> None:
        self._end(deserialize_message(cdr, RunStatus), cdr)

    def _on_death_notice(self, notice: NodeStatus) -> None:
        if notice.node == interface.SIMULATOR:
            status = lost_run_status(notice)
            self._end(status, serialize_message(status))

    def _end(self, status: RunStatus, cdr: bytes) -> None:
        of_this_run = self._writer is not None and status.run_id == self.run_id
        if of_this_run and status.state == RunStatus.ENDED:
            self._ended, self._ended_cdr = status, cdr
            self._finish_if_whole()

    # Writing ---------------------------------------------------------------------------------

    def _head_known(self) -> bool:
        if not self._head_complete:
            heard = set(self._ready_for(self.run_id))
            speakers = interface.NODE_STATUS.speakers(self._scenario_message.participants)
            self._head_complete = heard == speakers
        return self._head_complete

    def _ready_for(self, run_id: str) -> dict[str, bytes]:
        """READY messages for a run, by node."""
        return {node: cdr for node, (run, cdr) in self._reports.items() if run == run_id}

    def _write_head(self) -> None:
        self._write(interface.SCENARIO, serialize_message(self._scenario_message), 0)
        for node, cdr in sorted(self._ready_for(self.run_id).items()):
            if node == interface.SIMULATOR:
                told = deserialize_message(cdr, NodeStatus)
                self._free = is_free(told.implementation)
                if not (told.implementation or told.detail):
                    continue  # Default timing in the shipped world: nothing to record.
            self._write(interface.NODE_STATUS, cdr, 0)
        camera = scenario_of(self._scenario_message).camera_model
        self._write(interface.TF_STATIC, camera_transform(camera), 0)

    def _write_steps(self) -> None:
        """Write complete steps, once the head of the bag is on disk."""
        if not self._held or not self._head_known():
            return
        for seq, messages in self._held:
            self._write_step(seq, messages)
            self._written += 1
            if not self._free and reports_progress(seq, self._last_seq, self._stop_on):
                self._progress.publish(self.progress(seq, seq * CONTROL_PERIOD_NS))
        self._held.clear()
        self._report_free()

    def _write_step(self, seq: int, messages: dict[str, list[bytes]]) -> None:
        assert self._writer is not None
        for topic in self._stepped:
            for cdr in messages.get(topic.name, ()):
                self._write(topic, cdr, seq * CONTROL_PERIOD_NS)
                if topic is interface.ODOMETRY:
                    self._write(interface.TF, self._transform_of(cdr), seq * CONTROL_PERIOD_NS)
        self._writer.flush()

    def _write(self, topic: Topic, cdr: bytes, stamp_ns: int) -> None:
        assert self._writer is not None
        name = _BAG_NAMES[topic.name]
        self._writer.write(name, self._canonical.message(name, cdr), stamp_ns)

    def report(self, state: int, **what: Any) -> None:
        """See :class:`Participant`; READY says where the bags are, and an own error ends them."""
        if state == NodeStatus.ERROR:
            self.close()
        if state == NodeStatus.READY:
            what['detail'] = str(self._out.resolve())
        super().report(state, **what)

    def _finish_if_whole(self) -> None:
        """Close the bag once the run has ended and the bag is complete."""
        if self._ended is None:
            return
        judged = Outcome(self._ended.outcome).judged
        one_time = self._verdict is not None and (not self._free or self._account is not None)
        if judged and not one_time:
            return
        last_seq = self._ended.seq if self._stop_on is not StopOn.NEVER else self._last_seq
        if judged and not self._written == last_seq + 1 == self._ended.seq + 1:
            raise RuntimeError(f'{self._written} of {last_seq + 1} steps were recorded')
        if not judged:
            if self._is_rest_under_way():
                self._rest.reset()
                return
            self._write_rest()
        stamp_ns = self._ended.seq * CONTROL_PERIOD_NS
        if self._verdict is not None:
            self._write(interface.VERDICT, self._verdict, stamp_ns)
        self._write(interface.RUN_STATUS, self._ended_cdr, stamp_ns)
        writer = self._writer
        assert writer is not None
        writer.add_metadata(OUTCOME_METADATA, outcome_words(self._ended, self._written))
        if self._account is not None:
            writer.add_metadata(FREE_RUN_METADATA, {
                **self._account.to_words(),
                **{name: f'{x:g}' for name, x in self._account.figures().items()},
            })
        writer.close()
        self._writer = None
        if self._images == 'failures' and self._ended.outcome in _FAILURES:
            self._late_frames.begin(writer.folder, self._min_free)
        else:
            self._done()

    def _done(self) -> None:
        """Report that the bag is complete on disk, with the recorded end of the run."""
        assert self._ended is not None
        seq = self._ended.seq
        self.report(
            NodeStatus.DONE, seq=seq, stamp_ns=seq * CONTROL_PERIOD_NS, detail=self._ended.outcome
        )

    def _on_frame(self, seq: int) -> None:
        """Tell the simulator that this node is working."""
        if reports_progress(seq, self._last_seq):
            self._progress.publish(self.progress(seq, seq * CONTROL_PERIOD_NS))

    def _on_frames(self, trouble: str) -> None:
        assert self._ended is not None
        if trouble:
            self.get_logger().error(trouble)
        # An infrastructure error has its own reason to report.
        if trouble and Outcome(self._ended.outcome).judged:
            self.report(NodeStatus.ERROR, detail=trouble)
        else:
            self._done()

    def _is_rest_under_way(self) -> bool:
        """Whether messages from before the end of an aborted run may still be missing.

        They arrive on other topics than the end message, which may overtake them.
        """
        assert self._ended is not None
        whole = self._written + len(self._held)
        begun = whole or self._steps.torn() or self._ended.seq > 0
        if not begun or whole > self._ended.seq:
            return False
        # In a free run, unanswered steps never become complete.
        patient = self._ended.outcome == Outcome.INTERRUPTED and not self._free
        return self._rest_looks < (_REST_LOOKS if patient else _BROKEN_LOOKS)

    def _await_rest(self, _: None) -> None:
        self._rest_looks += 1
        self._rest.cancel()
        self._finish_if_whole()

    def _write_rest(self) -> None:
        """Write the remains of an aborted run: pending steps and the incomplete one."""
        if not self._head_known():
            self._write_head()
        for seq, messages in [*self._held, *self._steps.torn()]:
            self._write_step(seq, messages)
        self._held.clear()


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros recorder``."""
    run_node(Recorder, usage=USAGE)

if __name__ == '__main__':
    main()
