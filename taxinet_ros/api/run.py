"""Single runs in this process, rendering of a scene, and robustness of a trace; without ROS.

A run here is the bit-exact reference for the ROS graph: the same scenario, network, controller and
requirements give the same trace, frames and robustness in both.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import os
import re
import tempfile
import warnings
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, overload

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.arguments import (
    FINITE,
    FLAG,
    NUMBER,
    PATH,
    TABLE,
    TEXT,
    TEXTS,
    WHOLE,
    WORD,
    Kind,
    a,
    has_parameter,
    takes,
    told,
)
from taxinet_ros.bag.run.run_bag import NodeWords, RunEnding, node_words, write_run
from taxinet_ros.core import topics
from taxinet_ros.core.assurance.switch import Assured, make_controller
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.faults import unseen_faults
from taxinet_ros.core.loop import LateCommands, Step, run_closed_loop
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.motion.controller import (
    STEERING,
    Controller,
    SteeringGains,
    SteeringLaw,
    UserController,
    read_command,
)
from taxinet_ros.core.motion.hold_short import HoldShort
from taxinet_ros.core.mtl import check_read, offline, signal_names
from taxinet_ros.core.mtl.explain import Explanation, explain_trace
from taxinet_ros.core.mtl.interval import RobustnessInterval
from taxinet_ros.core.mtl.lexer import RESERVED
from taxinet_ros.core.mtl.specs import SHIPPED, SIGNALS, Spec, parse_spec
from taxinet_ros.core.pacing.timing import Timing, parse_latency
from taxinet_ros.core.perception.perception import (
    GroundTruth,
    NetworkPerception,
    Perception,
    UserPerception,
    make_perception,
    network_doubts,
    read_estimate,
)
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.topics import PARTICIPANTS
from taxinet_ros.core.trace import (
    COLUMN_UNITS,
    columns_of_steps,
    source_column,
    trace_signals,
    trace_table,
)
from taxinet_ros.core.types import NO_ESTIMATE, NS_PER_S, AircraftState, TaxiCommand, TrackingError
from taxinet_ros.core.units import dimension_of, si_unit
from taxinet_ros.core.user_code import IMPLEMENTATION, given_sensors
from taxinet_ros.core.verdict.judge import Judgement, check_others, check_specs
from taxinet_ros.core.verdict.judging import Judging, parse_stop_on
from taxinet_ros.core.verdict.outcome import NOT_JUDGED, Outcome, RunRequest, outcome_of
from taxinet_ros.core.verdict.run_statistics import RunStatistics
from taxinet_ros.core.world import ChosenWorld, find_world
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.files.pages import html_table
from taxinet_ros.registry import KMWH
from taxinet_ros.trials.requirements import DEFAULT_SPECS, read_specs

if TYPE_CHECKING:
    import pandas as pd

    from taxinet_ros.api.plots import Plot
    from taxinet_ros.core.fork import Fork

CALLER = 3
"""Stack level of the caller for warnings, past the frames that check arguments."""
_MOST_S = 1e9
NOTHING: Mapping[str, Any] = MappingProxyType({})
_DRAWS = 0, 0
"""Default seed and index for drawing the latencies of a run."""
_SCENARIO = a('a tx.Scenario', Scenario)
_POSE = Kind(
    'None, (x_m, cte_m, he_rad) as finite numbers, or a tx.AircraftState of them',
    lambda pose: pose is None or all(map(FINITE.has, dataclasses.astuple(pose)))
    if pose is None or isinstance(pose, AircraftState)
    else isinstance(pose, tuple | list | np.ndarray) and len(pose) == 3
    and all(map(FINITE.has, pose)),
)
Frame = NDArray[np.uint8]
Look = Callable[[Any], Any]
"""A frame, (200, 360, 3) uint8 RGB, in; ``(cte_m, he_rad)`` or None out. With an attribute
``needs_image = False`` it gets the true :class:`TrackingError` instead."""
Steer = Callable[[TrackingError], Any]
"""An estimate in; ``(steering_rad, speed_mps)`` or a :class:`TaxiCommand` out."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Run:
    """A finished closed-loop run.

    Attributes:
        scenario: initial condition and environment.
        perception: name of the perception; ``python`` for a function.
        fingerprint: SHA-256 of its weights or file; '' for the truth and for a given function.
        judging: requirements, stop rule and assumptions that decided its outcome.
        timing: when answers took effect.
        steps: control steps, without their frames.
        judgement: final judgement.
        world: world of the run.
        nodes: status texts that perception, controller and world would report as ROS nodes.
        draws: seed and index of the run, which determine random latencies.
        fork_of: what it was forked from, see :func:`taxinet_ros.fork`; None for other runs.
    """

    scenario: Scenario
    perception: str
    fingerprint: str
    judging: Judging
    timing: Timing
    steps: tuple[Step, ...]
    judgement: Judgement = field(repr=False)
    world: ChosenWorld = field(repr=False)
    nodes: tuple[NodeWords, ...] = field(repr=False)
    draws: tuple[int, int] = _DRAWS
    fork_of: Fork | None = None

    @cached_property
    def specs(self) -> tuple[Spec, ...]:
        """The requirements, the headline first."""
        return self.judging.parsed_specs

    @property
    def outcome(self) -> Outcome:
        """PASS or FAIL; INFRA_ERROR if a sample could not be judged, see :attr:`detail`."""
        return outcome_of(self.judgement)

    @cached_property
    def detail(self) -> str:
        """One-line reason why the run could not be judged; '' if it was."""
        return '' if self.outcome.judged else self._why_not_judged()

    @cached_property
    def rho(self) -> Mapping[str, RobustnessInterval]:
        """Robustness by the name of the requirement, in the unit of the predicate that decides.

        > 0 satisfies it. The ends of an interval differ only if the run was stopped early or could
        not be judged.
        """
        readings = zip(self.specs, self.judgement.readings, strict=True)
        return {spec.name: reading.interval for spec, reading in readings}

    @property
    def stopped_early(self) -> bool:
        """Whether the run stopped before its horizon because its verdict was decided."""
        return self.judgement.stopped_early

    @property
    def statistics(self) -> RunStatistics:
        """Deviation, settling time and estimation errors."""
        return self.judgement.statistics

    @property
    def trace(self) -> pd.DataFrame:
        """A row for each control step; units are in ``trace.attrs['units']``.

        Columns: ``t_s``, ``seq``, ``t_ns``, ``est_valid``, ``x_m``, ``y_m``, ``speed_mps``, true
        ``cte_m`` and ``he_rad``, estimated ``est_cte_m`` and ``est_he_rad`` (NaN where there is
        none), ``steering_rad``, ``speed_cmd_mps``, and for each requirement ``rho_lower.<name>``
        and ``rho_upper.<name>``; cross-track, heading and steering are left positive. Each access
        gives a copy of its own.
        """
        return self._trace.copy()

    @cached_property
    def _trace(self) -> pd.DataFrame:
        names = [spec.name for spec in self.specs]
        others = self.scenario.others
        return trace_table(columns_of_steps(
            self.steps, names, others=bool(others.objects), holds=bool(others.hold_lines),
        ))

    @takes(seq=WHOLE)
    def frame(self, seq: int) -> Frame:
        """Camera frame at a control step, (200, 360, 3) uint8 RGB.

        Raises:
            UsageError: the run has no such step.
            InfraError: a package's world is not reproducible when the run is replayed.
        """
        if not 0 <= seq < len(self.steps):
            raise UsageError(f'run: no control step {seq}; it has 0 to {len(self.steps) - 1}')
        found = next(picture for now, picture in self._driven_again((seq,)) if now == seq)
        if found is None:
            raise UsageError(f'run: world {self.world.name} gave no picture at step {seq}')
        return found

    def frames(self) -> Iterator[Frame]:
        """Camera frames of all control steps in order, rendered lazily.

        Frames are not stored (216 kB each): replaying the run's commands reproduces them to the
        byte. Those of a camera that does not take the same picture twice are stored.
        """
        driven = self._driven_again(range(len(self.steps)))
        return (picture for _, picture in driven if picture is not None)

    def fork(
        self, at_s: float, *, settings: Mapping[str, Any] = NOTHING,
        moved: Mapping[str, float] = NOTHING, perception: str | Perception | Look | None = None,
        controller: str | Controller | Steer | None = None,
    ) -> Run:
        """Repeat the run up to a moment and go on in a changed world.

        Arguments and errors are those of :func:`taxinet_ros.fork`.
        """
        from taxinet_ros.api.fork import fork
        from taxinet_ros.bag.run.recording import open_recording

        with tempfile.TemporaryDirectory(prefix='taxinet-fork-') as scratch:
            bag = self.save_bag(Path(scratch) / 'run', images=False)
            return fork(
                open_recording(bag), at_s=at_s, settings=settings, moved=moved,
                perception=perception, controller=controller,
            )

    @takes(path=PATH, images=FLAG)
    def save_bag(self, path: str | os.PathLike[str], *, images: bool = True) -> Path:
        """Save the run as a bag, readable by ``taxinet`` commands and ``tx.open_recording``.

        Its messages equal, to the byte, those that the ROS graph records for the same run.

        Args:
            path: folder of the bag, which also names the run; it must not exist.
            images: whether to include camera frames; they are rendered again, and most of the size.

        Returns:
            The folder.

        Raises:
            UsageError: ``path`` exists, or its name is not valid for a run.
            InfraError: as for :meth:`frame`.
            BagError: writing failed; the partial bag is removed.
        """
        folder = Path(path)
        status = RunEnding(
            outcome=self.outcome, perception=self.perception, fingerprint=self.fingerprint,
            **({} if self.outcome.judged else NOT_JUDGED),
        )
        driven = self._driven_again(range(len(self.steps)))
        write_run(
            folder,
            RunRequest(
                run_id=folder.name, index=self.draws[1], program='', seed=self.draws[0],
                scenario=self.scenario, judging=self.judging, participants=PARTICIPANTS,
            ),
            nodes=self.nodes, steps=self.steps, judgement=self.judgement, ending=status,
            frames=(picture for _, picture in driven) if images else None,
            fork='' if self.fork_of is None else self.fork_of.text,
        )
        return folder

    def plot(self) -> Plot:
        """True and estimated cross-track and heading error over time; notebooks show it."""
        from taxinet_ros.api.plots import run_plot

        return run_plot(self._trace, self.scenario.line.half_width_m)

    def _repr_html_(self) -> str:
        words = {name: interval.words() for name, interval in self.rho.items()}
        title = f'Run: {self.outcome}, {len(self.steps)} steps'
        return html_table(title, {'perception': self.perception, **words}) + (
            self.scenario._repr_html_())

    def __repr__(self) -> str:
        known = ', '.join(f'{name}: {interval.words()}' for name, interval in self.rho.items())
        return f'<Run {self.outcome}, {len(self.steps)} steps, {self.detail or known}>'

    def _driven_again(self, wanted: Container[int]) -> Iterator[tuple[int, Frame | None]]:
        """Replay the run: number and image of each step; None where not wanted or not available."""
        if self.world.again_words:
            yield from ((step.observation.seq, step.observation.image) for step in self.steps)
            return
        world = self.world.make(self.scenario)
        commands = LateCommands(self.timing, *self.draws, self.scenario)
        for step in self.steps:
            now = world.observe(picture=step.observation.seq in wanted)
            if repr(now.state) != repr(step.observation.state):  # by repr, NaN equals NaN
                raise InfraError(
                    InfraKind.SIM, topics.SIMULATOR, now.seq,
                    f'world {self.world.name} is elsewhere when the same run is driven again, so '
                    'there are no pictures of it',
                )
            yield now.seq, now.image
            if step is not self.steps[-1]:
                world.advance(commands.at(now.seq, step.command))

    def _why_not_judged(self) -> str:
        for step in self.steps:
            sample = step.sample
            for spec, reading in zip(self.specs, step.readings, strict=True):
                for name in () if reading.valid else signal_names(spec.formula):
                    if not math.isfinite(sample.get(name, 0.0)):
                        t_s = step.observation.stamp_ns / NS_PER_S
                        return f'{spec.name} reads {name}, which is {sample[name]:g} at {t_s:g} s'
        return NOT_JUDGED['detail']


