"""Monitored signals of a recorded run, with its recorded robustness."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from taxinet_ros.bag.errors import BagEmpty, BagError, BagForeign
from taxinet_ros.bag.run.message_values import (
    HeldCommand,
    assumptions_of,
    clearance_in,
    sample_of,
    stamp_of,
    track_of,
)
from taxinet_ros.bag.run.topics import (
    COMMAND,
    ESTIMATE,
    NODE_STATUS,
    ODOMETRY,
    ROBUSTNESS,
    SCENARIO,
    SIMULATOR,
    TRUTH,
    VERDICT,
)
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.mtl import (
    NO_ASSUMPTIONS,
    Assumptions,
    RobustnessInterval,
    Spec,
    parse_spec,
    signal_names,
)
from taxinet_ros.core.mtl.specs import OF_OTHERS
from taxinet_ros.core.pacing.timing import is_free, parse_timing
from taxinet_ros.core.types import NS_PER_S, run_length_ns
from taxinet_ros.core.verdict.run_statistics import EstimateWatch
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.run.recording import Recording

_TOPIC_OF_SIGNAL = {
    'cte': TRUTH, 'he': TRUTH, 'x': ODOMETRY, 'speed': ODOMETRY, 'steering': COMMAND,
    'cte_estimate': ESTIMATE, 'he_estimate': ESTIMATE, 'cte_sigma': ESTIMATE,
    'he_sigma': ESTIMATE, 'estimate_gap': ESTIMATE, 'unusable_share': ESTIMATE,
    'clearance': ODOMETRY, 'collision': ODOMETRY, 'hold_distance': ODOMETRY,
}
"""Topic of each signal of :data:`taxinet_ros.core.mtl.SIGNALS`."""


class RecordedReading(NamedTuple):
    """Newest recorded reading of one formula: stamp of the sample [ns], and interval."""

    stamp_ns: int
    interval: RobustnessInterval


@dataclass(frozen=True, kw_only=True)
class RunSamples:
    """Monitored signals of a run.

    Attributes:
        run: name of the run if the bag has several, else ''.
        duration_ns: requested length of the run [ns].
        period_ns: its control period [ns].
        specs: formulas of the run, as text.
        assumptions: assumptions of the run.
        stamps_ns: stamps of the control steps, ascending [ns].
        samples: signals by name, one mapping per stamp; signals not requested are NaN.
        recorded: recorded readings by formula text (:attr:`~taxinet_ros.core.mtl.Spec.text`).
        stopped_early: the run was stopped early because its verdict was decided.
        unusable_estimates: number of frames without a usable estimate, from the run's verdict.
        trouble: one line about damaged or missing data, or ''.
        note: one line about other content of the recording, or ''.
        there: available topics for each stamp.
        timing: timing of the answers (:mod:`taxinet_ros.core.pacing.timing`); '' for immediate
            ones.
        flaws: one line per defective topic; requirements that read it get no verdict.
    """

    run: str
    duration_ns: int
    specs: tuple[str, ...]
    assumptions: Assumptions
    stamps_ns: tuple[int, ...]
    samples: tuple[Mapping[str, float], ...]
    recorded: Mapping[str, RecordedReading]
    stopped_early: bool
    unusable_estimates: int
    trouble: str
    there: tuple[frozenset[str], ...]
    note: str = ''
    timing: str = ''
    period_ns: int = CONTROL_PERIOD_NS
    flaws: Mapping[str, str] = field(default_factory=dict)

    def seen_by(self, spec: Spec) -> RunSamples:
        """Restrict to the control steps with every topic that a requirement reads."""
        needed = topics_of_signals(signal_names(spec.formula))
        rows = [row for row, topics in enumerate(self.there) if topics >= needed]
        flaws = {topic: line for topic, line in self.flaws.items() if topic in needed}
        if len(rows) == len(self.there) and len(flaws) == len(self.flaws):
            return self
        return dataclasses.replace(
            self, flaws=flaws,
            stamps_ns=tuple(self.stamps_ns[row] for row in rows),
            samples=tuple(self.samples[row] for row in rows),
            there=tuple(self.there[row] for row in rows),
        )


def topics_of_signals(names: Iterable[str]) -> frozenset[str]:
    """Topics of signals, and the truth, which defines the steps."""
    return frozenset((TRUTH, *(_TOPIC_OF_SIGNAL[name] for name in names)))


def same_bits(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two intervals are equal bit for bit."""
    return struct.pack('<2d', *one) == struct.pack('<2d', *other)


