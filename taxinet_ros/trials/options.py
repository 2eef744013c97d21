"""Options of a campaign, checked before anything starts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.core.assurance.monitor import check_monitor_rate, monitor_doubts
from taxinet_ros.core.assurance.switch import check_controller, parts_of
from taxinet_ros.core.camera.airframe import covering_doubts
from taxinet_ros.core.faults import check_free, unseen_faults
from taxinet_ros.core.motion.aircraft import checked_aircraft
from taxinet_ros.core.motion.controller import STEERING, SteeringGains, typed_gain
from taxinet_ros.core.motion.hold_short import HoldShort, check_holding
from taxinet_ros.core.pacing.timing import Timing, free_timing, parse_latency
from taxinet_ros.core.perception.perception import GroundTruth, check_perception, network_doubts
from taxinet_ros.core.rig.catalogue import AIRCRAFT, CAMERAS
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    AIRCRAFT_MODEL,
    BY_KEY,
    CAMERA,
    CAMERA_OFFSETS,
    TRAFFIC,
    by_key,
)
from taxinet_ros.core.system import System
from taxinet_ros.core.user_code import is_node_elsewhere, short_word
from taxinet_ros.core.verdict.judge import SpecCheck, check_others, check_specs, reads_others
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.world import ChosenWorld, find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import FULL_DISK, make_folder
from taxinet_ros.samplers.sampler import split_options
from taxinet_ros.scenes.overrides import check_overrides, doubtful_values
from taxinet_ros.trials.requirements import DEFAULT_JUDGING, make_judging

DEFAULT_ROOT = Path('bags')
IMAGES = ('all', 'failures', 'none')
"""Runs whose camera frames are recorded: all, only failed and broken ones, or none."""
GRAPH, LOOP = ENGINES = ('graph', 'loop')
"""What makes runs: nodes and ROS messages, or the closed loop in one process, without ROS.

Both give the same rows and bags, to the bit.
"""
AUDITED_PERCENT = 1.0
"""Share of a loop's runs that are repeated on the graph and compared, by default [%]."""
AUDIT = 'audit'
"""Kind of the infrastructure error of a run that came out otherwise on the graph."""
AUDIT_FOLDER = Path('logs') / AUDIT
"""Where in a campaign's folder the graph writes the bags of audits; only those that differ stay."""
_GAIN_PREFIX = 'steering.'