@takes(word_or_file=WORD)
def load_perception(word_or_file: str) -> Perception:
    """Load a perception once for many runs.

    Args:
        word_or_file: ``truth``, a shipped network (``taxinet``, ``original``, ...), a file of
            weights (``.safetensors``) or of a network (``.onnx``), or ``FILE.py:NAME``.

    Returns:
        A perception for :func:`run`; ``estimate(image, truth)`` returns a :class:`TrackingError`
        for a frame (200, 360, 3) uint8 RGB.

    Raises:
        UsageError: an unknown word (the known ones are listed), or an unusable file.
    """
    return make_perception(word_or_file)


@takes(
    scenario=_SCENARIO, stop_on=WORD, bounds=TEXTS, rates=TEXTS, latency=TEXTS, world=WORD,
)
def run(
    scenario: Scenario, *, perception: str | Perception | Look = 'truth',
    controller: str | Controller | Steer = STEERING,
    specs: str | Spec | Sequence[str | Spec] = DEFAULT_SPECS, stop_on: str = 'never',
    bounds: str | Sequence[str] = (), rates: str | Sequence[str] = (),
    latency: str | Sequence[str] = (), world: str = KMWH,
) -> Run:
    """Run one scenario in this process.

    Args:
        scenario: initial condition and environment.
        perception: a word or file as for :func:`load_perception`, its result, or a function from a
            frame, (200, 360, 3) uint8 RGB, to ``(cte_m, he_rad)``, left positive, or None;
            with a third value their 2 x 2 covariance.
        controller: ``steering``, ``FILE.py:NAME``, ``tx.SteeringLaw(tx.SteeringGains(...))``, or a
            function from a :class:`TrackingError` to ``(steering_rad, speed_mps)``.
        specs: names of shipped formulas, ``NAME=FORMULA``, formulas, YAML files of them, or
            :class:`Spec`; the first is the headline.
        stop_on: ``never``, or stop as soon as the headline is ``violated`` or all is ``decided``.
        bounds: assumed ranges of signals, such as ``cte=-25:25``, in the signal's unit; they narrow
            robustness intervals before the end.
        rates: assumed maximum changes per second, such as ``cte=3``.
        latency: delay of answers [s], such as ``perception=0.15`` or
            ``controller=uniform(0.1,0.3)``; append ``draws=SEED.INDEX`` for other random draws.
        world: ``kmwh``, the simulated one, or one added by a package (docs/extending.md); with
            ``+CAMERA``, who takes its pictures, as in ``kmwh+flightgear``.

    Returns:
        The run with its trace, robustness and outcome.

    Warns:
        UserWarning: a requirement is likely mistaken, the run violated an assumed bound or rate,
            the perception needs no picture and so cannot notice faults of the camera, was not
            trained in such a scene, or the controller's monitor is calibrated for another one.

    Raises:
        UsageError: a word, file or formula is not known, a formula looks beyond the run, or a
            function returned an invalid answer.
        UserCodeError: a function in a file failed; exceptions of a given function propagate.
        InfraError: the simulator failed.
    """
    eyes, hands = asked_perception(perception), asked_controller(controller)
    chosen = find_world(world)
    judging = Judging(
        specs=spec_texts(specs), stop_on=parse_stop_on(stop_on), bounds=text_list(bounds),
        rates=text_list(rates),
    )
    timing, assumptions = parse_latency(text_list(latency)), judging.assumptions
    asked = judging.parsed_specs
    check_read(assumptions, (spec.formula for spec in asked))
    gains = hands.gains if isinstance(hands, SteeringLaw) else None
    check_others(asked, scenario)
    unseen = [] if eyes.needs_image else unseen_faults(scenario)
    strange = hands.doubts(eyes) if isinstance(hands, Assured) else []
    if isinstance(perception, str):
        strange += network_doubts(perception, (scenario,))
    for line in (*check_specs(asked, scenario, gains).warnings, *unseen, *strange):
        warnings.warn(line, stacklevel=CALLER)
    done = drive(scenario, eyes, hands, judging=judging, timing=timing, world=chosen)
    broken = (step for step in done.steps if not all(reading.trusted for reading in step.readings))
    for step in islice(broken, 1):
        warnings.warn(
            f'bounds, rates: broken at {step.observation.stamp_ns / NS_PER_S:g} s; from there on '
            'intervals are those without them', stacklevel=CALLER,
        )
    return done


