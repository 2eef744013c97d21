"""A recorded run, read from its bag in one pass: request, messages and outcome.

``open_recording`` takes bags of our recorder and of ``ros2 bag record``, in any namespace and with
any perception and controller. A bag of several runs is a sequence of recordings::

    recording = open_recording('bags/campaign/s_falsif-s0-00000')
    recording.scenario.heading_rad, recording.facts.outcome
    recording.trace.plot('t_s', 'cte_m')
    for frame in recording.frames():
        frame.image  # as the camera saw it; rendered again where it was not recorded
    recording.judge('always(abs(cte) <= 3)').verdict

    for run in open_recording('rosbag2_2026_11_23'):
        print(run.name, run.facts.outcome)

All messages but the pictures are kept in memory, as bytes; each view decodes what it needs when it
is first asked for. Only camera frames, and tables of others' topics, cost another pass.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from taxinet_ros.arguments import FLAG, TEXT, WHOLE, Kind, takes
from taxinet_ros.bag.reader import Contents, read_contents
from taxinet_ros.bag.run.stored_runs import StoredRuns, Within, kept_bytes
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd

    from taxinet_ros.bag.run.facts import RecordedRun, RunFacts
    from taxinet_ros.bag.run.judging import SpecVerdict
    from taxinet_ros.bag.run.samples import RunSamples
    from taxinet_ros.bag.run.trace import CameraFrame, Column
    from taxinet_ros.core.mtl import Assumptions, Spec
    from taxinet_ros.core.pacing.free_run import FreeRunAccount
    from taxinet_ros.core.provenance import Provenance
    from taxinet_ros.core.scenario import Scenario
    from taxinet_ros.core.world import Observation

_SPEC = Kind('a tx.Spec', lambda value: bool(value.formula and value.name))

def open_recording(path: Path | str) -> Recording:
    """Open a bag, of one run or of several; its messages are read, in one pass.

    Damage is no error here: what is sound is there, see :attr:`Recording.damage`.

    Args:
        path: a bag's folder or an ``.mcap`` file.

    Raises:
        UsageError: there is nothing at ``path``, or a format that is not read.
        BagEmpty, BagForeign: there is nothing in it, or it is no ROS 2 bag.
        BagError: the operating system cannot read it.
    """
    return Recording(read_contents(Path(path), kept_bytes))


class Recording(StoredRuns, Sequence['Recording']):
    """A bag and the runs in it; see :func:`open_recording`.

    As a sequence it has one recording for each run, by number or by name. What tells of *the* run
    (``run``, ``scenario``, ``facts``, ``trace``, ``samples``, ``frames``, ``judge``) is for a
    recording of one; of several, ask each.
    """

    def __len__(self) -> int:
        return len(self.runs)

    def __iter__(self) -> Iterator[Recording]:
        return (self._of(number) for number in range(len(self.runs)))

    @takes(key=TEXT | WHOLE)
    def __getitem__(self, key: int | str) -> Recording:  # type: ignore[override]  # no slices
        """One run of it, by its number, name or id.

        Raises:
            IndexError: there is none of that number.
            UsageError: there is none of that name, or no single one.
        """
        if isinstance(key, str):
            return self._of(self.runs.index(self.choose(key)))
        return self._of(range(len(self.runs))[key])

    def _of(self, number: int) -> Recording:
        messages = self._messages_by_run[number]
        # Where in the bag it is damaged does not show among the messages of one run.
        damage = [(0, error) for error in self.damaged_places]
        contents = Contents(
            self.path, messages=messages, damage=damage, checked=self.checked,
            topics={stored.topic.name: stored.topic for stored in messages},
        )
        return Recording(contents, Within(self, number, self.runs[number]))

    @cached_property
    def made_on(self) -> Provenance:
        """Processor, libraries and code that it was recorded with; empty where it is not told."""
        from taxinet_ros.bag.run.facts import made_on

        return made_on(self.info)

    # ---- the run -----------------------------------------------------------------------------

    @cached_property
    def run(self) -> RecordedRun:
        """What was asked for and who took part: enough to run it once more.

        Raises:
            BagEmpty, BagTruncated, BagCorrupt: the bag does not tell, or no more.
            BagForeign: what it tells is not of this package, or it is of several runs.
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
    def facts(self) -> RunFacts | None:
        """The run as the bag tells of it, damage passed over; None where it is of no run of ours.

        Raises:
            BagCorrupt: a message that tells of the run is not what its topic says.
            BagForeign: it is of several runs.
        """
        from taxinet_ros.bag.run.facts import run_facts

        return run_facts(self)

    def check_is(self, run_id: str) -> None:
        """See that it is the recording of a run, before what it holds is taken for that run's.

        Raises:
            UsageError: it is of another run.
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
        """How a free run went; None where it is none, or the bag ends before it tells.

        Raises:
            BagForeign: what it tells is no such account.
        """
        from taxinet_ros.bag.run.facts import free_account

        return free_account(self.info)

    @cached_property
    def columns(self) -> dict[str, Column]:
        """The numbers of the run, a row for every control step with a ground truth.

        Messages are matched by the step that they name (``seq``), odometry by the stamp in its
        header, whoever logged them when. What is missing is NaN, and so is an estimate that was
        declared invalid.

        Returns:
            Columns of equal length by name: ``seq`` and ``t_ns`` (simulated time) as int64,
            ``est_valid`` as bool, all others as float64: ``x_m`` and ``y_m`` in ``map``,
            ``speed_mps``, true ``cte_m`` and ``he_rad``, estimated ``est_cte_m`` and
            ``est_he_rad`` (left positive), ``steering_rad`` (left positive), ``speed_cmd_mps``,
            and for each formula ``rho_lower.<name>`` and ``rho_upper.<name>``.

        Raises:
            BagEmpty: there is no ground truth.
            BagError: the bag is damaged or foreign, or holds several runs.
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
        """The messages of one topic, see :meth:`tables`."""
        return next(iter(self.tables([topic]).values()))

    def tables(self, topics: Collection[str] | None = None) -> dict[str, pd.DataFrame]:
        """The messages of topics as tables, by absolute topic name; takes a pass.

        Every table has ``t_s`` (simulated time [s]) and ``stamp_ns`` (the same, exact) first.

        Args:
            topics: absolute or relative names, e.g. ``taxi_command``; default all of the bag.

        Raises:
            UsageError: a topic is not in the bag.
            BagTruncated, BagCorrupt: the bag is damaged; mend it first.
            BagForeign: a message cannot be decoded.
        """
        from taxinet_ros.bag.run.tables import topic_tables

        return topic_tables(self, topics)

    @property
    def samples(self) -> RunSamples:
        """The run as a monitor sees it: every signal at each control step.

        Raises:
            BagEmpty, BagForeign: the bag does not tell what was run.
            UsageError: it is of several runs.
        """
        from taxinet_ros.core.mtl import SIGNALS

        return self.samples_of(SIGNALS)

    def samples_of(self, signals: Collection[str] | None) -> RunSamples:
        """:attr:`samples` with some signals only; where None, those that its formulas read."""
        from taxinet_ros.bag.run.samples import run_samples

        found = run_samples(self, signals)
        if len(found) > 1:
            self.choose(None)
        return found[0]

    @takes(spec=TEXT | _SPEC)
    def judge(self, spec: Spec | str, assumptions: Assumptions | None = None) -> SpecVerdict:
        """What the run says of a requirement, whether it was judged by that one then or not.

        Args:
            spec: the requirement, or its text, e.g. ``phi_always`` or ``always(abs(cte) <= 3)``.
            assumptions: what is vouched for; where None, what was then.

        Raises:
            UsageError: the text is no formula, or it is of several runs.
            BagEmpty, BagForeign: the bag does not tell what was run.
        """
        from taxinet_ros.bag.run.judging import judge_spec
        from taxinet_ros.core.mtl import parse_spec, signal_names

        asked = parse_spec(spec) if isinstance(spec, str) else spec
        samples = self.samples_of(signal_names(asked.formula))
        return judge_spec(samples, asked, assumptions)[0]

    # ---- what the camera saw -----------------------------------------------------------------

    @property
    def recorded_steps(self) -> frozenset[int]:
        """The control steps whose camera frame was recorded."""
        from taxinet_ros.bag.run.trace import recorded_steps

        return recorded_steps(self)

    @takes(wanted=Kind('a function', callable), render=FLAG)
    def frames(
        self, wanted: Callable[[int], bool] = lambda seq: True, *, render: bool = True
    ) -> Iterator[CameraFrame]:
        """Camera frames, (200, 360, 3) uint8 RGB: first those recorded, then the others rendered.

        The camera is deterministic, so a frame that was not recorded follows from the scenario and
        the commands, see :mod:`.resimulation`.

        Args:
            wanted: of which control steps.
            render: whether to render those that were not recorded.

        Raises:
            WorldDiffers: those that lack cannot be had again; all others were yielded.
            BagError, UsageError: the bag cannot be read.
        """
        from taxinet_ros.bag.run.trace import camera_frames

        return camera_frames(self, wanted, self.observations if render else None)

    def observations(
        self, wanted: Callable[[int], bool] = lambda seq: True
    ) -> Iterator[Observation]:
        """The world at every recorded control step once more: states, and pictures rendered anew.

        Args:
            wanted: whether the picture of a control step is to be made; the default makes all.

        Raises:
            WorldDiffers: a state does not come out as recorded; those before were yielded.
            BagError, UsageError: the bag cannot be read, see :attr:`run`.
        """
        from taxinet_ros.bag.run.resimulation import observations

        yield from observations(self, self.run, wanted)
