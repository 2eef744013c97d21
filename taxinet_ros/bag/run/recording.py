"""A recorded run, read from its bag in one pass: request, messages and outcome.

``open_recording`` reads bags of taxinet_ros and of ``ros2 bag record``, in any namespace and with
any perception and controller. A bag of several runs is a sequence of recordings::

    recording = open_recording('bags/campaign/s_falsif-s0-00000')
    recording.scenario.heading_rad, recording.facts.outcome
    recording.trace.plot('t_s', 'cte_m')
    for frame in recording.frames():
        frame.image  # recorded, or rendered again if it was not recorded
    recording.judge('always(abs(cte) <= 3)').verdict

    for run in open_recording('rosbag2_2026_11_23'):
        print(run.name, run.facts.outcome)

All messages except images are kept in memory, as bytes, and decoded once. Only camera frames, and
tables of topics outside the run, need another pass.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from taxinet_ros.arguments import FLAG, NONE, TEXT, WHOLE, Kind, takes
from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.errors import BagEmpty, BagError, BagForeign
from taxinet_ros.bag.reader import BagInfo, read_contents, records, stored_messages
from taxinet_ros.bag.run.runs import (
    RunPart,
    RunsWithin,
    messages_of_runs,
    tell_runs_apart,
    topic_parts,
)
from taxinet_ros.bag.run.topics import IMAGE, is_of_frames
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd

    from taxinet_ros.bag.run.facts import RecordedRun, RunFacts
    from taxinet_ros.bag.run.judging import SpecVerdict
    from taxinet_ros.bag.run.samples import RunSamples
    from taxinet_ros.bag.run.trace import CameraFrame, Column
    from taxinet_ros.core.control_step import Observation
    from taxinet_ros.core.mtl import Assumptions, Spec
    from taxinet_ros.core.pacing.free_run import FreeRunAccount
    from taxinet_ros.core.provenance import Provenance
    from taxinet_ros.core.scenario import Scenario

_SPEC = Kind('a tx.Spec', lambda value: bool(value.formula and value.name))
_ASSUMPTIONS = Kind('Assumptions', lambda value: callable(value.about))

_HEAD_OF_A_PICTURE = 64
"""Bytes kept of an image; they contain its stamp."""


class Within(NamedTuple):
    """Position of a single-run recording within a recording."""

    whole: Recording
    number: int


class Decoded(NamedTuple):
    """A message of a run: name of its topic without a namespace, as stored, and its object."""

    relative: str
    stored: StoredMessage
    message: Any


@lru_cache(maxsize=256)
def _bytes_to_keep(topic: str) -> int:
    """Number of bytes kept of each message on a topic, see :func:`.read_contents`."""
    relative = topic_parts(topic)[0]
    if relative == IMAGE:
        return _HEAD_OF_A_PICTURE
    return sys.maxsize if relative or is_of_frames(topic) else 0


def open_recording(path: Path | str) -> Recording:
    """Open a bag of one or several runs; reads its messages in one pass.

    Damage does not raise: intact data are available, see :attr:`Recording.damage`.

    Args:
        path: a bag's folder or an ``.mcap`` file.

    Raises:
        UsageError: ``path`` does not exist or has an unsupported format.
        BagEmpty, BagForeign: an empty bag, or not a ROS 2 bag.
        BagError: the bag cannot be read.
    """
    return Recording(read_contents(Path(path), _bytes_to_keep))


class Recording(Sequence['Recording']):
    """A bag and the runs in it; see :func:`open_recording`.

    As a sequence it contains one recording per run, by number or by name. Members about a single
    run (``run``, ``scenario``, ``facts``, ``trace``, ``samples``, ``frames``, ``judge``) require a
    recording of one run; with several, use them on each item.

    Attributes:
        path: as given.
        name: name of the run if it is one of several, see :class:`.RunPart`; else ''.
        info: the bag's contents: topics, counts, times [ns], metadata, attachments; of one run of
            several, those of the run.
    """

    def __init__(self, info: BagInfo, within: Within | None = None) -> None:
        """``within``: position in a recording of several runs, for one of its runs."""
        self.path = info.path
        self.info = info
        self.name = within.whole.runs[within.number].name if within is not None else ''
        self._within = within
        self._decoded: dict[int, Any] = within.whole._decoded if within is not None else {}

    # ---- the bag -----------------------------------------------------------------------------

    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """Topics in the order of the file."""
        return self.info.topics

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name; the last one if a name is repeated."""
        return self.info.metadata

    @property
    def complete(self) -> bool:
        """Whether the recording was finished and nothing is damaged."""
        return self.info.complete

    @property
    def damage(self) -> tuple[BagError, ...]:
        """All damage: damaged places, then messages that do not match their topic's definition."""
        return (*self.info.damage, *self._apart.broken)

    # ---- its runs ----------------------------------------------------------------------------

    @cached_property
    def _apart(self) -> RunsWithin:
        return tell_runs_apart(self.info, self.decode)

    @property
    def runs(self) -> tuple[RunPart, ...]:
        """Runs in order of first appearance."""
        return self._apart.runs

    @property
    def owners(self) -> Sequence[int]:
        """For each message on a topic of a run, the number of its run, or -1."""
        return self._apart.owners

    @property
    def plain(self) -> bool:
        """Whether it is exactly one run, logged like by the recorder of taxinet_ros."""
        return self._apart.plain

    @cached_property
    def one(self) -> Recording:
        """The recording of its only run, in the recorder's form; itself if it has no run.

        Raises:
            BagForeign: a recording of several runs.
        """
        if self._within is not None:
            return self
        if len(self.runs) > 1:
            first, second = self.runs[:2]
            raise BagForeign(
                f'{self.path}: holds several runs, {first.name} and {second.name}; split it with: '
                f'taxinet bag split {self.path} --out DIR', path=self.path,
            )
        return self if self.plain or not self.runs else self[0]

    @cached_property
    def _messages_by_run(self) -> Sequence[list[StoredMessage]]:
        found: list[list[StoredMessage]] = [[] for _ in self.runs]
        for number, stored in self.messages_of_runs():
            found[number].append(stored)
        return found

    def choose(self, name: str | None) -> RunPart:
        """Select the run of a name; None: the only run.

        Raises:
            UsageError: several runs, or none of that name.
            BagEmpty: no run at all.
        """
        present = [run for run in self.runs if not run.absent] or list(self.runs)
        if name is not None:
            chosen = [run for run in self.runs if name in (run.name, run.run_id)]
            if len(chosen) != 1:
                known = ', '.join(run.name for run in self.runs) or 'none'
                raise UsageError(f'run {name}: no such run in {self.path}; it holds {known}')
            return chosen[0]
        if not present:
            raise self.without_run()
        if len(present) > 1:
            raise UsageError(
                f'{self.path}: holds {len(present)} runs: '
                f'{", ".join(run.words() for run in present)}; choose a run, or split it: '
                f'taxinet bag split {self.path} --out DIR'
            )
        return present[0]

    def without_run(self) -> BagEmpty:
        """Error for a bag without a run, which may be lost by damage."""
        why = f': {self.damage[0]}' if self.damage else ''
        return BagEmpty(f'{self.path}: contains no run of taxinet_ros{why}', path=self.path)

    # ---- its messages ------------------------------------------------------------------------

    def decode(self, stored: StoredMessage) -> Any:
        """Decode a message of :attr:`info`, once; do not change the object.

        Raises:
            BagCorrupt, BagForeign: the message does not match its topic's definition.
        """
        key = id(stored.cdr)  # The bytes are kept in ``info``.
        if key not in self._decoded:
            try:
                self._decoded[key] = decode(stored.topic, stored.cdr)
            except BagError as error:
                text = f'{self.path}: at {stored.stamp_ns} ns: {error}'
                raise type(error)(text, path=self.path) from error
        return self._decoded[key]

    def messages(self, relative: Collection[str]) -> Iterator[Decoded]:
        """Decoded messages of the only run on some topics, in recording order.

        Args:
            relative: names of the topics without a namespace, see :mod:`.topics`.

        Raises:
            BagForeign: a recording of several runs.
            BagCorrupt: a message does not match its topic's definition.
        """
        for stored in self.one.info.messages:
            name = topic_parts(stored.topic.name)[0]
            if name in relative:
                yield Decoded(name, stored, self.decode(stored))

    def check_damage(self) -> None:
        """Raise the first damage of the files, if any."""
        for error in self.info.damage:
            raise error

    def messages_of_runs(
        self, wanted: Callable[[int, str], bool] = lambda run, topic: True, *,
        whole: bool = False,
    ) -> Iterator[tuple[int, StoredMessage]]:
        """Messages of all runs in the recorder's form, each with the number of its run.

        Args:
            wanted: whether a run (by number) needs a topic (by relative name).
            whole: whether to include complete images, which needs another pass.
        """
        messages = self.all_messages() if whole else self.info.messages
        return messages_of_runs(messages, self._apart, wanted)

    def all_messages(self) -> Iterator[StoredMessage]:
        """All intact messages in recording order; images need another pass.

        For one run of several: its messages in the recorder's form.
        """
        if self._within is not None:
            whole, number = self._within
            mine = whole.messages_of_runs(lambda run, _: run == number, whole=True)
            return (stored for _, stored in mine)
        if all(_bytes_to_keep(name) == sys.maxsize for name, n in self.info.counts.items() if n):
            return iter(self.info.messages)
        found = records(BagInfo(path=self.path))
        return (record for record in found
                if isinstance(record, StoredMessage) and record.topic.encoding == 'cdr')

    def whole_messages(self, wanted: Callable[[str], bool]) -> Iterator[StoredMessage]:
        """Complete messages on any topics, including images; needs another pass.

        Raises:
            BagTruncated, BagCorrupt: damage; all messages before it were yielded.
        """
        if self._within is None:
            return stored_messages(self.path, wanted)
        self.check_damage()
        return (stored for stored in self.all_messages() if wanted(stored.topic.name))

    # ---- its runs as recordings ---------------------------------------------------------------

    def __repr__(self) -> str:
        runs = 'damaged' if self.damage else f'{len(self)} run{"s" if len(self) > 1 else ""}'
        return f'<Recording {self.path}{f" {self.name}" if self.name else ""}: {runs}>'

    def __len__(self) -> int:
        return len(self.runs)

    def __iter__(self) -> Iterator[Recording]:
        return (self._of(number) for number in range(len(self.runs)))

    @takes(key=TEXT | WHOLE)
    def __getitem__(self, key: int | str) -> Recording:  # type: ignore[override]  # no slices
        """Recording of one run, by its number, name or id.

        Raises:
            IndexError: no run with that number.
            UsageError: no run, or more than one, with that name.
        """
        if isinstance(key, str):
            return self._of(self.runs.index(self.choose(key)))
        return self._of(range(len(self.runs))[key])

    def _of(self, number: int) -> Recording:
        info = BagInfo(
            path=self.path, metadata=self.info.metadata, damage=self.info.damage,
            unchecked=self.info.unchecked, _trouble=self.info.trouble,
        )
        for stored in self._messages_by_run[number]:
            if stored.topic.name not in info.counts:
                info.note(stored.topic, _bytes_to_keep)
            info.note(stored, lambda topic: sys.maxsize)
        return Recording(info, Within(self, number))

    @cached_property
    def made_on(self) -> Provenance:
        """Processor, libraries and code of the recording; empty if unknown."""
        from taxinet_ros.bag.run.facts import made_on

        return made_on(self.info)

    # ---- the run -----------------------------------------------------------------------------

    @cached_property
    def run(self) -> RecordedRun:
        """Request and participants of the run; sufficient to repeat it.

        Raises:
            BagEmpty, BagTruncated, BagCorrupt: the data are missing or lost.
            BagForeign: not a run of this package, or several runs.
            UsageError: a value of its scenario is out of range.
        """
        from taxinet_ros.bag.run.facts import recorded_run

        return recorded_run(self)

    @property
    def run_id(self) -> str:
        """Name of the run; errors as :attr:`run`."""
        return self.run.request.run_id

    @property
    def scenario(self) -> Scenario:
        """The requested scene, in SI units and radians; errors as :attr:`run`."""
        return self.run.request.scenario

    @cached_property
    def period_ns(self) -> int:
        """Control period of the run [ns]; the usual one where its scenario is not readable."""
        from taxinet_ros.bag.run.facts import recorded_period_ns

        return recorded_period_ns(self)

    @cached_property
    def facts(self) -> RunFacts | None:
        """Recorded facts of the run, skipping damage; None if it is not a run of taxinet_ros.

        Raises:
            BagCorrupt: a message does not match its topic's definition.
            BagForeign: a recording of several runs.
        """
        from taxinet_ros.bag.run.facts import run_facts

        return run_facts(self)

    def check_is(self, run_id: str) -> None:
        """Check that the recording is of the run ``run_id``.

        Raises:
            UsageError: a recording of another run.
            BagError: as :attr:`facts`.
        """
        told = self.facts
        if told is not None and told.run_id != run_id:
            raise UsageError(
                f'{self.path}: is of run {told.run_id}, not of {run_id}; was the folder moved '
                f'here? Check all with taxinet doctor {self.path.parent}'
            )

    @property
    def free_account(self) -> FreeRunAccount | None:
        """Timing record of a free run; None for other runs, or if the bag ends before it.

        Raises:
            BagForeign: an invalid record.
        """
        from taxinet_ros.bag.run.facts import free_account

        return free_account(self.info)

    @cached_property
    def columns(self) -> dict[str, Column]:
        """Numbers of the run, one row per control step with a ground truth.

        Messages are matched by their step (``seq``), odometry by its header stamp, independent of
        log times. Missing values and invalid estimates are NaN.

        Returns:
            Columns of equal length by name: ``seq`` and ``t_ns`` (simulated time) as int64,
            ``est_valid`` as bool, all others as float64: ``x_m`` and ``y_m`` in ``map``,
            ``speed_mps``, true ``cte_m`` and ``he_rad``, estimated ``est_cte_m`` and
            ``est_he_rad`` (left positive), ``steering_rad`` (left positive), ``speed_cmd_mps``,
            and for each formula ``rho_lower.<name>`` and ``rho_upper.<name>``.

        Raises:
            BagEmpty: no ground truth.
            BagError: the bag is damaged or unsupported, or contains several runs.
        """
        from taxinet_ros.bag.run.trace import trace_columns

        return trace_columns(self)

    @property
    def trace(self) -> pd.DataFrame:
        """:attr:`columns` as a table, ``t_s`` [s] first; units are in ``attrs['units']``."""
        from taxinet_ros.core.trace import trace_table

        return trace_table(self.columns)

    @takes(topic=TEXT)
    def table(self, topic: str) -> pd.DataFrame:
        """Messages of one topic, see :meth:`tables`."""
        return next(iter(self.tables([topic]).values()))

    def tables(self, topics: Collection[str] | None = None) -> dict[str, pd.DataFrame]:
        """Messages of topics as tables, by absolute topic name; needs another pass.

        The first columns are ``t_s`` (simulated time [s]) and ``stamp_ns`` (the same, exact).

        Args:
            topics: absolute or relative names, e.g. ``taxi_command``; None: all topics.

        Raises:
            UsageError: a topic is not in the bag.
            BagTruncated, BagCorrupt: the bag is damaged; repair it first.
            BagForeign: a message cannot be decoded.
        """
        from taxinet_ros.bag.run.tables import topic_tables

        return topic_tables(self, topics)

    @property
    def samples(self) -> RunSamples:
        """All monitored signals at each control step.

        Raises:
            BagEmpty, BagForeign: the scenario of the run is missing.
            UsageError: a recording of several runs.
        """
        from taxinet_ros.core.mtl import SIGNALS

        return self.samples_of(SIGNALS)

    def samples_of(self, signals: Collection[str] | None) -> RunSamples:
        """Like :attr:`samples`, for some signals only; None: those that the run's formulas read."""
        from taxinet_ros.bag.run.samples import run_samples

        found = run_samples(self, signals)
        if len(found) > 1:
            self.choose(None)
        return found[0]

    @takes(spec=TEXT | _SPEC, assumptions=NONE | _ASSUMPTIONS, explain=FLAG)
    def judge(
        self, spec: Spec | str, assumptions: Assumptions | None = None, *, explain: bool = False
    ) -> SpecVerdict:
        """Judge the run by any requirement.

        Args:
            spec: the requirement, or its text, e.g. ``phi_always`` or ``always(abs(cte) <= 3)``.
            assumptions: assumptions; None: the recorded ones.
            explain: whether the verdict's ``explanation`` says which clause and sample decide.

        Raises:
            UsageError: an invalid formula, or a recording of several runs.
            BagEmpty, BagForeign: the scenario of the run is missing.
        """
        from taxinet_ros.bag.run.judging import judge_spec
        from taxinet_ros.core.mtl import parse_spec, signal_names

        asked = parse_spec(spec) if isinstance(spec, str) else spec
        samples = self.samples_of(signal_names(asked.formula))
        return judge_spec(samples, asked, assumptions, explained=explain)[0]

    # ---- camera frames -----------------------------------------------------------------------

    @property
    def recorded_steps(self) -> frozenset[int]:
        """Control steps with a recorded camera frame."""
        from taxinet_ros.bag.run.trace import recorded_steps

        return recorded_steps(self)

    @takes(wanted=Kind('a function', callable), render=FLAG)
    def frames(
        self, wanted: Callable[[int], bool] = lambda seq: True, *, render: bool = True
    ) -> Iterator[CameraFrame]:
        """Yield camera frames, (200, 360, 3) uint8 RGB: first recorded, then rendered ones.

        The camera is deterministic, so frames that were not recorded are rendered from the scenario
        and the commands, see :mod:`.resimulation`.

        Args:
            wanted: selects control steps.
            render: whether to render missing frames.

        Raises:
            WorldDiffers: missing frames cannot be reproduced; all others were yielded.
            BagError, UsageError: the bag cannot be read.
        """
        from taxinet_ros.bag.run.trace import camera_frames

        return camera_frames(self, wanted, self.observations if render else None)

    def observations(
        self, wanted: Callable[[int], bool] = lambda seq: True
    ) -> Iterator[Observation]:
        """Re-simulate the world at every recorded control step: states and rendered images.

        Args:
            wanted: selects control steps whose image is rendered; default all.

        Raises:
            WorldDiffers: a state differs from the recorded one; those before were yielded.
            BagError, UsageError: the bag cannot be read, see :attr:`run`.
        """
        from taxinet_ros.bag.run.resimulation import observations

        yield from observations(self, self.run, wanted)
