"""Facts of a campaign, written to ``campaign.json`` and the ledger before its first run.

When a campaign ends, ``campaign.json`` is sealed (:mod:`.sealed_json`): it then has checksums of
    the tables and the end of the ledger.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.campaign.options import CampaignOptions
from taxinet_ros.campaign.scenes.programs import program_digest, program_text
from taxinet_ros.core.controller import check_controller
from taxinet_ros.core.provenance import begun_elsewhere, known, provenance, stack_id
from taxinet_ros.core.scenario_fields import SHORT_FORMS, by_key
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import disk_error, write_atomically
from taxinet_ros.files.sealed_json import SealedJson, read_sealed, sealed_text, write_sealed
from taxinet_ros.registry import KMWH, WORLDS, find, origins
from taxinet_ros.version import __version__

FACTS_NAME = 'campaign.json'
LEDGER_NAME = 'ledger.jsonl'

ARMS = 'experiment_arms'
"""The fact that names the folders of all arms of an experiment, of which the campaign is one."""

EXTENSIONS = 'extensions'
"""The fact that names the packages of what is not shipped, with their versions and hashes."""

_BY_KEY = ('overrides', 'laid_over', 'original', 'nominal', 'steps')
"""Facts that have values by scenario key; ``parameters``, of a shrinking, lists keys."""

WORLD = 'world'
"""The fact that names the world that the runs take place in; versions without a choice had none."""

STACKS = 'stacks'
"""The fact that names every machine, with its libraries and code, on which runs were made."""


def campaign_facts(options: CampaignOptions, program: Path) -> dict[str, Any]:
    """All that a campaign's runs depend on, in plain values.

    Args:
        options: what was asked for.
        program: the Scenic program's file.
    """
    return facts_of_runs(options, {
        'program': program.name,
        'program_sha256': program_digest(program),
        'program_text': program_text(program),
    })


def facts_of_runs(options: CampaignOptions, scenes: Mapping[str, Any]) -> dict[str, Any]:
    """All that runs depend on whose scenes come of ``scenes``, in plain values."""
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
        **({ARMS: list(options.arms)} if options.arms else {}),
        **({} if options.bags else {'bags': False}),
        # A graph that was there before has a world of its own, of which the bags tell.
        **({} if options.standing_graph else {WORLD: options.world}),
        **extension_facts(
            perceptions=options.perception, controllers=options.controller, worlds=options.world
        ),
    }


def extension_facts(before: Mapping[str, Any] = {}, **chosen: str) -> dict[str, Any]:
    """Where perception, controller, world or sampler come from, of those that a package added.

    Args:
        before: facts that may tell of others already.
        chosen: name by extension point.
    """
    found = {**before.get(EXTENSIONS, {}), **origins(**chosen)}
    return {EXTENSIONS: found} if found else {}


def recorded_world(facts: Mapping[str, Any]) -> tuple[str, str]:
    """Name of the world that a campaign's runs take place in, and SHA-256 of who brings it, or ''.

    Args:
        facts: of the campaign.
    """
    package = facts.get(EXTENSIONS, {}).get(WORLDS, {})
    return str(facts.get(WORLD, KMWH)), str(package.get('sha256', ''))


@contextlib.contextmanager
def missing_packages_named(out: Path | None) -> Iterator[None]:
    """Within the ``with``, who refuses a name that nobody has any more says whose it was.

    Args:
        out: folder of the campaign that tells whose, or of several; None for none.

    Raises:
        UsageError: as within.
    """
    try:
        yield
    except UsageError as error:
        for folder in () if out is None else (out, *sorted(out.glob('*/'))):
            told = read_facts(folder)
            for kind, one in (told.values.get(EXTENSIONS, {}) if told else {}).items():
                if repr(one['name']) in str(error) and find(kind, one['name']) is None:
                    raise UsageError(
                        f'{error}; in {folder} it was {package_words(kind, one)}, which is not '
                        'installed any more'
                    ) from error
        raise


def package_words(kind: str, told: Mapping[str, str]) -> str:
    """An extension as a campaign tells of it: what it is, whose, and the hash of its package."""
    return (
        f'{kind.removesuffix("s")} {told["name"]} of {told["distribution"]} {told["version"]} '
        f'(sha256 {told["sha256"][:12]}…)'
    )


def this_stack() -> str:
    """Which of a campaign's stacks this process is."""
    return stack_id(provenance())


def this_stack_record() -> dict[str, dict[str, str]]:
    """The record of this process under its name, to be added to those of earlier sittings."""
    return {this_stack(): dict(provenance())}


def with_present_keys(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Facts with scenario keys as they are written now: before, they had no units."""
    present: dict[str, Any] = {name: by_key(facts[name]) for name in _BY_KEY if name in facts}
    if 'parameters' in facts:
        present['parameters'] = [SHORT_FORMS.get(key, key) for key in facts['parameters']]
    return {**facts, **present}


def recorded_stacks(facts: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """All records in a campaign's facts, by name, the oldest first; empty of older versions."""
    told = facts.get(STACKS)
    return {str(name): known(one) for name, one in told.items()} if isinstance(told, dict) else {}


def stack_difference(facts: Mapping[str, Any], what: str) -> str:
    """One line where what is there was made on another machine or version than this; else ''.

    Args:
        facts: of the campaign as it is there.
        what: names what is there, at the line's beginning.
    """
    before = list(recorded_stacks(facts).values())
    words = begun_elsewhere(before or [{}], provenance(), 'the runs so far')
    return f'{what}: {words}' if words else ''


def read_facts(folder: Path) -> SealedJson | None:
    """What ``campaign.json`` in a folder says; None where there is none.

    Raises:
        UsageError: it is damaged, or cannot be read.
    """
    path = folder / FACTS_NAME
    if (path.is_symlink() or path.exists()) and not path.is_file():
        raise UsageError(f'{path}: is not a regular file')
    try:
        return read_sealed(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise UsageError(f'{path}: {error.strerror}') from error


def write_facts(out: Path, facts: Mapping[str, Any]) -> None:
    """Write ``campaign.json`` into the folder ``out``; it goes on to vouch for the tables.

    Raises:
        OSError: it cannot be written.
        UsageError: what is there is damaged.
    """
    before = read_facts(out)
    files, journals = (before.files, before.journals) if before else ({}, {})
    write_atomically(out / FACTS_NAME, sealed_text(facts, files, journals))


def seal_facts(folder: Path, facts: SealedJson, tables: Iterable[Path]) -> None:
    """Have ``campaign.json`` vouch for the tables and for the ledger, as both are now.

    Raises:
        OSError: it cannot be written.
    """
    path, ledger = folder / FACTS_NAME, folder / LEDGER_NAME
    try:
        write_sealed(path, facts.values, tables, [ledger] if ledger.exists() else [])
    except OSError as error:
        raise disk_error(path, error) from error