@dataclass(frozen=True, kw_only=True)
class CampaignOptions(System):
    """Options of a campaign: a system, the scenes of one program, and what makes the runs.

    Perception is '' if a standing graph determines it.

    Attributes:
        program: word of a shipped Scenic program or path of one.
        runs: number of scenes.
        seed: seed of the scenes.
        out: folder of the campaign, which must be new or empty unless it is resumed.
        overrides: scenario values that replace drawn ones, in human keys and units.
        judging: judging options of the verdicts.
        processes: whether every node runs in its own process.
        images: runs whose camera frames are recorded, one of :data:`IMAGES`.
        laid_over: scenario values that override each scene after it was chosen. Unlike
            ``overrides``, they do not remove dimensions from the search; so campaigns that differ
            only in them have otherwise equal scenes.
        arms: if it is an arm, folders of all arms of the experiment in order.
        bags: whether its runs leave bags; those of closed loops without a graph do not.
        engine: what makes the runs, one of :data:`ENGINES`.
        audit_percent: share of the runs to repeat on the graph and compare [%]; 0 with the graph.
        workers: number of runs at a time.
        cluster: result of :func:`.pool.check_cluster`, or '' for worker processes here.
        resume: continue the campaign in ``out``.
    """

    program: str
    runs: int
    seed: int
    out: Path
    overrides: Mapping[str, str] = field(default_factory=dict)
    judging: Judging = DEFAULT_JUDGING
    processes: bool = False
    images: str = 'all'
    laid_over: Mapping[str, str] = field(default_factory=dict)
    arms: tuple[str, ...] = ()
    bags: bool = True
    engine: str = GRAPH
    audit_percent: float = 0.0
    workers: int = 1
    cluster: str = ''
    resume: bool = False

    def check(
        self, first: Scenario, drawn: Callable[[], Collection[str]],
        more: Iterable[Scenario] = (),
    ) -> SpecCheck:
        """Check the requirements and overrides before the first run.

        Args:
            first: scenario of the first run.
            drawn: tells the keys that scenes differ in.
            more: a few more scenes, to see what network, monitor or timing cannot have.

        Raises:
            UsageError: a requirement cannot be evaluated on such runs, a gain has no effect, or
                the scenario delays the loop of a free run.
        """
        scenes = (first, *more)
        for scene in scenes if self.timing.free else ():
            check_free(scene)
        for scene in scenes if self.controller.partition('+')[0] == HoldShort.word else ():
            check_holding(scene)
        usual_mps = SteeringGains().speed_mps
        if self.gains.get('speed_mps') == usual_mps != first.speed_mps:
            raise UsageError(
                f'steering.speed_mps={usual_mps:g} has no effect: at {usual_mps:g} the '
                f'scenario says the speed, {first.speed_mps:g}; set speed_mps instead'
            )
        known = self.controller == STEERING and not self.standing_graph
        gains = SteeringGains(**self.gains) if known else None
        asked = self.judging.parsed_specs
        if reads_others(asked):
            given = TRAFFIC.key in {**self.overrides, **self.laid_over}
            differ = not given and TRAFFIC.key in drawn()
            check_others(asked, *(scenes[1:] if differ else (first,)))
        found = check_specs(asked, first, gains)
        doubts = doubtful_values({**self.overrides, **self.laid_over})
        unseen = unseen_faults(first) if self.perception == GroundTruth.word else []
        again = find_world(self.world).again_words
        told = [f'{again}, so every frame is recorded'] if again and self.bags else []
        parts = None if self.standing_graph else parts_of(self.controller)
        strange: list[str] = []
        if parts is not None:
            check_monitor_rate(parts.monitor, scenes)
            strange += monitor_doubts(parts.monitor, self.perception)
        strange += covering_doubts(first.aircraft_model, first.camera_model)
        strange += network_doubts(self.perception, scenes)
        values, differing = [scene.to_human() for scene in scenes], drawn()
        return dataclasses.replace(
            found, warnings=(*found.warnings, *doubts, *unseen, *strange, *told),
            shared={
                key: value for key, value in values[0].items()
                if key not in differing and all(one[key] == value for one in values)
            },
        )

    @property
    def bag_folder(self) -> Path | None:
        """Folder of its bags; None if it makes none."""
        return self.out if self.bags else None

    @property
    def runs_graphs(self) -> bool:
        """Whether it needs ROS for its runs, or for audits."""
        return self.engine == GRAPH or (self.bags and self.audit_percent > 0)

    @property
    def standing_graph(self) -> bool:
        """Whether the graph was started before the campaign, and outlives its broken runs."""
        return not self.perception


