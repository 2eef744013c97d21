"""The bag of a run whose messages arrive over a graph, in any order and from many topics.

They are written step by step in the order of the topic table, so that equal runs give equal bytes.
The bag is flushed after each complete step: a crash loses only the current step.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.bag.cdr.alignment import Canonical, stamp_of_cdr
from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.run.message_values import account_of, scenario_of
from taxinet_ros.bag.run.messages import header_values, message_cdr
from taxinet_ros.bag.run.run_bag import (
    OUTCOME_METADATA,
    BegunBag,
    bag_name,
    bag_topics,
    outcome_words,
)
from taxinet_ros.bag.run.topics import NODE_READY, RUN_ENDED, topic_info
from taxinet_ros.bag.run.transforms import OdometryTransforms, camera_transform
from taxinet_ros.bag.writer import FREE_RUN_METADATA
from taxinet_ros.core import topics
from taxinet_ros.core.control_step import last_step
from taxinet_ros.core.pacing.free_run import FreeRunAccount
from taxinet_ros.core.pacing.lockstep import reports_progress
from taxinet_ros.core.pacing.step_collector import FreeProgress, Step, StepCollector
from taxinet_ros.core.pacing.timing import is_free
from taxinet_ros.core.sensing import Schedule
from taxinet_ros.core.topics import Topic
from taxinet_ros.core.types import step_stamp_ns
from taxinet_ros.core.verdict.judging import StopOn, parse_stop_on
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraError, InfraKind

PATIENT_LOOKS, BROKEN_LOOKS = 70, 5
"""Number of looks of 0.05 s without a message after which an aborted or failed run is complete.

