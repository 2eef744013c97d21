"""Checks of a run in a bag: stamps, complete control steps, and the verdict.

The verdict is recomputed from the recorded truth and must match bit for bit.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.check.findings import RERUN, Check, Finding, ranges
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.message_values import (
    reading_values,
    scenario_of,
    stamp_of,
    verdict_values,
)
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.bag.run.samples import RunSamples, same_bits
from taxinet_ros.bag.run.topics import (
    COMMAND,
    ESTIMATE,
    NODE_STATUS,
    ODOMETRY,
    ONCE,
    ROBUSTNESS,
    RUN_ENDED,
    RUN_STATUS,
    SCENARIO,
    SIMULATOR,
    TRUTH,
    VERDICT,
    is_of_sensors,
    is_topic,
)
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, last_step
from taxinet_ros.core.mtl import RobustnessInterval, Spec
from taxinet_ros.core.pacing.timing import is_free
from taxinet_ros.core.sensing import Schedule
from taxinet_ros.core.topics import SENSORS
from taxinet_ros.core.types import NS_PER_S, step_stamp_ns
from taxinet_ros.core.verdict.judge import Judge, Judgement
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError

MOST_STEPS = 100_000
"""Maximum number of steps checked; runs are much shorter."""
_KEPT = (TRUTH, ODOMETRY, ESTIMATE, COMMAND)
_JUDGED = (Outcome.PASS, Outcome.FAIL)


@dataclass
class RunRecord:
    """Data of a run by step, and what is wrong with its messages.

    Attributes:
        once: messages of topics that do not publish in every step, by relative name, in order.
        counts: number of messages by topic name and step.
        robustness: interval by step and formula name.
        wrong: invalid messages by topic name: the first, and their number.
        period_ns: control period of the run [ns].
    """

    once: dict[str, list[Any]] = field(default_factory=dict)
    counts: dict[str, dict[int, int]] = field(default_factory=dict)
    robustness: dict[int, dict[str, RobustnessInterval]] = field(default_factory=dict)
    wrong: dict[str, tuple[str, int]] = field(default_factory=dict)
    period_ns: int = CONTROL_PERIOD_NS
    _latest: dict[str, int] = field(default_factory=dict)

    @property
    def scenario(self) -> Any:
        """The scenario message, or None if this is not a run of taxinet_ros."""
        return next(iter(self.once.get(SCENARIO, ())), None)

    @property
    def free(self) -> bool:
        """Whether it is a free run, in which frames may have no answer."""
        told = self.once.get(NODE_STATUS, ())
        return any(str(m.node) == SIMULATOR and is_free(str(m.implementation)) for m in told)

    @property
    def ending(self) -> Any:
        """The message that reports the end of the run, or None."""
        told = self.once.get(RUN_STATUS, ())
        return next((m for m in told if m.state == RUN_ENDED), None)

    @property
    def judged(self) -> bool:
        """Whether the run ended with a verdict."""
        return self.ending is not None and self.ending.outcome in _JUDGED

    def note(self, stored: StoredMessage) -> None:
        """Add a message."""
        name, stamp = stored.topic.name, stored.stamp_ns
        try:
            self._keep(name, stamp, decode(stored.topic, stored.cdr))
            latest = self._latest.get(name, 0)  # no run begins before 0
            if stamp < latest:
                raise ValueError(f'stamp goes back from {latest} ns')
            self._latest[name] = stamp
        except (BagError, AttributeError, TypeError, ValueError, struct.error) as error:
            first = f'at {stamp / NS_PER_S:.3f} s: {error}'
            before, count = self.wrong.get(name, (first, 0))
            self.wrong[name] = before, count + 1

    def _keep(self, name: str, stamp: int, message: Any) -> None:
        once = next((topic for topic in ONCE if is_topic(name, topic)), None)
        if once is not None:
            _check_fields(once, message)
            if len(told := self.once.setdefault(once, [])) < MOST_STEPS:
                told.append(message)
            return
        step = stamp // self.period_ns
        if not 0 <= step <= MOST_STEPS:
            return
        steps = self.counts.setdefault(name, {})
        steps[step] = steps.get(step, 0) + 1
        header = getattr(message, 'header', None)
        if is_of_sensors(name):
            return  # stamped when it was measured, logged when it arrived
        if header is not None and stamp_of(message) != stamp:
            raise ValueError(f'header stamp is {stamp_of(message)} ns')
        if is_topic(name, ROBUSTNESS):
            reading = RobustnessInterval.of_message(message)
            self.robustness.setdefault(step, {})[str(message.spec)] = reading

    def last_seq(self) -> int:
        """Last control step that must be complete: the last; of an aborted run, the one before.

        In an unfinished free run, only judged steps count, because unanswered frames are settled
        later. -1 if there is none.
        """
        if self.free and not self.judged:
            return max(self.robustness, default=-1)
        if self.ending is None:
            return max((step for steps in self.counts.values() for step in steps), default=0) - 1
        return min(int(self.ending.seq) - (not self.judged), MOST_STEPS)

    def stepped(self, topics: Collection[str]) -> Iterator[tuple[str, int, bool]]:
        """Topics published in every step, their messages per step, and whether steps may lack.

        Args:
            topics: names of the published topics.
        """
        for topic in topics:
            if not (is_of_sensors(topic) or any(is_topic(topic, once) for once in ONCE)):
                number = len(self.scenario.specs) if is_topic(topic, ROBUSTNESS) else 1
                answer = any(is_topic(topic, name) for name in (ESTIMATE, COMMAND))
                yield topic, number, self.free and answer

    def whole_steps(self) -> int:
        """Number of complete control steps."""
        counts = [(self.counts[topic], each) for topic, each, may_lack in self.stepped(self.counts)
                  if not may_lack]
        numbers = {step for steps, _ in counts for step in steps}
        return sum(all(steps.get(step, 0) >= each for steps, each in counts) for step in numbers)


class CheckedRun(NamedTuple):
    """A run of a recording: its name if there are several, its recording, its record."""

    name: str
    recording: Recording
    record: RunRecord


def checked_runs(recording: Recording) -> list[CheckedRun]:
    """Records of all runs in a recording, by their header stamps; damage is skipped.

    The recording itself, with its log times, if it is as the recorder of taxinet_ros logs it.
    """
    if recording.plain or not recording.runs:
        found = [CheckedRun('', recording, RunRecord(period_ns=recording.period_ns))]
        for stored in recording.all_messages():
            found[0].record.note(stored)
        return found
    found = [
        CheckedRun(run.name, one, RunRecord(period_ns=one.period_ns))
        for run, one in zip(recording.runs, recording, strict=True)
    ]
    for number, stored in recording.messages_of_runs(whole=True):
        found[number].record.note(stored)
    return [one for run, one in zip(recording.runs, found, strict=True) if not run.absent]


def check_run(run: CheckedRun) -> tuple[Check, ...]:
    """Check stamps and control steps of a run, and its verdict."""
    _, recording, record = run
    # Topics of a recording that do not belong to a run are not checked.
    topics = record.counts if run.name else [topic.name for topic in recording.topics]
    of = f'{run.name}: ' if run.name else ''
    checks = _check_steps(record, topics, bool(recording.info.damage)), _verdict(record, recording)
    return tuple(replace(check, looked_at=f'{of}{check.looked_at}') for check in checks)


def _check_steps(record: RunRecord, topics: Collection[str], damaged: bool) -> Check:
    """Check that time never goes back and that every control step is complete.

    Args:
        record: record of the run.
        topics: names of the published topics.
        damaged: whether the bag is damaged, so that it may lack the end of the run.
    """
    found = [
        Finding(where=name, what=first + (f', and {count - 1} more' if count > 1 else ''))
        for name, (first, count) in record.wrong.items()
    ]
    truth = any(is_topic(name, TRUTH) for name in record.counts)
    if record.scenario is None:
        if not truth:
            looked_at = 'no taxinet_ros scenario in it'
            return Check(name='lockstep', looked_at=looked_at, findings=tuple(found),
                         skipped=not found)
        what = '0 messages, not 1; nothing tells what was run'
        found.append(Finding(where=SCENARIO, what=what))
        return Check(name='lockstep', looked_at='control steps', findings=tuple(found))
    last = record.last_seq()
    found += _once_troubles(record, damaged)
    if last < 0 and record.ending is None and not truth:
        found.append(Finding(where=f'/{TRUTH}', what='no control steps', fix=RERUN))
    else:
        found += _step_troubles(record, topics, last)
    return Check(
        name='lockstep', looked_at=f'{last + 1} control steps, every topic in each'
        + (_unanswered(record, last) if record.free else '')
        + ('' if record.ending is not None else '; the end of the run is not recorded'),
        findings=tuple(replace(one, fix=RERUN) for one in found),
    )


def _unanswered(record: RunRecord, last: int) -> str:
    answered = {step for name, steps in record.counts.items() if is_topic(name, COMMAND)
                for step in steps}
    return f'; a free run: {last + 1 - len(answered)} without an answer'


def _once_troubles(record: RunRecord, damaged: bool) -> Iterator[Finding]:
    expected = {SCENARIO: 1, RUN_STATUS: 1}
    if record.judged:
        # The simulator reports only in runs whose answers are not immediate.
        told = {str(status.node) for status in record.once.get(NODE_STATUS, ())}
        nodes = {*map(str, record.scenario.participants), *(told & {SIMULATOR})}
        expected |= {VERDICT: 1, NODE_STATUS: len(nodes)}
    for topic, number in expected.items():
        there = len(record.once.get(topic, ()))
        if there > number or (there < number and not damaged):
            why = '; the bag ends before the run does' if topic == RUN_STATUS else ''
            yield Finding(where=topic, what=f'{there} messages, not {number}{why}')


def _step_troubles(
    record: RunRecord, topics: Collection[str], last: int
) -> Iterator[Finding]:
    lacking: dict[str, list[str]] = {}
    for topic, each, may_lack in record.stepped(topics):
        if topic in record.wrong:
            continue
        steps = record.counts.get(topic, {})
        missing = ranges(step for step in range(last + 1) if steps.get(step, 0) < each)
        twice = ranges(step for step, count in steps.items() if count > each)
        if missing and not may_lack:
            lacking.setdefault(missing, []).append(topic)
        if twice:
            yield Finding(where=f'step {twice}', what=f'{topic} more than {each} x')
    yield from _sensor_troubles(record, topics, last)
    for steps_without, names in lacking.items():
        yield Finding(where=f'step {steps_without}', what=f'without {", ".join(names)}')


def _sensor_troubles(
    record: RunRecord, topics: Collection[str], last: int
) -> Iterator[Finding]:
    """Steps whose measurements are not those that the scenario has arrive there."""
    if not any(f'/{one.name}' in topics for one in SENSORS.values()):
        return
    schedule = Schedule(scenario_of(record.scenario), record.period_ns)
    for sensor in schedule.sensors.names:
        name = SENSORS[sensor].name
        topic = f'/{name}'
        steps = record.counts.get(topic, {})
        wrong = ranges(
            step for step in range(last + 1) if steps.get(step, 0) != schedule.counts(step)[name]
        )
        if wrong and topic in topics:
            yield Finding(where=f'step {wrong}', what=f'{topic}: not the measurements due')


def _verdict(record: RunRecord, recording: Recording) -> Check:
    """Check that judging the recorded truth reproduces the recorded robustness bit for bit."""
    if record.scenario is None:
        return Check(name='verdict', looked_at='no taxinet_ros scenario in it', skipped=True)
    steps, found = _verdict_findings(record, recording)
    if not steps and not found:
        return Check(name='verdict', looked_at='no steps to judge', skipped=True)
    return Check(
        name='verdict', looked_at=f'robustness from the recorded truth of {steps} steps, '
        'bit for bit', findings=tuple(replace(one, fix=RERUN) for one in found),
    )


def _check_fields(once: str, message: Any) -> None:
    """Raise AttributeError, TypeError or ValueError if a message lacks required fields.

    The definition comes from the bag, so it may lack them.
    """
    if once == SCENARIO:
        _ = len(message.participants), [str(spec) for spec in message.specs]
    elif once == NODE_STATUS:
        _ = str(message.node), str(message.implementation)
    elif once == RUN_STATUS:
        _ = int(message.state), str(message.outcome), int(message.seq)
    elif once == VERDICT:
        for spec in message.specs:
            _ = str(spec.spec), RobustnessInterval.of_message(spec)


def _verdict_findings(record: RunRecord, recording: Recording) -> tuple[int, list[Finding]]:
    """Judge the recorded samples.

    Returns:
        Number of steps judged, and findings where the result differs from the recorded one.
    """
    try:
        judge = _judge(record)
        samples = _whole(recording.samples, record.last_seq() + 1)
        pairs = zip(samples.stamps_ns, samples.samples, strict=True)
        readings = [judge.push(stamp_ns, sample) for stamp_ns, sample in pairs]
    except (BagError, UsageError, AttributeError, TypeError, ValueError, OverflowError) as error:
        what = str(error).removeprefix(f'{recording.path}: ')
        return 0, [Finding(where=f'/{SCENARIO}', what=f'cannot be judged: {what}')]
    steps, specs = len(readings), Judging.from_message(record.scenario).parsed_specs
    found = []
    for number, spec in enumerate(specs):
        wrong = ranges(
            step for step, now in enumerate(readings)
            if (told := record.robustness.get(step, {}).get(spec.name)) is not None
            and not same_bits(told, now[number].interval)
        )
        if wrong:
            found.append(Finding(
                where=f'step {wrong}', what=f'{spec.name}: the recorded interval differs'))
    if steps <= record.last_seq():
        found.append(Finding(where=f'step {steps}', what='no samples from here on'))
    elif steps and record.ending is not None:
        found += _verdict_troubles(record, specs, judge.judgement)
    return steps, found


def _judge(record: RunRecord) -> Judge:
    """The judge of the recorded run, before its first sample."""
    scene, judging = scenario_of(record.scenario), Judging.from_message(record.scenario)
    return Judge(
        judging.parsed_specs, step_stamp_ns(last_step(scene), scene.period_ns), scene.period_ns,
        judging.stop_on, judging.assumptions, scene.line.half_width_m,
    )


def _whole(samples: RunSamples, most: int) -> RunSamples:
    """Samples of at most ``most`` steps, up to the first that is missing or incomplete."""
    count = next((
        step for step, (stamp_ns, there) in enumerate(
            zip(samples.stamps_ns, samples.there, strict=True))
        if stamp_ns != step_stamp_ns(step, samples.period_ns) or not there.issuperset(_KEPT)
    ), len(samples.stamps_ns))
    count = max(min(count, most), 0)
    return replace(
        samples, stamps_ns=samples.stamps_ns[:count], samples=samples.samples[:count],
        there=samples.there[:count],
    )


def _verdict_troubles(
    record: RunRecord, specs: Sequence[Spec], judgement: Judgement
) -> list[Finding]:
    """Findings where the recorded judgement differs from the one computed here."""
    verdict = next(iter(record.once.get(VERDICT, ())), None)
    if verdict is None:
        return []
    run_id = str(record.scenario.run_id)
    told = {str(one.spec): one for one in verdict.specs}
    texts = []
    for spec, now in zip(specs, judgement.readings, strict=True):
        one = told.pop(spec.name, None)
        ends = _interval(one)
        if ends is None or not same_bits(ends, now.interval):
            words = f'recorded {_words(ends)}, from the truth {_words(now.interval)}'
            texts.append(f'{spec.name}: {words}')
        else:
            values = reading_values(spec, now, run_id, record.last_seq())
            texts += [f'{spec.name}: {text}' for text in _differences(one, values)]
    texts += [
        f'{name}: recorded {_words(_interval(one))}, from the truth {_words(None)}'
        for name, one in told.items()
    ]
    texts += _differences(verdict, verdict_values(judgement, run_id))
    found = [Finding(where=VERDICT, what=text) for text in texts]
    outcome = record.ending.outcome if record.ending is not None else ''
    if outcome in (Outcome.PASS, Outcome.FAIL) and (
        judgement.satisfied is not (outcome == Outcome.PASS)
    ):
        found.append(Finding(where=RUN_STATUS, what=f'{outcome}, which contradicts the truth'))
    return found


def _interval(message: Any) -> RobustnessInterval | None:
    """Interval in a robustness message; None for no message."""
    if message is None:
        return None
    return RobustnessInterval.of_message(message)


def _differences(message: Any, values: dict[str, Any]) -> list[str]:
    """Fields of a message that differ from these values; another recorder's may lack some."""
    return [
        f'{name}: recorded {told!r}, from the messages {value!r}' for name, value in values.items()
        if _exactly(told := getattr(message, name, value)) != _exactly(value)
    ]


def _exactly(value: Any) -> object:
    """A value that equals another of the same bits only; NaN equals NaN."""
    if isinstance(value, float):
        return struct.pack('<d', value)
    # The definition comes from the bag, so it may be anything.
    return value if isinstance(value, bool | int | str) else repr(value)


def _words(interval: RobustnessInterval | None) -> str:
    return 'nothing' if interval is None else f'[{interval.lower:g}, {interval.upper:g}]'
