"""Facts of a campaign: everything that its runs depend on, recorded before the first of them."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.provenance import begun_elsewhere, known, provenance, stack_id
from taxinet_ros.core.renderer import OURS
from taxinet_ros.core.scenario_fields import by_value
from taxinet_ros.core.system import System
from taxinet_ros.core.world import find_world, world_and_camera
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, read_entry, record_kinds
from taxinet_ros.registry import KMWH, WORLDS, find, origins
from taxinet_ros.scenes.programs import SUFFIX
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.version import __version__

FACTS = 'facts'
"""Kind of the entry of a campaign's record with its facts."""

SPARE = 'spare'
"""Kind of a second entry with them, as the runs of a damaged record are useless without; it is
written after the last run, so that no damage of one page affects both."""

BEGUN, ROW = 'begun', 'row'
"""Kinds of entries: a run that was started, and its result."""
_OF_A_CAMPAIGN = frozenset({FACTS, SPARE, BEGUN, ROW})

ARMS = 'experiment_arms'
"""The fact that names the folders of all arms of an experiment, including this campaign's."""

ARM = 'experiment_arm'
"""The fact that names this campaign's arm of an experiment, whose folder has that name."""

EXTENSIONS = 'extensions'
"""The fact that lists the packages of extensions, with their versions and hashes."""

_TYPED = ('overrides', 'laid_over')
"""Facts that have values by scenario key, as somebody typed them."""

WORLD = 'world'
"""The fact that names the world of the runs; absent on a standing graph."""

ENGINE, AUDIT_PERCENT = 'engine', 'audit_percent'
"""The facts that name the engine of the latest session, and the share of its runs to audit."""

WORLD_SHA256 = 'world_sha256'
"""The fact that identifies a world with another camera than its own."""

OBJECTIVE, ODD = 'objective', 'odd'
UNTIL = 'until'
"""The fact that lists the stop rules of a search's sessions; absent without any."""

STACKS = 'stacks'
"""The fact that describes every machine on which runs were made, with libraries and code."""


def campaign_facts(options: CampaignOptions, program: Path, text: str) -> dict[str, Any]:
    """Everything that a campaign's runs depend on, as plain values.

    Args:
        options: options of the campaign.
        program: the Scenic program's file.
        text: the program with all that it runs (:func:`.program_text`).
    """
    return facts_of_runs(options, {
        'program': program.name,
        'program_sha256': hashlib.sha256(text.encode()).hexdigest(),
        'program_text': text,
    })


def facts_of_runs(options: CampaignOptions, scenes: Mapping[str, Any]) -> dict[str, Any]:
    """Everything that runs with scenes from ``scenes`` depend on, as plain values."""
    return {
        'taxinet_ros_version': __version__,
        STACKS: this_stack_record(),
        **scenes,
        'runs': options.runs,
        'seed': options.seed,
        'perception': options.perception,
        'controller': options.controller,
        'controller_sha256': check_controller(options.controller, options.gains, graph=True),
        'overrides': dict(options.overrides),
        'laid_over': dict(options.laid_over),
        'gains': dict(options.gains),
        **options.judging.facts(),
        'timing': options.timing.words,
        'processes': options.processes,
        'images': options.images,
        ENGINE: options.engine,
        AUDIT_PERCENT: options.audit_percent,
        **({ARMS: list(options.arms), ARM: options.out.name} if options.arms else {}),
        **({} if options.bags else {'bags': False}),
        # A standing graph has its own world, which is recorded in the bags.
        **({} if options.standing_graph else _world_facts(options.world)),
        **extension_facts(
            perceptions=options.perception, controllers=options.controller,
            worlds=world_and_camera(options.world)[0], cameras=world_and_camera(options.world)[1],
        ),
    }


def _world_facts(world: str) -> dict[str, str]:
    """The world; one seen by another camera has the hash of both."""
    seen = world_and_camera(world)[1] != OURS
    return {WORLD: world, **({WORLD_SHA256: find_world(world).fingerprint} if seen else {})}


def extension_facts(before: Mapping[str, Any] = {}, **chosen: str) -> dict[str, Any]:
    """Origin of the perception, controller, world or sampler that a package provides.

    Args:
        before: facts that may already contain others.
        chosen: name by extension point.
    """
    found = {**before.get(EXTENSIONS, {}), **origins(**chosen)}
    return {EXTENSIONS: found} if found else {}


def recorded_world(facts: Mapping[str, Any]) -> tuple[str, str]:
    """Name of a campaign's world, and SHA-256 of the packages that provide it, or ''.

    Args:
        facts: facts of the campaign.
    """
    package = facts.get(EXTENSIONS, {}).get(WORLDS, {})
    sha256 = facts.get(WORLD_SHA256, package.get('sha256', ''))
    return str(facts.get(WORLD, KMWH)), str(sha256)