DDS resends lost messages after 3 s at most.
"""


_DECODED = {
    topic.name: topic_info(topic)
    for topic in (topics.NODE_STATUS, topics.TIMING, topics.VERDICT, topics.RUN_STATUS)
}
_canonical = functools.cache(Canonical)


def stepped_topics(images: bool) -> tuple[Topic, ...]:
    """Topics with messages of control steps, in the order of the bag."""
    return tuple(
        topic for topic in topics.TOPICS
        if topic.each_step and (images or topic not in topics.FRAMES)
    )


class LiveBag(BegunBag):
    """Writes one bag; readable at any time, and marked as complete by :meth:`close`.

    Attributes:
        last_seq: last control step of the run.
        stop_on: when the run ends before that.
        written: number of control steps written.
        free: whether it is a free run.
        ended: last status of the run, once it is known.
        steps: messages of incomplete steps.
        silent_looks: looks since the last message of a step; whoever looks counts them.
    """

    def __init__(
        self, folder: Path, scenario: Any, scenario_cdr: bytes, *, images: bool,
        attachments: Mapping[str, bytes], min_free_bytes: int, make_parents: bool,
    ) -> None:
        """Start the bag as :class:`.BegunBag`; ``scenario_cdr`` is the serialised ``scenario``."""
        scene = scenario_of(scenario)
        self.last_seq, self.period_ns = last_step(scene), scene.period_ns
        self.stop_on = parse_stop_on(scenario.stop_on)
        self.written = self.silent_looks = 0
        self.free = False
        self.ended: Any = None
        self._stepped = stepped_topics(images)
        self._expected = {
            topic.name: len(scenario.specs) if topic.recorded == topics.PER_SPEC else 1
            for topic in self._stepped if topic.recorded != topics.PER_SAMPLE
        }
        self._schedule = Schedule(scene, self.period_ns)
        sensors = scene.sensor_set.names
        sensed = {topics.SENSORS[name] for name in sensors}
        self._sensed = {topic.name for topic in sensed.intersection(self._stepped)}
        self._transform_of = OdometryTransforms()
        self._scenario_cdr, self._cameras = scenario_cdr, scene.cameras
        self._awaited = topics.NODE_STATUS.speakers(scenario.participants)
        self._run_id = scenario.run_id
        self._reports: dict[str, bytes] = {}
        self.clear()
        super().__init__(
            folder, scenario, images=images, sensors=sensors, attachments=attachments,
            min_free_bytes=min_free_bytes, make_parents=make_parents,
        )
        self._canonical = _canonical(bag_topics(images, sensors))

    def clear(self) -> None:
        """Drop steps, verdict and account received so far."""
        self.steps = StepCollector(self._expected, self._measurements if self._sensed else None)
        self._held: list[Step] = []
        self._verdict: bytes | None = None
        self._account: FreeRunAccount | None = None
        self._progress = FreeProgress([
            topic.name for topic in (*self._stepped, topics.TIMING)
            if topic.publishers == (topics.SIMULATOR,) and topic.recorded != topics.PER_SAMPLE
        ])

    def _measurements(self, seq: int) -> dict[str, int]:
        due = self._schedule.counts(seq)
        return {name: due[name] for name in due if name in self._sensed}

    def take(self, topic: Topic, cdr: bytes) -> list[int]:
        """Take a message of any recorded topic; of another run it is ignored.

        Returns:
            Control steps that were written.

        Raises:
            InfraError: it is stamped between two control steps.
            BagCorrupt: it is not a message of its topic's type.
        """
        if topic.each_step:
            self.silent_looks = 0
        if topic.name in self._expected:
            return self._take_step(topic, cdr)
        if topic.recorded == topics.PER_SAMPLE:
            return self._take_sample(topic, cdr)
        message = decode(_DECODED[topic.name], cdr)
        if message.run_id != self._run_id:
            return []
        if topic.name == topics.NODE_STATUS.name:
            return self._take_report(message, cdr) if message.state == NODE_READY else []
        if topic.name == topics.TIMING.name:
            return self._take_timing(message)
        if topic.name == topics.VERDICT.name:
            self._verdict = cdr
        elif topic.name == topics.RUN_STATUS.name and message.state == RUN_ENDED:
            self.ended, self._ended_cdr = message, cdr
        return []

    def _take_step(self, topic: Topic, cdr: bytes) -> list[int]:
        stamp_ns = stamp_of_cdr(cdr)
        seq = stamp_ns // self.period_ns
        if stamp_ns != step_stamp_ns(seq, self.period_ns):
            what = f'stamped {stamp_ns} ns, which is not a control step'
            raise InfraError(InfraKind.PROTOCOL, topic.publishers[0], -1, f'{topic.name} {what}')
        self._progress.arrived(topic.name, seq)
        return self._add(topic, seq, cdr)

    def _take_sample(self, topic: Topic, cdr: bytes) -> list[int]:
        seq = self._schedule.step_of(topic.name, stamp_of_cdr(cdr))
        return self._add(topic, seq, cdr) if topic.name in self._sensed else []

    def _add(self, topic: Topic, seq: int, cdr: bytes) -> list[int]:
        whole = self.steps.add(topic.name, seq, cdr)
        if not whole:
            return []
        self._held += whole
        return self._write_steps()

    def _take_report(self, report: Any, cdr: bytes) -> list[int]:
        """Once all nodes are ready, the bag has its head."""
        node = report.node
        if node in self._reports:
            return []
        if node == topics.RECORDER:
            # Without the bag's topics, which it contains, and its place, which is not its content.
            cdr = message_cdr(topics.NODE_STATUS, {
                'header': header_values(0, ''), 'run_id': self._run_id, 'node': node,
                'state': NODE_READY,
            })
        self._reports[node] = cdr
        if node == topics.SIMULATOR:
            self.free = is_free(report.implementation)
            if not (report.implementation or report.detail):
                self._reports[node] = b''  # default timing in the shipped world: nothing to record
        if not self._has_head:
            return []
        self._write_head()
        return self._write_steps()

    def _take_timing(self, timing: Any) -> list[int]:
        """In a free run frames may have no answer, and time does not wait for the recorder."""
        if timing.ended:
            self._account = account_of(timing)
            return []
        self._held += self.steps.settle(timing.unestimated, timing.uncommanded)
        self._progress.arrived(topics.TIMING.name, timing.seq)
        return self._write_steps()

    def progress(self, written: Iterable[int]) -> Iterator[tuple[int, int]]:
        """Progress to report after ``written``: the last step written, and the last that arrived.

        They differ in a free run, where time does not wait for the recorder.
        """
        if not self.free:
            for seq in written:
                if reports_progress(seq, self.last_seq, self.stop_on):
                    yield seq, seq
        elif (news := self._progress.news(self.written - 1)) is not None:
            yield news

    # The end ------------------------------------------------------------------------------------

    @property
    def judged(self) -> bool:
        """Whether the run has ended with a verdict."""
        return self.ended is not None and Outcome(self.ended.outcome).judged

    @property
    def broken(self) -> bool:
        """Whether the run has ended without a verdict."""
        return self.ended is not None and not self.judged

    def is_whole(self) -> bool:
        """Whether everything has arrived up to the end of the run.

        Messages from before the end of an aborted run arrive on other topics than the end, which
        may overtake them.

        Raises:
            RuntimeError: steps of a judged run are missing.
        """
        if self.ended is None:
            return False
        if self.judged:
            if self._verdict is None or (self.free and self._account is None):
                return False
            last_seq = self.last_seq if self.stop_on is StopOn.NEVER else self.ended.seq
            if not self.written == last_seq + 1 == self.ended.seq + 1:
                raise RuntimeError(f'{self.written} of {last_seq + 1} steps were recorded')
            return True
        whole = self.written + len(self._held)
        begun = whole or self.steps.torn() or self.ended.seq > 0
        if not begun or whole > self.ended.seq:
            return True
        # In a free run, unanswered steps never become complete.
        patient = self.ended.outcome == Outcome.INTERRUPTED and not self.free
        return self.silent_looks >= (PATIENT_LOOKS if patient else BROKEN_LOOKS)

    def close(self) -> None:
        """Write the rest and the end of the run, and mark the bag as complete."""
        if not self.judged:
            if not self._has_head:
                self._write_head()
            for seq, messages in [*self._held, *self.steps.torn()]:
                self._write_step(seq, messages)
        stamp_ns = step_stamp_ns(self.ended.seq, self.period_ns)
        if self._verdict is not None:
            self._write(topics.VERDICT, self._verdict, stamp_ns)
        self._write(topics.RUN_STATUS, self._ended_cdr, stamp_ns)
        self._writer.add_metadata(OUTCOME_METADATA, outcome_words(self.ended, self.written))
        if self._account is not None:
            self._writer.add_metadata(FREE_RUN_METADATA, {
                **self._account.to_words(),
                **{name: f'{x:g}' for name, x in self._account.figures().items()},
            })
        self._writer.close()

    @property
    def _has_head(self) -> bool:
        return self._reports.keys() == self._awaited

    def _write_head(self) -> None:
        self._write(topics.SCENARIO, self._scenario_cdr, 0)
        for _, cdr in sorted(self._reports.items()):
            if cdr:
                self._write(topics.NODE_STATUS, cdr, 0)
        self._write(topics.TF_STATIC, camera_transform(*self._cameras), 0)

    def _write_steps(self) -> list[int]:
        """Write complete steps, once the head of the bag is on disk."""
        if not self._has_head:
            return []
        seqs = [seq for seq, _ in self._held]
        for seq, messages in self._held:
            self._write_step(seq, messages)
        self.written += len(seqs)
        self._held.clear()
        return seqs

    def _write_step(self, seq: int, messages: Mapping[str, list[bytes]]) -> None:
        stamp_ns = step_stamp_ns(seq, self.period_ns)
        for topic in self._stepped:
            for cdr in messages.get(topic.name, ()):
                self._write(topic, cdr, stamp_ns)
                if topic is topics.ODOMETRY:
                    self._write(topics.TF, self._transform_of(cdr), stamp_ns)
        self._writer.flush()

    def _write(self, topic: Topic, cdr: bytes, stamp_ns: int) -> None:
        super()._write(topic, self._canonical.message(bag_name(topic), cdr), stamp_ns)
