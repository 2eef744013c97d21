"""Merge the shards of a search into the campaign that it would be without them.

Every file of the shards is checked first, as ``taxinet doctor`` does. The rows are those of the
shards' ledgers, by index, so table and rates are those of the whole search; ``campaign.json`` lists
the shards (``merged``). The new folder appears when it is complete: a merge that was killed leaves
a hidden draft, which the next attempt replaces. The shards are not changed.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.bag.check.findings import ranges
from taxinet_ros.campaign.doctor import examine, locked
from taxinet_ros.campaign.options import check_new, make_out
from taxinet_ros.campaign.record.book import UNKNOWN_TO_SAMPLER, short_json
from taxinet_ros.campaign.record.facts import (
    LEDGER_NAME,
    STACKS,
    recorded_stacks,
    same_fact,
    write_facts,
)
from taxinet_ros.campaign.record.ledger import LedgerContent, read_ledger
from taxinet_ros.campaign.record.shard import (
    EXHAUSTED,
    MERGED,
    SHARD,
    Shard,
    planned_runs,
    recorded_shard,
)
from taxinet_ros.campaign.record.table import write_tables
from taxinet_ros.core.provenance import NAMES, differences
from taxinet_ros.core.scenario_fields import CATALOGUES
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import disk_error, draft_path, sync_folder
from taxinet_ros.files.journal import Journal, journal_end, read_journal

HARDLINK, _COPY, _SYMLINK = WAYS = ('hardlink', 'copy', 'symlink')
"""How the campaign gets the bags."""
_UNLINKABLE = (errno.EXDEV, errno.EPERM, errno.EMLINK)

_OF_ONE_SHARD = (SHARD, STACKS, UNKNOWN_TO_SAMPLER, 'warnings', 'program_text')
"""Facts that may differ between shards: the program's digest covers its text."""
_CALLED = {'perception_sha256': 'weights (perception_sha256)', 'taxinet_ros_version': 'version'}
_VERSIONS = NAMES[NAMES.index('python'):]
"""Names of what must be the same in all shards; a warning tells where machines differ."""


@dataclass(frozen=True, kw_only=True)
class MergedShards:
    """A search merged from its shards.

    Attributes:
        content: content of its ledger.
        planned: indices of the runs planned before the first one.
        warnings: one line each on what users should know.
    """

    content: LedgerContent
    planned: range | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _Part:
    """One complete shard."""

    folder: Path
    shard: Shard
    content: LedgerContent
    events: list[dict[str, Any]]
    indices: range


def merge_shards(
    folders: Sequence[Path], out: Path, *, bags: str = HARDLINK,
    on_bag: Callable[[Path], None] = lambda bag: None,
) -> MergedShards:
    """Merge shards into a new campaign.

    Args:
        folders: their folders, in any order.
        out: folder of the campaign.
        bags: one of :data:`WAYS`.
        on_bag: called with each bag before it is checked, which takes time.

    Raises:
        UsageError: a shard is damaged, incomplete or of another search; runs are missing or in two
            shards; or ``out`` exists.
        OSError: it cannot be written; nothing is left.
    """
    if bags not in WAYS:
        raise UsageError(f'--bags {bags}: unknown; known: {", ".join(WAYS)}')
    check_new(out)
    parts = [_read_part(folder, on_bag) for folder in folders]
    for part in parts[1:]:
        _check_same_search(parts[0], part)
    _check_every_run_once(parts)
    warnings = _check_versions(parts)
    make_out(out.parent)
    draft = draft_path(out.absolute())
    try:
        if draft.exists():
            shutil.rmtree(draft)
        draft.mkdir()
        _take_bags(parts, draft, bags)
        facts = _facts(parts)
        content = _write_record(parts, draft, facts)
        sync_folder(draft)
        draft.rename(out)
        sync_folder(out.parent)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return MergedShards(content=content, planned=planned_runs(facts), warnings=warnings)


# One shard ---------------------------------------------------------------------------------------


def _read_part(folder: Path, on_bag: Callable[[Path], None]) -> _Part:
    """Read a shard, all of which must be intact."""
    path = folder / LEDGER_NAME
    if not path.is_file():
        raise UsageError(f'{folder}: not a campaign: no {LEDGER_NAME}')
    with locked(path):
        part = _complete_part(folder, read_ledger(path), read_journal(path))
        for finding in examine(folder, on_bag).findings:
            raise UsageError(
                f'{finding.where}: {finding.what}; nothing was merged; see taxinet doctor {folder}'
            )
    return part


def _complete_part(folder: Path, content: LedgerContent, events: list[dict[str, Any]]) -> _Part:
    shard = recorded_shard(content.campaign)
    if shard is None:
        raise UsageError(f'{folder}: is no shard, as taxinet falsify --shard makes')
    facts = content.campaign
    indices = shard.runs(int(facts.get(EXHAUSTED, facts['runs'])))
    done = {row.index for row in content.rows if row.outcome is not Outcome.INTERRUPTED}
    if missing := set(indices) - done:
        raise UsageError(
            f'{folder}: shard {shard} is not complete: run {ranges(missing)} has no result; '
            'continue it with --resume'
        )
    if foreign := done - set(indices):
        raise UsageError(f'{folder}: has run {ranges(foreign)}, which is not of shard {shard}')
    return _Part(folder=folder, shard=shard, content=content, events=events, indices=indices)


# All shards --------------------------------------------------------------------------------------