def drive(
    scenario: Scenario, perception: Perception, controller: Controller, *, judging: Judging,
    timing: Timing, world: ChosenWorld, draws: tuple[int, int] = _DRAWS,
    on_step: Callable[[Step], None] = lambda step: None, fork_of: Fork | None = None,
    nodes: tuple[NodeWords, ...] | None = None,
) -> Run:
    """Run one scenario with what :func:`run` has made of its words.

    Args:
        scenario: initial condition and environment.
        perception: computes estimates.
        controller: computes commands.
        judging: requirements, stop rule and assumptions.
        timing: when answers take effect.
        world: world of the run.
        draws: seed and index of the run.
        on_step: called with every step, with its image if the perception needs it.
        fork_of: what the run is forked from, if it is.
        nodes: reports of nodes; None: those of such a perception and controller.
    """
    steps: list[Step] = []

    def keep(step: Step) -> None:
        on_step(step)
        # A frame that can be taken again is not kept: 216 kB each.
        seen = step.observation if world.again_words else dataclasses.replace(
            step.observation, image=None
        )
        steps.append(dataclasses.replace(step, observation=seen))

    judgement = run_closed_loop(
        scenario, perception, specs=judging.parsed_specs, controller=controller,
        stop_on=judging.stop_on, assumptions=judging.assumptions, on_step=keep, timing=timing,
        draws=draws, make_world=world.make,
    )
    return Run(
        scenario=scenario, perception=perception.word, fingerprint=perception.fingerprint,
        judging=judging, timing=timing, steps=tuple(steps), judgement=judgement, world=world,
        nodes=nodes or node_words(perception, controller, world, timing, scenario), draws=draws,
        fork_of=fork_of,
    )


