"""Options of a campaign, validated before anything starts.

Requirements are given as names, formulas, or YAML files of formulas and predicates. Such a file has
two optional keys::

    predicates:
      on_centreline: abs(cte) <= 1.5
    specs:
      reach: 'F[0, 10] G on_centreline'
      gentle: 'always[10 s:inf](abs(steering) <= 3 deg)'

A predicate may use earlier ones, in its own file and in files given before. The resulting texts are
self-contained: predicates are expanded.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from taxinet_ros.core.assurance.monitor import monitor_doubts
from taxinet_ros.core.assurance.switch import check_controller, parts_of
from taxinet_ros.core.camera.airframe import covering_doubts
from taxinet_ros.core.faults import check_free, unseen_faults
from taxinet_ros.core.motion.aircraft import checked_aircraft
from taxinet_ros.core.motion.controller import STEERING, SteeringGains, typed_gain
from taxinet_ros.core.mtl import (
    SHIPPED,
    SIGNALS,
    Assumptions,
    Spec,
    check_read,
    parse_assumptions,
    parse_formula,
    parse_spec,
)
from taxinet_ros.core.mtl.parser import parse
from taxinet_ros.core.pacing.timing import AT_ONCE, Timing, free_timing, parse_latency
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
from taxinet_ros.core.verdict.judging import Judging, StopOn, parse_stop_on
from taxinet_ros.core.world import ChosenWorld, find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import FULL_DISK, make_folder
from taxinet_ros.files.plain_values import Section, read_yaml
from taxinet_ros.registry import KMWH
from taxinet_ros.scenes.overrides import check_overrides, doubtful_values

SUFFIXES = ('.yaml', '.yml')
_KEYS = ('predicates', 'specs')
_BRACKETS = "; a formula with brackets needs '…' quotes around it"


def read_specs(words: Iterable[str]) -> tuple[str, ...]:
    """Read requirements; each result is a text for :func:`parse_spec`.

    Args:
        words: names of shipped formulas, ``NAME=FORMULA``, formulas, and YAML files of them. The
            order is kept.

    Raises:
        UsageError: a word or file is invalid, or two formulas have the same name.
    """
    texts: list[str] = []
    predicates: dict[str, str] = {}
    for word in words:
        if word.strip().endswith(SUFFIXES):
            texts += _read(Path(word.strip()), predicates)
        else:
            spec = parse_spec(word, predicates)
            # A package's named formula must be readable where the package is not installed.
            elsewhere = spec.name == word.strip() not in SHIPPED
            texts.append(
                _written_out('--spec', spec.name, spec.text) if predicates or elsewhere else word
            )
    names = [parse_spec(text).name for text in texts]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f'--spec: {name} is given twice; name one of them NAME=FORMULA')
    if predicates and not texts:
        raise UsageError('--spec: only predicates are given; add a formula that uses them')
    return tuple(texts)


def _read(path: Path, predicates: dict[str, str]) -> list[str]:
    """Texts of a file's formulas; its predicates are added to ``predicates``."""
    top = Section(path, read_yaml(path, option='--spec', mend=_BRACKETS), _KEYS)
    given = top.section('predicates', optional=True)
    for name in given:
        if name in predicates:
            raise given.wrong('there is one by that name already', name)
        where = f'{path}: predicates.{name}'
        formula = parse(given.text(name, kind='a formula'), SIGNALS, predicates, where)
        _check_name(where, name)
        predicates[name] = str(formula)
    specs = top.section('specs', optional=True)
    texts = [
        _spec_text(f'{path}: specs.{name}', name, specs.text(name, kind='a formula'), predicates)
        for name in specs
    ]
    if not texts and not predicates:
        raise UsageError(f'{path}: has no formulas; write specs: {{NAME: FORMULA}}')
    return texts


def _spec_text(where: str, name: str, text: str, predicates: Mapping[str, str]) -> str:
    # Parsed by itself first, for an error message whose column is that in the file's text.
    return _written_out(where, name, str(parse(text, SIGNALS, predicates, where)))


def _written_out(where: str, name: str, formula: str) -> str:
    text = f'{name}={formula}'
    try:
        parse_spec(text)  # the name may be invalid, or the expanded formula too long
    except UsageError as error:
        raise UsageError(f'{where}: {error}') from None
    return text


def _check_name(where: str, name: str) -> None:
    try:
        parse_formula(name, {name: 'cte > 0'})
    except UsageError:
        raise UsageError(
            f'{where}: choose another name: letters, digits and _, and no signal or operator'
        ) from None