def _check_same_search(one: _Part, other: _Part) -> None:
    before, now = one.content.campaign, other.content.campaign
    for name in dict.fromkeys((*before, *now)):
        if name not in _OF_ONE_SHARD and not same_fact(name, before.get(name), now.get(name)):
            raise UsageError(
                f'{other.folder}: its {_CALLED.get(name, name)} is {short_json(now.get(name))}, '
                f'but {short_json(before.get(name))} in {one.folder}; shards of one search only '
                'differ in --shard'
            )
    if one.content.added != other.content.added:
        name = min(set(one.content.added.items()) ^ set(other.content.added.items()))[0]
        raise UsageError(
            f'{other.folder}: {name} was added (taxinet monitor --add) to only one of it and '
            f'{one.folder}, or differs; add it to both, or to the merged campaign'
        )


def _check_every_run_once(parts: Sequence[_Part]) -> None:
    whose: dict[int, _Part] = {}
    for part in parts:
        if twice := [index for index in part.indices if index in whose]:
            other = whose[twice[0]]
            raise UsageError(
                f'{part.folder}: shard {part.shard} has run {ranges(twice)}, as has shard '
                f'{other.shard} in {other.folder}'
            )
        whose.update(dict.fromkeys(part.indices, part))
    facts = parts[0].content.campaign
    total = int(facts.get(EXHAUSTED, facts['runs']))
    if missing := set(range(total)) - set(whose):
        counts = {part.shard.count for part in parts}
        there = {part.shard.number for part in parts}
        lacking = ranges(set(range(1, 1 + min(counts))) - there) if len(counts) == 1 else ''
        which = f'shard {lacking} of {min(counts)}' if lacking else 'a shard'
        raise UsageError(
            f'{which} is missing: run {ranges(missing)} of {total} is in none of these'
        )


def _check_versions(parts: Sequence[_Part]) -> tuple[str, ...]:
    """Refuse shards of different versions; return a warning about different machines."""
    known: list[Mapping[str, str]] = []
    for part in parts:
        records = recorded_stacks(part.content.campaign).values()
        for record in records:
            if found := differences(*(_versions(each) for each in (*known[:1], record))):
                raise UsageError(
                    f'{part.folder}: was made with other versions than {parts[0].folder}: {found}; '
                    'make it again with the same'
                )
            known.append(record)
    found = differences(*known)
    return (f'the shards were made on different machines: {found}',) if found else ()


def _versions(record: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in record.items() if name in _VERSIONS}


# The campaign ------------------------------------------------------------------------------------


def _facts(parts: Sequence[_Part]) -> dict[str, Any]:
    facts = {
        name: value for name, value in parts[0].content.campaign.items()
        if name not in (SHARD, EXHAUSTED, UNKNOWN_TO_SAMPLER)
    }
    facts[STACKS] = {
        name: record for part in parts
        for name, record in recorded_stacks(part.content.campaign).items()
    }
    facts[MERGED] = [
        {'shard': str(part.shard), 'folder': part.folder.resolve().name,
         'ledger': journal_end(part.folder / LEDGER_NAME)._asdict()}
        for part in parts
    ]
    return facts


def _write_record(parts: Sequence[_Part], folder: Path, facts: Mapping[str, Any]) -> LedgerContent:
    journal = Journal(folder / LEDGER_NAME)
    try:
        for event in ({'event': 'campaign', 'campaign': facts}, *_events(parts)):
            journal.append(event)
        journal.sync()
    finally:
        journal.close()
    write_facts(folder, facts)
    content = read_ledger(folder / LEDGER_NAME)
    write_tables(content.rows, folder, list(facts['specs']))
    return content


def _events(parts: Sequence[_Part]) -> Iterable[dict[str, Any]]:
    """Events of all shards, those of runs by index; what runs refer to comes first."""
    told = [event for part in parts for event in part.events]
    seen = []
    for event in told:
        if event['event'] in CATALOGUES and event not in seen:
            seen.append(event)
    yield from seen
    yield from (event for event in told if event['event'] == 'lost')
    # A stable sort: the starts and results of one run stay in order.
    of_runs = [event for event in told if event['event'] in ('intent', 'result')]
    yield from sorted(of_runs, key=_index)
    for name, formula in parts[0].content.added.items():
        intervals: dict[str, Any] = {}
        for event in told:
            if event['event'] == 'requirement' and event['name'] == name:
                intervals |= event['intervals']
        yield {
            'event': 'requirement', 'name': name, 'formula': formula, 'intervals': intervals,
        }


def _index(event: Mapping[str, Any]) -> int:
    return int(event['index'] if event['event'] == 'intent' else event['row']['index'])


def _take_bags(parts: Sequence[_Part], folder: Path, how: str) -> None:
    for part in parts:
        for row in part.content.rows:
            if row.bag:
                _take_bag(part.folder / row.bag, folder / row.bag, how)


def _take_bag(bag: Path, new: Path, how: str) -> None:
    if how == _SYMLINK:
        new.symlink_to(bag.resolve(), target_is_directory=True)
        return
    new.mkdir()
    for file in sorted(bag.iterdir()):
        try:
            (os.link if how == HARDLINK else shutil.copy2)(file, new / file.name)
        except OSError as error:
            if error.errno in _UNLINKABLE:
                raise UsageError(
                    f'{file}: cannot be hard-linked from there, as on another file system; use '
                    f'--bags {_COPY} or {_SYMLINK}'
                ) from error
            raise disk_error(new / file.name, error) from error