def text_list(words: str | Sequence[str]) -> tuple[str, ...]:
    """One text, or several, as a tuple."""
    return (words,) if isinstance(words, str) else tuple(words)


@takes(scenario=_SCENARIO, pose=_POSE, t_s=NUMBER)
def render(
    scenario: Scenario, pose: AircraftState | tuple[float, float, float] | None = None, *,
    t_s: float = 0.0,
) -> Frame:
    """Render a scene as seen by its camera.

    Args:
        scenario: light, weather and runway; also the start pose if ``pose`` is None, which gives
            the first frame of its run.
        pose: ``(x_m, cte_m, he_rad)``: metres along the scenario's track (past the threshold),
            metres left of it, heading error in radians, left positive, with the attitude of a run's
            start; or a full
            :class:`AircraftState`.
        t_s: simulated time [s], which moves clouds, rain and others on the ground; 0 where these
            react to the aircraft.

    Returns:
        (200, 360, 3) uint8 RGB.

    Raises:
        UsageError: the pose is outside the range of start poses, the time is negative, or others
            react to the aircraft.
    """
    if not 0 <= t_s <= _MOST_S:
        raise UsageError(f'render: t_s is {t_s:g}; expected 0 to {_MOST_S:g} seconds')
    if t_s and (reacting := scenario.others.reacting):
        raise UsageError(
            f'render: t_s: {reacting}: where it is at {t_s:g} s, only a run says; leave t_s out'
        )
    if not isinstance(pose, AircraftState):
        start = scenario
        if pose is not None:
            x_m, cte_m, he_rad = map(float, pose)
            start = dataclasses.replace(
                scenario, distance_m=x_m, cross_track_m=cte_m, heading_rad=he_rad
            )
        pose = Aircraft(start).state
    try:
        return Camera(scenario).render(pose, round(t_s * NS_PER_S))
    except ValueError as error:
        raise UsageError(f'render: {error}') from error


