"""The folder of evidence: written as a whole, and read back with every byte checked.

``MANIFEST`` has the SHA-256 of every other file, in the form of ``sha256sum``.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.fault_localisation import JSON_NAME as LOCALISE_NAME
from taxinet_ros.analysis.fault_localisation import localisation_json, localisation_of
from taxinet_ros.analysis.report.page import write_report_page
from taxinet_ros.bag.layout import STORAGE_ID
from taxinet_ros.campaign.options import check_new, make_out
from taxinet_ros.campaign.past_runs.localisation import (
    TRIALS_NAME,
    localize,
    make_localize_options,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.sealed_json import file_sha256, read_sealed, write_sealed
from taxinet_ros.study.evidence.document import (
    JSON_NAME,
    LOCALISED,
    MANIFEST_NAME,
    PAGE_NAME,
    SCHEMA,
    SVG_NAME,
    Collected,
    EvidenceOptions,
    collect,
    json_text,
)
from taxinet_ros.study.evidence.drawing import argument_svg
from taxinet_ros.study.evidence.inputs import (
    CampaignInput,
    Place,
    read_campaigns,
    read_requirement,
    usable_network,
)
from taxinet_ros.study.evidence.page import evidence_report

_LINE = re.compile(r'([0-9a-f]{64})  ([A-Za-z0-9_.-]+(?:/[A-Za-z0-9_.-]+)*)')


def make_evidence(
    options: EvidenceOptions, out: Path, *, localize_runs: int = 0,
    on_progress: Callable[[str, int, int], None] = lambda stage, done, of: None,
) -> Collected:
    """Collect evidence and write its folder, whole or not at all.

    Args:
        options: what is asked for.
        out: its folder, which is new.
        localize_runs: so many failed runs of each campaign, evenly spread, are driven again with
            perfect estimates first; 0 for none.
        on_progress: called with the stage, what is done of it, and how much there is.

    Returns:
        The evidence.

    Raises:
        UsageError: an input is refused, or the folder is not new.
        InfraError: a trial's process died.
        OSError: it cannot be written.
    """
    check_new(out)
    if localize_runs < 0:
        raise UsageError(f'--localize-runs {localize_runs}: needs to be 0 or more')
    if localize_runs and options.localisations:
        raise UsageError('--localize-runs: does not go together with --localize; leave one out')
    requirement = read_requirement(options.requirement) if options.requirement is not None else None
    bags = sum(1 for folder in options.campaigns for _ in folder.glob(f'*/*.{STORAGE_ID}'))
    done = itertools.count(1)
    campaigns = read_campaigns(
        options.campaigns, lambda bag: on_progress('bags', min(next(done), bags), bags)
    )
    make_out(out.absolute().parent)
    draft = Path(tempfile.mkdtemp(prefix=f'.{out.name}-', dir=out.absolute().parent))
    try:
        where: dict[Path, Place] = {}
        for number, one in enumerate(campaigns, 1):
            if localize_runs and one.recorded.counterexamples:
                name = f'{LOCALISED}/campaign-{number}'
                _localize(one, draft / name, localize_runs, options.networks, on_progress)
                where[draft / name] = Place(name)
        options = replace(options, localisations=(*options.localisations, *where))
        found = collect(
            options, out, requirement=requirement, campaigns=campaigns, where=where
        )
        write_evidence(found, draft)
        draft.chmod(0o777 & ~_umask())
        draft.rename(out)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    return found


def _umask() -> int:
    """What a new folder's permissions leave out; a temporary one is its owner's alone."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _localize(
    one: CampaignInput, out: Path, runs: int, networks: tuple[str, ...],
    on_progress: Callable[[str, int, int], None],
) -> None:
    """Drive failed runs of a campaign again, and write the summary and its trials."""
    options = make_localize_options(
        one.folder, runs=runs, words=(), workers=1, out=out,
        perception=usable_network(one.facts, networks),
    )
    trials = localize(
        options, lambda done: on_progress('trials', done, options.wanted), lambda: False
    )
    found = localisation_of(
        options.campaign, options.rows, trials, words=options.words, perception=options.perception
    )
    write_sealed(out / LOCALISE_NAME, localisation_json(found), (), [out / TRIALS_NAME])