_READ = (SCENARIO, NODE_STATUS, TRUTH, ODOMETRY, ESTIMATE, COMMAND, ROBUSTNESS, VERDICT)
_UNREADABLE = (BagError, AttributeError, TypeError, ValueError, ArithmeticError, UsageError)


def run_samples(
    recording: Recording, names: Collection[str] | None = None
) -> list[RunSamples]:
    """Samples of every run in a recording; damage is reported in the result, not raised.

    A requirement uses only control steps with all topics that it reads, as the monitor did during
    the run: see :meth:`RunSamples.seen_by`. Messages are matched by run and header stamp,
    independent of log times. Runs without any step are included only if there are no others.

    Args:
        recording: recording of one or several runs.
        names: required signals; None: those that each run's own formulas read.

    Raises:
        BagEmpty: the bag ends before the scenario of the run.
        BagForeign: not a run of this package.
    """
    path, damage = recording.path, recording.damage
    if all(run.scenario is None for run in recording.runs):
        kind = BagEmpty if damage else BagForeign
        other = '' if damage else '; recordings of others: docs/recordings.md'
        raise kind(f'{path}: no message on {SCENARIO}, so its run is unknown{other}', path=path)
    runs = list(zip(recording.runs, recording, strict=True))
    present = [(run, one) for run, one in runs if not run.absent] or runs
    try:
        found = [
            _of_run(one, names, run='' if len(runs) == 1 else run.name, unclear=run.unclear,
                    trouble=str(damage[0]) if damage else '')
            for run, one in present
        ]
    except _UNREADABLE as error:
        raise BagForeign(f'{path}: not a run of taxinet_ros: {error}', path=path) from error
    notes = [recording.info.unchecked, found[0].note]
    absent = [f'{run.name} ({run.outcome or "judged"})' for run, _ in runs if run.absent]
    if absent and len(present) < len(runs):
        notes.append(f'has the end, but no steps, of these runs: {", ".join(absent)}')
    found[0] = dataclasses.replace(found[0], note='; '.join(filter(None, notes)))
    return found