@overload
def robustness(
    spec: str | Spec, trace: pd.DataFrame, *, explain: Literal[False] = False
) -> float: ...
@overload
def robustness(
    spec: str | Spec, trace: pd.DataFrame, *, explain: Literal[True]
) -> Explanation: ...
@takes(spec=TEXT | a('a tx.Spec', Spec), trace=TABLE, explain=FLAG)
def robustness(
    spec: str | Spec, trace: pd.DataFrame, *, explain: bool = False
) -> float | Explanation:
    """Robustness of a requirement on a finished trace, which ends at its last row.

    >>> import pandas as pd
    >>> import taxinet_ros as tx
    >>> tx.robustness('always(gap_m >= 2)', pd.DataFrame({'t_s': [0, 1], 'gap_m': [4.0, 2.5]}))
    0.5

    Args:
        spec: name of a shipped formula, ``NAME=FORMULA``, a formula, or a :class:`Spec`.
        trace: a row per sample, in order of time, with ``t_ns`` (integer nanoseconds) or ``t_s``.
            The signals ``cte``, ``he``, ``x``, ``speed``, ``steering``, ``cte_estimate``,
            ``he_estimate``, ``cte_sigma`` and ``he_sigma`` (with covariances), ``estimate_gap``,
            ``unusable_share``, ``clearance``, ``collision`` and ``hold_distance`` (with others on
            the ground) come from the columns of :attr:`Run.trace`, in SI units and radians. Any
            other numeric column is a signal under its own name; its unit is known if it is in
            ``attrs['units']``. A column that is read, or the time, is rejected if its unit there is
            another, or not one of SI, in which formulas compare.
        explain: whether to return an :class:`~taxinet_ros.core.mtl.explain.Explanation`, which has
            the robustness of every part of the formula, and the part and the sample that decide.

    Returns:
        Signed distance from violation, in the unit of the deciding predicate; > 0 is satisfied.
        With ``explain``, what it comes from.

    Raises:
        UsageError: a bad formula, no time or times of less than 64 bits, two columns of one name, a
            signal without a column, or one that is not finite where the formula reads it (a missing
            estimate has no robustness).
    """
    if (twice := trace.columns[trace.columns.duplicated()]).size:
        raise UsageError(f'trace: several columns are named {twice[0]}; leave all but one out')
    stamps_ns = _stamps_ns(trace)
    numbers = {
        str(name): trace[name].to_numpy() for name in trace.columns
        if trace[name].dtype.kind in 'biuf'
    }
    signals = trace_signals(stamps_ns, numbers)
    own = {
        name: column for name, column in numbers.items()
        if name.isidentifier() and name not in RESERVED
    }
    for name in signals.keys() & own.keys():
        source = source_column(name, numbers)
        if source and not np.array_equal(signals[name], own[name], equal_nan=True):
            raise UsageError(
                f'trace: columns {name} and {source} both give signal {name} and differ; '
                'leave one out'
            )
    signals |= own
    _check_read(spec, trace, signals)
    told = trace.attrs.get('units')
    units = dict(told) if isinstance(told, Mapping) else {}
    known = {**COLUMN_UNITS, **SIGNALS}
    names = {name: known.get(name) or str(units.get(name, '')) for name in signals}
    try:
        asked = spec if isinstance(spec, Spec) else parse_spec(spec, signals=names)
    except UsageError as error:
        if not (taken := RESERVED & numbers.keys() & set(re.split(r'\W+', str(spec)))):
            raise
        raise UsageError(f'{error}; column {min(taken)} is named like a word of formulas: rename '
                         'it') from None
    _check_units(units, 't_ns' if 't_ns' in trace.columns else 't_s')
    for name in signal_names(asked.formula):
        _check_units(units, name, source_column(name, numbers))
    if explain:
        return explain_trace(asked, stamps_ns.tolist(), signals)
    return offline.robustness(asked.formula, stamps_ns, signals)