DEFAULT_SPECS = ('phi_eventually',)
DEFAULT_JUDGING = Judging(specs=DEFAULT_SPECS)
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
class CampaignOptions:
    """Options of a campaign: scenes of one program, evaluated with one perception.

    Attributes:
        program: word of a shipped Scenic program or path of one.
        runs: number of scenes.
        seed: seed of the scenes.
        perception: ``truth``, ``taxinet``, a network's file, ``FILE.py:NAME``, or a word of
            :mod:`taxinet_ros.core.user_code`; '' if a standing graph determines it.
        overrides: scenario values that replace drawn ones, in human keys and units.
        gains: steering gains that differ from the defaults.
        judging: judging options of the verdicts.
        out: folder of the campaign, which must be new or empty.
        processes: whether every node runs in its own process.
        images: runs whose camera frames are recorded, one of :data:`IMAGES`.
        controller: ``steering``, ``FILE.py:NAME``, or a word of
            :mod:`taxinet_ros.core.user_code`.
        laid_over: scenario values that override each scene after it was chosen. Unlike
            ``overrides``, they do not remove dimensions from the search; so campaigns that differ
            only in them have otherwise equal scenes.
        timing: when answers take effect.
        arms: if it is an arm, folders of all arms of the experiment in order.
        bags: whether its runs leave bags; those of closed loops without a graph do not.
        world: name of the world of the runs, see :mod:`taxinet_ros.core.world`.
        engine: what makes the runs, one of :data:`ENGINES`.
        audit_percent: share of the runs to repeat on the graph and compare [%]; 0 with the graph.
    """

    program: str
    runs: int
    seed: int
    perception: str
    out: Path
    overrides: Mapping[str, str] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    judging: Judging = DEFAULT_JUDGING
    processes: bool = False
    images: str = 'all'
    laid_over: Mapping[str, str] = field(default_factory=dict)
    controller: str = STEERING
    timing: Timing = AT_ONCE
    arms: tuple[str, ...] = ()
    bags: bool = True
    world: str = KMWH
    engine: str = GRAPH
    audit_percent: float = 0.0

    def check(
        self, first: Scenario, drawn: Callable[[], Collection[str]],
        more: Iterable[Scenario] = (),
    ) -> SpecCheck:
        """Check the requirements and overrides before the first run.

        Args:
            first: scenario of the first run.
            drawn: tells the keys that scenes differ in.
            more: a few more scenes, to see what a network was not trained in.

        Raises:
            UsageError: a requirement cannot be evaluated on such runs, a gain has no effect, or
                the scenario delays the loop of a free run.
        """
        if self.timing.free:
            check_free(first)
        usual_mps = SteeringGains().speed_mps
        if self.gains.get('speed_mps') == usual_mps != first.speed_mps:
            raise UsageError(
                f'steering.speed_mps={usual_mps:g} has no effect: at {usual_mps:g} the '
                f'scenario says the speed, {first.speed_mps:g}; set speed_mps instead'
            )
        known = self.controller == STEERING and not self.standing_graph
        gains = SteeringGains(**self.gains) if known else None
        asked = self.judging.parsed_specs
        if reads_others(asked) and (
            TRAFFIC.key in {**self.overrides, **self.laid_over} or TRAFFIC.key not in drawn()
        ):
            check_others(asked, first)
        found = check_specs(asked, first, gains)
        doubts = doubtful_values({**self.overrides, **self.laid_over})
        unseen = unseen_faults(first) if self.perception == GroundTruth.word else []
        again = find_world(self.world).again_words
        told = [f'{again}, so every frame is recorded'] if again and self.bags else []
        parts = None if self.standing_graph else parts_of(self.controller)
        strange = [] if parts is None else monitor_doubts(parts.monitor, self.perception)
        strange += covering_doubts(first.aircraft_model, first.camera_model)
        strange += network_doubts(self.perception, chain((first,), more))
        return dataclasses.replace(
            found, warnings=(*found.warnings, *doubts, *unseen, *strange, *told)
        )

    def system(self, controller_sha256: str, world_sha256: str) -> System:
        """What drives in its runs.

        Args:
            controller_sha256: recorded hash of its controller.
            world_sha256: recorded hash of the package that provides its world, or ''.
        """
        return System(
            perception=self.perception, controller=self.controller, gains=self.gains,
            controller_sha256=controller_sha256, timing=self.timing, world=self.world,
            world_sha256=world_sha256,
        )

    @property
    def bag_folder(self) -> Path | None:
        """Folder of its bags; None if it makes none."""
        return self.out if self.bags else None

    @property
    def standing_graph(self) -> bool:
        """Whether the graph was started before the campaign, and outlives its broken runs."""
        return not self.perception


