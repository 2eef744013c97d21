"""Monitored signals of a recorded run, with its recorded robustness."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign
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
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.core.clearance import Clearance
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
from taxinet_ros.core.place.track import Track
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.verdict.run_statistics import EstimateWatch
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.run.recording import Recording

_TOPIC_OF_SIGNAL = {
    'cte': TRUTH, 'he': TRUTH, 'x': ODOMETRY, 'speed': ODOMETRY, 'steering': COMMAND,
    'cte_estimate': ESTIMATE, 'he_estimate': ESTIMATE, 'estimate_gap': ESTIMATE,
    'unusable_share': ESTIMATE, 'clearance': ODOMETRY, 'collision': ODOMETRY,
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
    path = recording.path
    trouble = [str(error) for error in recording.damage]
    readers = [_SamplesReader(recording, names) for _ in recording.runs]
    if all(run.scenario is None for run in recording.runs):
        kind = BagEmpty if trouble else BagForeign
        raise kind(f'{path}: no message on {SCENARIO}, so its run is unknown', path=path)
    try:
        # The scenario determines the required signals; a recorder that joined late may have
        # received it last.
        for reader, run in zip(readers, recording.runs, strict=True):
            if run.scenario is not None:
                reader.note(SCENARIO, run.scenario)
        for number, stored in recording.messages_of_runs(
            lambda number, topic: topic != SCENARIO and readers[number].wants(topic)
        ):
            try:
                readers[number].note(stored.topic.name.removeprefix('/'), stored)
            except BagCorrupt as error:
                trouble.append(str(error))
    except _UNREADABLE as error:
        raise BagForeign(f'{path}: not a run of taxinet_ros: {error}', path=path) from error
    alone = len(recording.runs) == 1
    pairs = list(zip(recording.runs, readers, strict=True))
    present = [pair for pair in pairs if not pair[0].absent] or pairs
    found = [
        _samples(path, reader, '' if alone else run.name, trouble[0] if trouble else '',
                 run.unclear)
        for run, reader in present
    ]
    notes = [recording.info.unchecked, found[0].note]
    absent = [f'{run.name} ({run.outcome or "judged"})' for run in recording.runs if run.absent]
    if absent and len(present) < len(pairs):
        notes.append(f'has the end, but no steps, of these runs: {", ".join(absent)}')
    found[0] = dataclasses.replace(found[0], note='; '.join(filter(None, notes)))
    return found


def _samples(
    path: Path, reader: _SamplesReader, run: str, trouble: str, unclear: str = ''
) -> RunSamples:
    if reader.scenario is None:
        return RunSamples(
            run=run, duration_ns=0, specs=(), assumptions=NO_ASSUMPTIONS, stamps_ns=(), samples=(),
            recorded={}, stopped_early=False, unusable_estimates=0, there=(),
            trouble=f'no message on {SCENARIO}, so its scenario is unknown',
        )
    try:
        return reader.run(run, trouble, unclear)
    except _UNREADABLE as error:
        raise BagForeign(f'{path}: not a run of taxinet_ros: {error}', path=path) from error


def _timing(words: str) -> str:
    try:
        return parse_timing(words).words
    except UsageError:
        return 'unknown timing'


@dataclass
class _SamplesReader:
    """Collects samples from the messages of a run."""

    recording: Recording
    names: Collection[str] | None
    scenario: Any = None
    assumptions: Assumptions = NO_ASSUMPTIONS
    steps: dict[str, dict[int, Any]] = field(default_factory=dict)
    verdict: Any = None
    last: list[StoredMessage] = field(default_factory=list)
    flaws: dict[str, str] = field(default_factory=dict)
    timing: str = ''

    @property
    def free(self) -> bool:
        """Whether it is a free run."""
        return is_free(self.timing)

    def __post_init__(self) -> None:
        self._plan(self.names or ())

    def wants(self, relative: str) -> bool:
        """Whether a topic is required; the run's own formulas may add topics."""
        return relative in self._wanted

    def note(self, relative: str, stored: StoredMessage) -> None:
        """Process a message."""
        if relative == ROBUSTNESS:
            # Decoded only if there is no verdict, which contains the last ones.
            if self.last and self.last[0].stamp_ns < stored.stamp_ns:
                self.last.clear()
            self.last.append(stored)
            return
        message = self.recording.decode(stored)
        if relative == NODE_STATUS:
            if str(message.node) == SIMULATOR:
                self.timing = self.timing or _timing(str(message.implementation))
            return
        if relative == SCENARIO:
            self.scenario = message
            self.assumptions = assumptions_of(message)
            if self.names is None:
                specs = [parse_spec(text) for text in message.specs]
                self._plan({name for spec in specs for name in signal_names(spec.formula)})
        elif relative == VERDICT:
            self.verdict = message
        else:
            self._keep(relative, stamp_of(message), message)

    def _keep(self, relative: str, stamp_ns: int, message: Any) -> None:
        steps = self.steps[relative]
        latest_ns = next(reversed(steps), -1)
        if stamp_ns <= latest_ns:
            how = 'comes twice' if stamp_ns in steps else f'comes behind {latest_ns / NS_PER_S:g} s'
            self.flaws.setdefault(relative, f'{relative}: {stamp_ns / NS_PER_S:g} s {how}')
        steps.setdefault(stamp_ns, message)

    def run(self, run: str, trouble: str, unclear: str) -> RunSamples:
        """Return the samples; ``unclear``: why odometry cannot be assigned to a run, or ''."""
        stamps = tuple(sorted(self.steps[TRUTH]))
        there = tuple(
            frozenset(topic for topic, messages in self.steps.items() if stamp in messages)
            for stamp in stamps
        )
        duration_ns = round(float(self.scenario.duration_s) * NS_PER_S)
        watch = EstimateWatch(duration_ns, CONTROL_PERIOD_NS)
        commands = HeldCommand(self.scenario, free=self.free)
        track = track_of(self.scenario)
        clearance = clearance_in(self.scenario) if self._reads_others else None
        samples = [self._sample(stamp, commands, track, clearance) for stamp in stamps]
        if self.free:  # Missing answers are not lost: the frame was not answered.
            there = tuple(topics | ({ESTIMATE, COMMAND} & self.steps.keys()) for topics in there)
        if ESTIMATE in self.steps:
            for stamp, sample, topics in zip(stamps, samples, there, strict=True):
                if ESTIMATE in topics:
                    sample.update(watch.signals(stamp, sample))
        begins_ns = min(self.steps[TRUTH], default=0)
        if begins_ns > 0 and not trouble:
            trouble = f'begins at {begins_ns / NS_PER_S:g} s: earlier steps were not recorded'
        return RunSamples(
            run=run,
            duration_ns=duration_ns,
            specs=tuple(map(str, self.scenario.specs)),
            assumptions=self.assumptions,
            stamps_ns=stamps,
            samples=tuple(samples),
            recorded=self._recorded(),
            stopped_early=bool(getattr(self.verdict, 'stopped_early', False)),
            unusable_estimates=int(getattr(self.verdict, 'unusable_estimates', 0)),
            trouble=trouble, there=there, timing=self.timing,
            note=self._note(clearance),
            flaws=self._partial() | self.flaws | ({ODOMETRY: unclear} if unclear else {}),
        )

    def _note(self, clearance: Clearance | None) -> str:
        if clearance is None or clearance.anybody:
            return ''
        return 'nobody is on the ground, so nothing could violate a formula about others'

    def _partial(self) -> dict[str, str]:
        """One line per topic that is missing, begins late, or ends a step or more too early."""
        last_ns = max(self.steps[TRUTH], default=-1)
        found = {}
        for topic, messages in self.steps.items():
            if self.free and topic in (ESTIMATE, COMMAND):
                continue
            if not messages and last_ns >= 0:
                found[topic] = f'{topic}: no messages, so formulas that read it are not evaluated'
            elif min(messages, default=0) > min(self.steps[TRUTH], default=0):
                found[topic] = f'{topic}: begins at {min(messages) / NS_PER_S:g} s'
            elif max(messages, default=last_ns) < last_ns - CONTROL_PERIOD_NS:
                found[topic] = (
                    f'{topic}: ends at {max(messages) / NS_PER_S:g} s, '
                    f'the run at {last_ns / NS_PER_S:g} s'
                )
        return found

    def _plan(self, names: Collection[str]) -> None:
        self._reads_others = not OF_OTHERS.isdisjoint(names)
        self.steps = {
            topic: self.steps.get(topic, {}) for topic in sorted(topics_of_signals(names))
        }
        self._wanted = {SCENARIO, NODE_STATUS, VERDICT, ROBUSTNESS, *self.steps}

    def _sample(
        self, stamp_ns: int, commands: HeldCommand, track: Track | None,
        clearance: Clearance | None,
    ) -> dict[str, float]:
        truth, odometry, estimate, command = (
            self.steps.get(topic, {}).get(stamp_ns)
            for topic in (TRUTH, ODOMETRY, ESTIMATE, COMMAND)
        )
        assert truth is not None
        command = commands.at(command)
        return sample_of(truth, odometry, estimate, command, track, clearance)

    def _recorded(self) -> dict[str, RecordedReading]:
        if self.verdict is not None:
            told = list(self.verdict.specs)
        else:
            told = [self.recording.decode(stored) for stored in self.last]
        return {
            str(one.formula): RecordedReading(
                stamp_of(one), RobustnessInterval(float(one.rho_lower), float(one.rho_upper))
            )
            for one in told
        }