def _check_read(spec: str | Spec, trace: pd.DataFrame, signals: Mapping[str, Any]) -> None:
    """Report non-numeric columns that a formula reads; its parser does not see them.

    Raises:
        UsageError: there is one.
    """
    text = spec.text if isinstance(spec, Spec) else SHIPPED[spec].text if spec in SHIPPED else spec
    read = set(re.findall(r'[^\W\d]\w*', text))
    for name in trace.columns:
        if str(name) in read and str(name) not in {*signals, *RESERVED}:
            raise UsageError(f'trace: column {name}, which {text!r:.80} reads, holds '
                             f'{trace[name].dtype}, no numbers')


def _check_units(units: Mapping[object, object], name: str, source: str = '') -> None:
    """Check the units told of the column ``name``, if there is one, and of a signal's source.

    Raises:
        UsageError: one is not the unit in which it is read.
    """
    for column in (name, source):
        unit = str(units.get(column) or '')
        dimension = dimension_of(unit)
        wanted = SIGNALS.get(column) or COLUMN_UNITS.get(column) or (
            unit if dimension is None else si_unit(dimension) or '1'
        )
        if unit and unit != wanted:
            raise UsageError(
                f'trace: column {column} is in {unit}; signal {name} is in {wanted}, as formulas '
                'compare in SI'
            )