def make_options(
    *, program: str, runs: int, seed: int, perception: str, settings: Iterable[str],
    specs: Iterable[str], out: Path | None, processes: bool, images: str = 'all',
    resume: bool | None = None, stop_on: str = StopOn.NEVER, bounds: Iterable[str] = (),
    rates: Iterable[str] = (), controller: str = STEERING, latency: Iterable[str] = (),
    free: bool = False, real_time_factor: str | None = None, world: str = KMWH,
    engine: str = GRAPH, audit: str | None = None,
) -> CampaignOptions:
    """Check the command-line arguments.

    Args:
        program: word of a shipped Scenic program or path of one.
        runs: number of scenes.
        seed: seed of the scenes.
        perception: see :class:`CampaignOptions`.
        settings: ``key=value`` of the scenario, or ``steering.<gain>=value``.
        specs: formulas as text, or files of them; the default if empty.
        out: folder; if None, a new one below ``bags/`` with a descriptive name.
        processes: whether every node runs in its own process.
        images: runs whose camera frames are recorded, one of :data:`IMAGES`.
        resume: continue the campaign in ``out``; None if the command cannot.
        stop_on: ``never``, ``violated`` or ``decided``.
        bounds: assumed bounds of signals, such as ``cte=-25:25``.
        rates: assumed bounds of their change per second, such as ``cte=3``.
        controller: see :class:`CampaignOptions`.
        latency: ``NAME=LATENCY`` of perception or controller.
        free: simulated time follows the wall clock.
        real_time_factor: simulated seconds per second then, or ``max``.
        world: see :class:`CampaignOptions`.
        engine: see :class:`CampaignOptions`.
        audit: share of the runs to audit as text; None for the default of the engine.

    Raises:
        UsageError: one line on the first error.
    """
    overrides, gains = split_settings(settings)
    check_overrides(overrides)
    check_controller(controller, gains, graph=True)
    chosen = find_world(world)
    judging = make_judging(specs, stop_on, bounds, rates)
    timing = check_timing(latency, free=free, factor=real_time_factor)
    if timing.free and processes:
        raise UsageError('--processes: no effect with --free, which always uses processes')
    check_not_free(timing, controller)
    if timing.free and judging.stop_on is not StopOn.NEVER:
        raise UsageError(
            f'--stop-on {judging.stop_on}: not with --free, which does not wait for the monitor'
        )
    if perception:
        check_perception(perception, graph=True)
    if images not in IMAGES:
        raise UsageError(f'--images {images}: unknown; known: {", ".join(IMAGES)}')
    needs_graph = {'--processes': processes, '--free': timing.free}
    for option in (name for name, given in needs_graph.items() if given and engine == LOOP):
        raise UsageError(f'{option}: not with --engine {LOOP}, which has no nodes')
    if engine == LOOP and chosen.again_words:
        raise UsageError(f'--engine {LOOP}: {chosen.again_words}, so it could not be audited')
    audit_percent = check_engine(engine, audit, perception, controller, gains)
    if resume and out is None:
        raise UsageError('--resume: name the campaign to continue with --out')
    if out is None:
        words = (Path(program).stem, short_word(perception), f'seed{seed}')
        stem = '-'.join(word for word in words if word)
        out = new_folder(DEFAULT_ROOT / stem)
    if not resume:
        check_new(out, '' if resume is None else ', or go on with --resume')
    return CampaignOptions(
        program=program, runs=runs, seed=seed, perception=perception, out=out,
        overrides=overrides, gains=gains, judging=judging, processes=processes or timing.free,
        images=recorded_images(chosen, images), controller=controller, timing=timing,
        world=chosen.name,
        engine=engine, audit_percent=audit_percent,
    )


def check_engine(
    engine: str, audit: str | None, perception: str, controller: str,
    gains: Mapping[str, float],
) -> float:
    """Check the arguments on the engine.

    Args:
        engine: see :class:`CampaignOptions`.
        audit: share of the runs to audit: a percentage, with or without its sign; None for the
            default of the engine.
        perception: see :class:`CampaignOptions`.
        controller: likewise.
        gains: likewise.

    Returns:
        Share of the runs to audit [%].

    Raises:
        UsageError: unknown engine, a bad share or one without effect, or a part that only a graph
            can have.
    """
    if engine not in ENGINES:
        raise UsageError(f'--engine {engine}: unknown; known: {", ".join(ENGINES)}')
    if engine == GRAPH:
        if audit is not None:
            raise UsageError(
                f'--audit {audit}: no effect with --engine {GRAPH}, which needs no audit'
            )
        return 0.0
    for role, word in (('perception', perception), ('controller', controller)):
        if is_node_elsewhere(word):
            raise UsageError(
                f'--engine {LOOP}: {role} {word} is a node; use --engine {GRAPH}'
            )
    check_perception(perception)
    check_controller(controller, gains)
    return AUDITED_PERCENT if audit is None else _audit_percent(audit)