@contextlib.contextmanager
def missing_packages_named(out: Path | None) -> Iterator[None]:
    """Context in which errors for unknown names also name the package that provided them.

    Args:
        out: folder of the campaign that recorded the package, or of several; None for none.

    Raises:
        UsageError: as raised within.
    """
    try:
        yield
    except UsageError as error:
        for folder in () if out is None else (out, *sorted(out.glob('*/'))):
            facts = read_facts(folder) or {}
            for kind, one in facts.get(EXTENSIONS, {}).items():
                if repr(one['name']) in str(error) and find(kind, one['name']) is None:
                    raise UsageError(
                        f'{error}; in {folder} it was {package_words(kind, one)}, which is not '
                        'installed any more'
                    ) from error
        raise


def recorded_system(options: CampaignOptions, facts: Mapping[str, Any]) -> System:
    """What drives in the runs of a campaign, with the hashes of its facts."""
    return options.alone(
        controller_sha256=facts['controller_sha256'], world_sha256=recorded_world(facts)[1],
    )


def package_words(kind: str, told: Mapping[str, str]) -> str:
    """Text on a recorded extension: what it is, its package, and the package's hash."""
    return (
        f'{kind.removesuffix("s")} {told["name"]} of {told["distribution"]} {told["version"]} '
        f'(sha256 {told["sha256"][:12]}…)'
    )


def this_stack() -> str:
    """Name of this process's record among a campaign's stacks."""
    return stack_id(provenance())


def this_stack_record() -> dict[str, dict[str, str]]:
    """The record of this process by name, to be added to those of earlier sessions."""
    return {this_stack(): dict(provenance())}


def same_fact(name: str, one: Any, other: Any) -> bool:
    """Whether two campaigns agree in a fact; typed values by what their texts stand for."""
    if name in _TYPED and isinstance(one, dict) and isinstance(other, dict):
        return by_value(one) == by_value(other)
    if name == 'sampler_options' and isinstance(one, dict) and isinstance(other, dict):
        with contextlib.suppress(ValueError, TypeError):
            one, other = ({key: float(each[key]) for key in each} for each in (one, other))
    return bool(one == other)


def recorded_stacks(facts: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """All stack records of a campaign by name, the oldest first."""
    told = facts.get(STACKS)
    return {str(name): known(one) for name, one in told.items()} if isinstance(told, dict) else {}


def planned_runs(facts: Mapping[str, Any]) -> range | None:
    """Indices of the runs planned before the first one; None if not recorded."""
    planned = facts.get('first_runs', facts.get('runs'))
    return None if planned is None else range(int(planned))


def recorded_rules(facts: Mapping[str, Any]) -> tuple[str, ...]:
    """Stop rules of all sessions of a search, as typed after ``--until``."""
    told = facts.get(UNTIL)
    return tuple(map(str, told)) if isinstance(told, list) else ()


def stack_difference(facts: Mapping[str, Any], what: str) -> str:
    """A warning line if a campaign was made on another machine or version; else ''.

    Args:
        facts: facts of the existing campaign.
        what: name of the object, at the start of the line.
    """
    before = list(recorded_stacks(facts).values())
    words = begun_elsewhere(before or [{}], provenance(), 'the runs so far')
    return f'{what}: {words}' if words else ''


def is_campaign(folder: Path) -> bool:
    """Whether a folder has the record of a campaign, possibly a damaged one."""
    path = folder / RECORD_NAME
    if not path.is_file():
        return False
    try:
        return _facts_of(path) is not None or bool(record_kinds(path) & _OF_A_CAMPAIGN)
    except UsageError:
        return True


def record_beside(path: Path) -> Path | None:
    """Folder of the campaign that a folder, its table or one of its runs belongs to, if any."""
    first = path.resolve().parent if path.is_file() else path.resolve()
    return next((folder for folder in (first, first.parent) if is_campaign(folder)), None)


def read_facts(folder: Path) -> dict[str, Any] | None:
    """Read the facts of the campaign in a folder; None if there is none.

    Raises:
        UsageError: they are damaged.
    """
    path = folder / RECORD_NAME
    return _facts_of(path) if path.is_file() else None


def _facts_of(path: Path) -> dict[str, Any] | None:
    found = read_entry(path, FACTS)
    return read_entry(path, SPARE, FACTS) if found is None else found


def program_attachment(program: str, out: Path) -> dict[str, bytes]:
    """Text of a run's Scenic program by file name, to be attached to its bag.

    A run of a campaign has it from the campaign's folder. Empty for a run requested by hand, or
    if the facts are missing or damaged.

    Args:
        program: name of the program.
        out: folder of the bags.
    """
    try:
        facts = read_facts(out)
        if facts is not None and Path(facts['program']).stem == program:
            text = str(facts['program_text'])
            return {f'{program}{SUFFIX}': text.encode()} if text else {}
    except (UsageError, KeyError, TypeError):
        pass
    return {}