def _stamps_ns(trace: pd.DataFrame) -> NDArray[np.int64]:
    if 't_ns' in trace.columns:
        _check_time(trace, 't_ns', 'iu', 'integer nanoseconds')
        return trace['t_ns'].to_numpy()
    if 't_s' not in trace.columns:
        known = ', '.join(map(str, trace.columns)) or 'none'
        raise UsageError(f'trace: no column t_ns or t_s; it has: {known}')
    _check_time(trace, 't_s', 'iuf', 'seconds as numbers, float64 from the start, as the '
                'rounding of shorter ones moves samples out of windows')
    seconds = trace['t_s'].to_numpy(dtype=np.float64)
    if not np.isfinite(seconds).all():
        raise UsageError(f'trace: t_s is not finite at row {np.isfinite(seconds).argmin()}')
    if (np.abs(seconds) > _MOST_S).any():
        row = int((np.abs(seconds) > _MOST_S).argmax())
        raise UsageError(f'trace: t_s is {seconds[row]:g} s at row {row}, beyond {_MOST_S:g}')
    return np.rint(seconds * NS_PER_S).astype(np.int64)


def _check_time(trace: pd.DataFrame, name: str, kinds: str, expected: str) -> None:
    kind = trace[name].dtype
    if kind.kind not in kinds or (kind.kind == 'f' and getattr(kind, 'itemsize', 8) < 8):
        raise UsageError(f'trace: {name} holds {kind}; expected {expected}')


def spec_texts(specs: str | Spec | Sequence[str | Spec]) -> tuple[str, ...]:
    """Requirements as self-contained text.

    Raises:
        UsageError: there is none, or one is unknown.
    """
    asked = (specs,) if isinstance(specs, str | Spec) else specs
    if not isinstance(asked, list | tuple) or not all(isinstance(one, str | Spec) for one in asked):
        raise UsageError(
            f'specs: got {told(specs)}; expected a requirement or a list of them, each a text, as '
            'in specs=["phi_always", "slow=always(speed <= 6)"]'
        )
    if not asked:
        raise UsageError('specs: no requirement; name one, as in specs="phi_always"')
    return read_specs(f'{one.name}={one.text}' if isinstance(one, Spec) else one for one in asked)


def asked_perception(given: str | Perception | Look) -> Perception:
    """Perception of a word, a file, or a function, as for :func:`run`."""
    if isinstance(given, str):
        return make_perception(given)
    if isinstance(given, GroundTruth | NetworkPerception | UserPerception):
        return given
    _check_answering('perception', given, 'estimate', 2, 'rig', 'sensors')
    _check_starting('perception', given, 0, 'rig')
    return _FunctionPerception(given)


def asked_controller(given: str | Controller | Steer) -> Controller:
    """Controller of a word, a file, or a function, as for :func:`run`."""
    if isinstance(given, str):
        return make_controller(given, SteeringGains())
    if isinstance(given, SteeringLaw | HoldShort | UserController | Assured):
        return given
    _check_answering('controller', given, 'command', 1, 'sensors')
    _check_starting('controller', given, 1)
    return _FunctionController(given)


def _check_answering(
    name: str, given: Any, method: str, arguments: int, *more: str
) -> None:
    """Check that it is a function of one argument, and maybe of these, or has the method."""
    answer, count = getattr(given, method, None), arguments
    if answer is None:
        answer, count = given, 1
    if isinstance(given, type) or not callable(answer):
        told_words = given if isinstance(given, int | float) else told(given)
        raise UsageError(f'{name}: {told_words} is neither a word, a {name} nor a function')
    if why := _misfit(answer, count, *more):
        raise UsageError(f'{name}: {told(given)} cannot be called with {count}: {why}')