def write_evidence(found: Collected, folder: Path) -> None:
    """Write all files of evidence, the manifest last.

    Args:
        found: the evidence.
        folder: its folder, which exists; what is in it already is listed in the manifest.

    Raises:
        OSError: it cannot be written.
    """
    write_atomically(folder / JSON_NAME, json_text(found.content))
    write_atomically(folder / SVG_NAME, argument_svg(found.argument))
    write_page(found, folder / PAGE_NAME, file_sha256(folder / JSON_NAME))
    write_atomically(folder / MANIFEST_NAME, manifest_text(folder))


def write_page(found: Collected, path: Path, json_sha256: str) -> None:
    """Write the page."""
    write_report_page(evidence_report(found, json_sha256), path)


def manifest_text(folder: Path) -> str:
    """Text of the manifest: every file in and below a folder but itself, by name."""
    files = sorted(
        path for path in folder.rglob('*') if path.is_file() and path != folder / MANIFEST_NAME
    )
    return ''.join(
        f'{file_sha256(path)}  {path.relative_to(folder).as_posix()}\n' for path in files
    )


@dataclass(frozen=True, kw_only=True)
class Kept:
    """Evidence as it is on disk.

    Attributes:
        content: values of ``evidence.json``; empty if it cannot be read.
        troubles: what is damaged, missing or too much, one line each.
        files: number of files in the folder and below.
    """

    content: Mapping[str, Any]
    troubles: tuple[str, ...]
    files: int


def read_evidence(folder: Path) -> Kept:
    """Read the folder of evidence and check every file against the manifest.

    Raises:
        UsageError: it is no folder of evidence.
    """
    manifest = folder / MANIFEST_NAME
    if not folder.is_dir():
        raise UsageError(f'{folder}: no such folder; name one that taxinet evidence has written')
    if not any((folder / name).is_file() for name in (MANIFEST_NAME, JSON_NAME)):
        raise UsageError(f'{folder}: no evidence: neither {MANIFEST_NAME} nor {JSON_NAME} is there')
    troubles = _manifest_troubles(folder) if manifest.is_file() else [f'{manifest}: is missing']
    content: Mapping[str, Any] = {}
    if (folder / JSON_NAME).is_file():
        try:
            content = _read_json(folder / JSON_NAME)
        except UsageError as error:
            troubles.append(str(error))
    return Kept(
        content=content, troubles=tuple(dict.fromkeys(troubles)),
        files=sum(path.is_file() for path in folder.rglob('*')),
    )


def _manifest_troubles(folder: Path) -> list[str]:
    """Files that are missing, others than listed, or not listed."""
    manifest = folder / MANIFEST_NAME
    listed, troubles = _read_manifest(manifest)
    for name in (JSON_NAME, PAGE_NAME, SVG_NAME):
        if name not in listed:
            troubles.append(f'{manifest}: does not list {name}')
    for name, sha256 in listed.items():
        path = folder / name
        if not path.is_file():
            troubles.append(f'{path}: is missing, but listed in {MANIFEST_NAME}')
        elif file_sha256(path) != sha256:
            troubles.append(f'{path}: is not the file that {MANIFEST_NAME} lists')
    there = {path.relative_to(folder).as_posix() for path in folder.rglob('*') if path.is_file()}
    more = sorted(there - set(listed) - {MANIFEST_NAME})
    return [*troubles, *(f'{folder / name}: is not listed in {MANIFEST_NAME}' for name in more)]


def _read_manifest(path: Path) -> tuple[dict[str, str], list[str]]:
    found: dict[str, str] = {}
    try:
        text = path.read_bytes().decode('ascii')
    except UnicodeDecodeError:
        return {}, [f'{path}: damaged: is no text']
    troubles = [] if text.endswith('\n') else [f'{path}: damaged: its end is missing']
    for number, line in enumerate(text.removesuffix('\n').split('\n'), 1):
        match = _LINE.fullmatch(line)
        if match is None or '..' in match[2].split('/') or match[2] in found:
            troubles.append(f'{path}:{number}: damaged line')
        else:
            found[match[2]] = match[1]
    return found, troubles


def _read_json(path: Path) -> Mapping[str, Any]:
    sealed = read_sealed(path)
    if not sealed.sealed:
        raise UsageError(f'{path}: has no checksum of itself')
    schema = sealed.values.get('schema')
    if schema != SCHEMA:
        raise UsageError(f'{path}: is of schema {schema!r}, this version reads {SCHEMA}')
    return sealed.values