def make_options(
    *, out: Path | None = None, settings: Iterable[str] = (), specs: Iterable[str] = (),
    stop_on: str = StopOn.NEVER, bounds: Iterable[str] = (), rates: Iterable[str] = (),
    latency: Iterable[str] = (), free: bool = False, real_time_factor: str | None = None,
    audit: str | None = None, resume: bool | None = None, **fields: Any,
) -> CampaignOptions:
    """Check what a user asks for, most of it as text.

    Args:
        out: folder; if None, a new one below ``bags/`` with a descriptive name.
        settings: ``key=value`` of the scenario, or ``steering.<gain>=value``.
        specs: formulas as text, or files of them; the default if empty.
        stop_on: ``never``, ``violated`` or ``decided``.
        bounds: assumed bounds of signals, such as ``cte=-25:25``.
        rates: assumed bounds of their change per second, such as ``cte=3``.
        latency: ``NAME=LATENCY`` of perception or controller.
        free: simulated time follows the wall clock.
        real_time_factor: simulated seconds per second then, or ``max``.
        audit: share of the runs to audit as text; None for the default of the engine.
        resume: continue the campaign in ``out``; None if the command cannot.
        fields: other fields of :class:`CampaignOptions`.

    Raises:
        UsageError: one line on the first error.
    """
    overrides, gains = split_settings(settings)
    asked = CampaignOptions(
        **fields, out=out or Path(), overrides=overrides, gains=gains, resume=bool(resume),
        judging=make_judging(specs, stop_on, bounds, rates),
        timing=check_timing(latency, free=free, factor=real_time_factor),
    )
    check_overrides(overrides)
    check_controller(asked.controller, gains, graph=True)
    world = find_world(asked.world)
    _check_free(asked)
    if asked.perception:
        check_perception(asked.perception, graph=True)
    if asked.images not in IMAGES:
        raise UsageError(f'images {asked.images}: unknown; known: {", ".join(IMAGES)}')
    needs_graph = {'processes': asked.processes, 'free': free}
    for option in (name for name, given in needs_graph.items() if given and asked.engine == LOOP):
        raise UsageError(f'{option}: not with engine {LOOP}, which has no nodes')
    if asked.engine == LOOP and world.again_words:
        raise UsageError(f'engine {LOOP}: {world.again_words}, so it could not be audited')
    audit_percent = check_engine(asked.engine, audit, asked)
    if resume and out is None:
        raise UsageError('resume: name the campaign to continue as out')
    if out is None:
        words = (Path(asked.program).stem, short_word(asked.perception), f'seed{asked.seed}')
        out = new_folder(DEFAULT_ROOT / '-'.join(word for word in words if word))
    if not resume:
        check_new(out, '' if resume is None else ', or resume it')
    return dataclasses.replace(
        asked, out=out, processes=asked.processes or free, world=world.name,
        images=recorded_images(world, asked.images), audit_percent=audit_percent,
    )


def _check_free(asked: CampaignOptions) -> None:
    """Refuse what a free run cannot have."""
    if not asked.timing.free:
        return
    if asked.processes:
        raise UsageError('processes: no effect on a free run, which always uses processes')
    check_not_free(asked.timing, asked.controller)
    if asked.judging.stop_on is not StopOn.NEVER:
        raise UsageError(
            f'stop_on {asked.judging.stop_on}: not in a free run, which does not wait '
            'for the monitor'
        )


def check_engine(engine: str, audit: str | None, system: System) -> float:
    """Check the arguments on the engine.

    Args:
        engine: see :class:`CampaignOptions`.
        audit: share of the runs to audit: a percentage, with or without its sign; None for the
            default of the engine.
        system: the system to run.

    Returns:
        Share of the runs to audit [%].

    Raises:
        UsageError: unknown engine, a bad share or one without effect, or a part that only a graph
            can have.
    """
    if engine not in ENGINES:
        raise UsageError(f'engine {engine}: unknown; known: {", ".join(ENGINES)}')
    if engine == GRAPH:
        if audit is not None:
            raise UsageError(
                f'audit {audit}: no effect with engine {GRAPH}, which needs no audit'
            )
        return 0.0
    for role in ('perception', 'controller'):
        if is_node_elsewhere(word := getattr(system, role)):
            raise UsageError(
                f'engine {LOOP}: {role} {word} is a node; use engine {GRAPH}'
            )
    check_perception(system.perception)
    check_controller(system.controller, system.gains)
    return AUDITED_PERCENT if audit is None else _audit_percent(audit)


def _audit_percent(text: str) -> float:
    try:
        percent = float(text.strip().removesuffix('%'))
    except ValueError:
        percent = math.nan
    if not 0 <= percent <= 100:
        raise UsageError(f'audit {text}: expected a percentage of the runs, such as 1 or 0.5')
    return percent


def recorded_images(world: ChosenWorld, images: str) -> str:
    """Runs whose camera frames are recorded: all of them, if they cannot be had again."""
    return 'all' if world.again_words else images