def _check_starting(name: str, given: Any, most: int, *more: str) -> None:
    """Check that ``begin``, with at most ``most`` arguments, and ``reset`` can be called."""
    for method in ('begin', 'reset'):
        start = getattr(given, method, None)
        if start is None:
            continue
        misfits = [
            _misfit(start, count, *more) for count in range(most + 1 if method == 'begin' else 1)
        ]
        if not callable(start) or all(misfits):
            what = 'the scenario or nothing' if len(misfits) > 1 else 'no argument'
            raise UsageError(f'{name}: {method} of {told(given)} cannot be called with {what}')


def _misfit(function: Any, count: int, *more: str) -> str:
    """Why a function cannot be called with ``count`` arguments; '' if it can.

    With those of further ones, by name, for which it has parameters.
    """
    named = {name: None for name in more if has_parameter(function, name)}
    try:
        inspect.signature(function).bind(*range(count), **named)
    except TypeError as error:
        return str(error)
    except ValueError:  # compiled functions may have no signature
        pass
    return ''


class _Function:
    """Function or object of the caller; its exceptions propagate."""

    _METHOD: ClassVar[str]

    def __init__(self, given: Any) -> None:
        self.word = str(getattr(given, 'word', IMPLEMENTATION))
        self.fingerprint = str(getattr(given, 'fingerprint', ''))
        self._given = given
        self._answers = getattr(given, self._METHOD, given)
        self.needs_sensors = has_parameter(self._answers, 'sensors')
        self._measured: Measured | None = None

    def sense(self, measured: Measured) -> None:
        """Take what the sensors deliver for the next answer."""
        self._measured = measured

    def _sensed(self) -> dict[str, Measured]:
        """The argument ``sensors``, if it is asked for."""
        if not self.needs_sensors:
            return {}
        measured, self._measured = self._measured, None
        return {'sensors': given_sensors(measured, self.word)}

    def begin(self, scenario: Scenario | None = None) -> None:
        """Call its ``begin``, with the scenario if it takes one, or its ``reset``."""
        begin = getattr(self._given, 'begin', None)
        if begin is None:
            getattr(self._given, 'reset', lambda: None)()
        elif scenario is None or _misfit(begin, 1):
            begin()
        else:
            begin(scenario)


class _FunctionPerception(_Function, Perception):
    """Perception by a caller's function of a frame, or of the true error."""

    _METHOD = 'estimate'

    def __init__(self, given: Any) -> None:
        super().__init__(given)
        self.needs_image = bool(getattr(given, 'needs_image', True))
        self._named: dict[str, Any] = {}

    def begin(self, rig: Any = None) -> None:
        """Call its ``begin``, with the rig if it takes one, or its ``reset``."""
        begin = getattr(self._given, 'begin', None)
        if begin is not None and has_parameter(begin, 'rig'):
            begin(rig=rig)
            return
        super().begin()
        if not hasattr(self._given, 'estimate'):
            self._named = {'rig': rig} if has_parameter(self._given, 'rig') else {}

    def estimate(self, image: Frame | None, truth: TrackingError | None) -> TrackingError:
        """Return the function's estimate."""
        if (image if self.needs_image else truth) is None:
            return NO_ESTIMATE
        # A copy, which the function may modify.
        seen = image.copy() if self.needs_image and image is not None else None
        if hasattr(self._given, 'estimate'):
            told = None if self.needs_image else truth
            answer = self._given.estimate(seen, told, **self._sensed())
        else:
            answer = self._given(truth if seen is None else seen, **self._named, **self._sensed())
        found = read_estimate(answer)
        if found is None:
            raise UsageError(
                f'perception: answered {answer!r:.60}; expected (cte_m, he_rad), also '
                'with their covariance, or None'
            )
        return found


class _FunctionController(_Function, Controller):
    """Controller by a caller's function."""

    _METHOD = 'command'

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """Return the function's command."""
        answer = self._answers(estimate, **self._sensed())
        found = read_command(answer)
        if found is None:
            raise UsageError(
                f'controller: answered {answer!r:.60}; expected (steering_rad, speed_mps), finite '
                'and speed not negative'
            )
        return found