def _audit_percent(text: str) -> float:
    try:
        percent = float(text.strip().removesuffix('%'))
    except ValueError:
        percent = math.nan
    if not 0 <= percent <= 100:
        raise UsageError(f'--audit {text}: expected a percentage of the runs, such as 1 or 0.5')
    return percent


def recorded_images(world: ChosenWorld, images: str) -> str:
    """Runs whose camera frames are recorded: all of them, if they cannot be had again."""
    return 'all' if world.again_words else images


def make_judging(
    specs: Iterable[str], stop_on: str = StopOn.NEVER, bounds: Iterable[str] = (),
    rates: Iterable[str] = (),
) -> Judging:
    """Check the judging arguments; see :func:`make_options`.

    Raises:
        UsageError: one line that names the option.
    """
    judging = Judging(
        specs=read_specs(specs) or DEFAULT_SPECS, stop_on=parse_stop_on(stop_on),
        bounds=tuple(bounds), rates=tuple(rates),
    )
    check_assumptions(judging.bounds, judging.rates, judging.parsed_specs)
    return judging


def check_timing(
    latency: Iterable[str], *, free: bool = False, factor: str | None = None
) -> Timing:
    """Parse the timing options.

    Args:
        latency: ``NAME=LATENCY`` of perception or controller.
        free: simulated time follows the wall clock.
        factor: simulated seconds per second then, or ``max``; real time if None.

    Raises:
        UsageError: one line that names the option.
    """
    latency = tuple(latency)
    if factor is not None and not free:
        raise UsageError('--real-time-factor: has no effect without --free')
    if latency and free:
        raise UsageError(f'--latency {latency[0]}: not with --free, which has real delays')
    try:
        return free_timing(factor or '1') if free else parse_latency(latency)
    except UsageError as error:
        raise UsageError(f'--{error}') from None


def check_not_free(timing: Timing, controller: str) -> None:
    """Refuse a monitored controller in a free run.

    Raises:
        UsageError: one line that names the option.
    """
    if timing.free and parts_of(controller) is not None:
        raise UsageError(
            f'--free: not with --controller {controller}: its monitor needs the frame of each '
            'estimate, and a free run may lose frames'
        )


def check_assumptions(
    bounds: Iterable[str], rates: Iterable[str], specs: Sequence[Spec]
) -> Assumptions:
    """Parse assumptions on the signals.

    Args:
        bounds: as in :class:`.Judging`.
        rates: as in :class:`.Judging`.
        specs: requirements that read the signals; empty: not known.

    Raises:
        UsageError: one line that names the option.
    """
    try:
        found = parse_assumptions(bounds, rates)
    except UsageError as error:
        raise UsageError(f'--{error}') from None
    if specs:
        check_assumptions_read(found, specs)
    return found


def check_assumptions_read(found: Assumptions, specs: Sequence[Spec]) -> None:
    """Check that requirements read the signals of assumptions.

    Raises:
        UsageError: one line that names the option without effect.
    """
    try:
        check_read(found, (spec.formula for spec in specs))
    except UsageError as error:
        raise UsageError(f'--{error}') from None


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
            f'--out {out}: already exists; recordings are never overwritten, choose a new folder'
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
        raise UsageError(f'--out {out}: cannot be written: {error.strerror}') from error


def read_settings(settings: Iterable[str]) -> dict[str, str]:
    """Parse ``key=value`` arguments; short forms of scenario keys are expanded.

    Raises:
        UsageError: an argument has another form, or a key is given twice, even by its short form.
    """
    values: dict[str, str] = {}
    for setting in settings:
        key, equals, value = (part.strip() for part in setting.partition('='))
        if not (key and equals and value):
            raise UsageError(f'--set {setting!r}: expected key=value')
        if key in values:
            raise UsageError(f'--set {setting}: {key} is given twice; leave one out')
        values[key] = value
    try:
        return by_key(values)
    except UsageError as error:
        raise UsageError(f'--set: {str(error).removeprefix("scenario: ")}') from None


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
        raise UsageError(f'--set {twice[0]}: the camera has an offset of its own; leave one out')
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
        try:
            gains[name] = typed_gain(name, value)
        except UsageError as error:
            raise UsageError(f'--set {error}') from None
    return overrides, gains