def _of_run(
    recording: Recording, names: Collection[str] | None, *, run: str, trouble: str, unclear: str
) -> RunSamples:
    """Samples of one run; ``unclear``: why odometry cannot be assigned to a run, or ''."""
    told: dict[str, list[Any]] = {topic: [] for topic in _READ}
    for topic, _, message in recording.messages(_READ):
        told[topic].append(message)
    if not told[SCENARIO]:
        return RunSamples(
            run=run, duration_ns=0, specs=(), assumptions=NO_ASSUMPTIONS, stamps_ns=(), samples=(),
            recorded={}, stopped_early=False, unusable_estimates=0, there=(),
            trouble=f'no message on {SCENARIO}, so its scenario is unknown',
        )
    scenario, timing = told[SCENARIO][0], _timing(told[NODE_STATUS])
    verdict = told[VERDICT][-1] if told[VERDICT] else None
    if names is None:
        specs = [parse_spec(text) for text in scenario.specs]
        names = {name for spec in specs for name in signal_names(spec.formula)}
    topics = sorted(topics_of_signals(names))
    answers = {ESTIMATE, COMMAND} & set(topics) if is_free(timing) else set()
    flaws = dict(filter(None, (_disorder(topic, told[topic]) for topic in topics)))
    steps = {topic: {stamp_of(m): m for m in reversed(told[topic])} for topic in topics}
    stamps = tuple(sorted(steps[TRUTH]))
    # In a free run, missing answers are not lost: the frame was not answered.
    there = tuple(
        frozenset(topic for topic in topics if stamp in steps[topic]) | answers
        for stamp in stamps
    )
    clearance = clearance_in(scenario) if not OF_OTHERS.isdisjoint(names) else None
    commands, track = HeldCommand(scenario, free=is_free(timing)), track_of(scenario)
    period_ns = recording.period_ns
    duration_ns = run_length_ns(float(scenario.duration_s), period_ns)
    watch = EstimateWatch(duration_ns, period_ns)
    samples = []
    for stamp, present in zip(stamps, there, strict=True):
        truth, odometry, estimate, command = (
            steps.get(topic, {}).get(stamp) for topic in (TRUTH, ODOMETRY, ESTIMATE, COMMAND)
        )
        command = commands.at(command)
        samples.append(sample_of(truth, odometry, estimate, command, track, clearance))
        if ESTIMATE in present:
            samples[-1].update(watch.signals(stamp, samples[-1]))
    if stamps and stamps[0] > 0 and not trouble:
        trouble = f'begins at {stamps[0] / NS_PER_S:g} s: earlier steps were not recorded'
    return RunSamples(
        run=run,
        duration_ns=duration_ns,
        specs=tuple(map(str, scenario.specs)),
        assumptions=assumptions_of(scenario),
        stamps_ns=stamps,
        samples=tuple(samples),
        recorded=_readings(verdict.specs if verdict else told[ROBUSTNESS]),
        stopped_early=bool(getattr(verdict, 'stopped_early', False)),
        unusable_estimates=int(getattr(verdict, 'unusable_estimates', 0)),
        trouble=trouble, there=there, timing=timing, period_ns=period_ns,
        note='' if clearance is None or clearance.may_violate(names) else (
            'nothing on the ground could violate a formula about others or hold lines'),
        flaws=_partial({
            topic: steps[topic] for topic in topics if topic not in answers
        }, period_ns)
        | flaws | ({ODOMETRY: unclear} if unclear else {}),
    )


def _timing(reports: Iterable[Any]) -> str:
    words = (str(one.implementation) for one in reports if str(one.node) == SIMULATOR)
    try:
        return parse_timing(next(words, '')).words
    except UsageError:
        return 'unknown timing'


def _disorder(topic: str, messages: Iterable[Any]) -> tuple[str, str] | None:
    """The topic and one line on the first message that comes twice or too late."""
    before: list[int] = []
    for stamp_ns in map(stamp_of, messages):
        if before and stamp_ns <= before[-1]:
            how = 'twice' if stamp_ns in before else f'behind {before[-1] / NS_PER_S:g} s'
            return topic, f'{topic}: {stamp_ns / NS_PER_S:g} s comes {how}'
        before.append(stamp_ns)
    return None


def _partial(steps: Mapping[str, Mapping[int, Any]], period_ns: int) -> dict[str, str]:
    """One line per topic that is missing, begins late, or ends a step or more too early."""
    first_ns, last_ns = min(steps[TRUTH], default=0), max(steps[TRUTH], default=-1)
    found = {}
    for topic, messages in steps.items():
        if not messages and last_ns >= 0:
            found[topic] = f'{topic}: no messages, so formulas that read it are not evaluated'
        elif min(messages, default=0) > first_ns:
            found[topic] = f'{topic}: begins at {min(messages) / NS_PER_S:g} s'
        elif max(messages, default=last_ns) // period_ns < last_ns // period_ns - 1:
            found[topic] = (
                f'{topic}: ends at {max(messages) / NS_PER_S:g} s, '
                f'the run at {last_ns / NS_PER_S:g} s'
            )
    return found


def _readings(messages: Iterable[Any]) -> dict[str, RecordedReading]:
    """The newest reading of each formula."""
    return {
        str(one.formula): RecordedReading(stamp_of(one), RobustnessInterval.of_message(one))
        for one in sorted(messages, key=stamp_of)
    }