def check_timing(
    latency: Iterable[str], *, free: bool = False, factor: str | None = None
) -> Timing:
    """Parse the timing options.

    Args:
        latency: ``NAME=LATENCY`` of perception or controller.
        free: simulated time follows the wall clock.
        factor: simulated seconds per second then, or ``max``; real time if None.

    Raises:
        UsageError: one line that names the parameter.
    """
    latency = tuple(latency)
    if factor is not None and not free:
        raise UsageError('real_time_factor: has an effect on a free run only')
    if latency and free:
        raise UsageError(f'latency {latency[0]}: not in a free run, which has real delays')
    return free_timing(factor or '1') if free else parse_latency(latency)


def check_not_free(timing: Timing, controller: str) -> None:
    """Refuse a monitored controller in a free run.

    Raises:
        UsageError: one line that names the parameter.
    """
    if timing.free and parts_of(controller) is not None:
        raise UsageError(
            f'free: not with controller {controller}: its monitor needs the frame of each '
            'estimate, and a free run may lose frames'
        )


def new_folder(wanted: Path) -> Path:
    """``wanted``, or if it exists, the first free ``wanted-2``, ``wanted-3`` and so on."""
    candidate, number = wanted, 1
    while candidate.exists():
        number += 1
        candidate = wanted.with_name(f'{wanted.name}-{number}')
    return candidate


def check_new(out: Path, or_else: str = '') -> None:
    """Check that a campaign can be written to ``out`` without overwriting anything.

    Args:
        out: the folder.
        or_else: another way out, for the error message.

    Raises:
        UsageError: it is a file, or a folder that is not empty.
    """
    if out.is_dir() and not any(out.iterdir()):
        return
    if out.exists() or out.is_symlink():
        raise UsageError(
            f'out {out}: already exists; recordings are never overwritten, choose a new folder'
            f'{or_else}'
        )


def make_out(out: Path) -> None:
    """Create the folder of ``--out`` if it does not exist.

    Raises:
        UsageError: it cannot be created there.
        OSError: the disk is full, or broken.
    """
    try:
        make_folder(out)
    except OSError as error:
        if error.errno in FULL_DISK:
            raise
        raise UsageError(f'out {out}: cannot be written: {error.strerror}') from error


def read_settings(settings: Iterable[str]) -> dict[str, str]:
    """Parse ``key=value`` arguments; short forms of scenario keys are expanded.

    Raises:
        UsageError: an argument has another form, or a key is given twice, even by its short form.
    """
    values = split_options(settings, 'setting')
    try:
        return by_key(values)
    except UsageError as error:
        raise UsageError(f'settings: {str(error).removeprefix("scenario: ")}') from None


def with_offsets(values: Mapping[str, str]) -> dict[str, str]:
    """Settings in which a moved camera is its base and its offsets, which tables have as numbers.

    Raises:
        UsageError: no such camera, or an offset is given twice.
    """
    if CAMERA.key not in values or (camera := CAMERAS.typed(values[CAMERA.key])).base is None:
        return dict(values)
    offsets = dict(zip(CAMERA_OFFSETS, camera.offsets, strict=True))
    moved = {field.key: f'{value!r}' for field, value in offsets.items() if value}
    if twice := sorted(moved.keys() & values.keys()):
        raise UsageError(f'setting {twice[0]}: the camera has an offset of its own; leave one out')
    return {**values, CAMERA.key: camera.base.text, **moved}


def _check_taxiing(reference: str) -> None:
    aircraft = AIRCRAFT.typed(reference)
    if not aircraft.shipped:
        checked_aircraft(aircraft)


def split_settings(settings: Iterable[str]) -> tuple[dict[str, str], dict[str, float]]:
    """Split ``key=value`` of the scenario from ``steering.<gain>=value``.

    Raises:
        UsageError: one is neither, a key is given twice, or a document is invalid.
    """
    overrides: dict[str, str] = {}
    gains: dict[str, float] = {}
    for key, value in with_offsets(read_settings(settings)).items():
        if not key.startswith(_GAIN_PREFIX):
            # A file may change: the campaign's identity includes its digest.
            overrides[key] = BY_KEY[key].settled(value) if key in BY_KEY else value
            if key == AIRCRAFT_MODEL.key:
                _check_taxiing(overrides[key])
            continue
        name = key.removeprefix(_GAIN_PREFIX)
        gains[name] = typed_gain(name, value)
    return overrides, gains
