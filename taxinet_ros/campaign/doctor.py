"""Check a folder of results, and repair it without losing a recorded byte.

Checks, in the folder and its subfolders: every journal (ledgers, trials, stages, rounds, finished
images), every sealed JSON file and the files it has checksums of, a campaign's tables against its
ledger, each bag against its row, each picture of a dataset against its label, the recorded outputs
of a study, and drafts left by a killed process. Everything else, such as derived pages and plots,
is listed as not checked.

Repair trusts the ledger. Tables and ``campaign.json`` are rewritten from it. A journal with
damaged lines is kept as a copy, and its intact lines are written to a new one. A table or
``campaign.json`` with different content is kept as a copy too, and losses are recorded in the
ledger, so that neither doctor nor gate takes it for complete.

If ``campaign.json`` and the tables agree but the ledger belongs to another campaign, the former are
trusted.
"""

from __future__ import annotations

import fcntl
import io
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.check.findings import Finding, ranges
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.layout import METADATA_FILE, STORAGE_ID
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.campaign.experiment import JSON_NAME, PAGE_NAME, PAIRS_NAME
from taxinet_ros.campaign.options import AUDIT_FOLDER
from taxinet_ros.campaign.past_runs.judged_run import bag_differences
from taxinet_ros.campaign.record.facts import ARMS, FACTS_NAME, LEDGER_NAME, read_facts, write_facts
from taxinet_ros.campaign.record.ledger import (
    LedgerContent,
    ledger_content,
    lost_event,
    possible_events,
    read_ledger,
)
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import (
    CSV_NAME,
    PARQUET_NAME,
    csv_text,
    read_any_table,
    table,
    write_tables,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import DRAFTS, write_atomically
from taxinet_ros.files.journal import (
    JournalContent,
    JournalEnd,
    chained_line,
    lost_end,
    parse_journal,
)
from taxinet_ros.files.sealed_json import SealedJson, file_sha256, read_sealed

MEND = 'taxinet doctor --mend {folder}'
"""Repair command; the folder's path is filled in."""

_LABELS, _IMAGE, _DIGEST = 'labels.parquet', 'image', 'sha256'
_DATASET, _REQUEST, _STAGES = 'dataset.json', 'request.json', 'stages.jsonl'
_RESUME = 'the command that made it, with --resume'
_DERIVED = ('.html', '.png', '.svg', '.pdf', '.gif', '.mp4', '.xml', '.csv', '.scenic')
_MOST_NAMED = 6


@dataclass(kw_only=True)
class Examination:
    """Items checked, and findings.

    Attributes:
        looked_at: number of items checked, by kind.
        findings: errors found.
        notes: remarks that are not errors.
        checked: files and bag folders verified against a record.
        unchecked: all others.
    """

    looked_at: dict[str, int] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    checked: set[Path] = field(default_factory=set)
    unchecked: list[Path] = field(default_factory=list)

    def count(self, what: str, number: int = 1, path: Path | None = None) -> None:
        """Count items checked."""
        self.looked_at[what] = self.looked_at.get(what, 0) + number
        if path is not None:
            self.checked.add(path)

    def report(self, where: object, what: object, mend: str = '') -> None:
        """Add a finding, without repeating a place with which its text starts."""
        text = str(what).removeprefix(f'{where}:').strip().partition('; ')[0]
        self.findings.append(Finding(where=str(where), what=text, mend=mend))


def examine(folder: Path, on_bag: Callable[[Path], None] = lambda bag: None) -> Examination:
    """Check everything in a folder.

    Args:
        folder: folder of a campaign, an experiment, a dataset or a study, or a parent of such.
        on_bag: called with each bag before it is checked, which takes time.

    Raises:
        UsageError: it contains nothing to check.
    """
    found, places = Examination(), list(_places(folder))
    for place in places:
        journals = _files(place, '*.jsonl', found)
        for path in journals:
            found.count('journals', path=path)
            if path.name != LEDGER_NAME:
                for number, why in parse_journal(path.read_bytes()).troubles:
                    found.report(f'{path}:{number}', why, MEND)
            if path.name == _STAGES:
                _check_stages(path, found)
        _check_sealed(place, found)
        if place / LEDGER_NAME in journals:
            _check_campaign(place, found, on_bag)
        _check_experiment(place, found)
        _check_pictures(place, found)
        _check_drafts(place, found)
    if not found.looked_at:
        raise UsageError(
            f'{folder}: contains no campaign, experiment, dataset or study, so there is nothing to '
            'check'
        )
    for place in places:
        _name_unchecked(place, set(places), found)
    return found


def mend(folder: Path) -> list[str]:
    """Repair journals, tables and ``campaign.json`` in a folder and all folders below.

    Returns:
        Lines on what was repaired.

    Raises:
        UsageError: the folder is in use.
    """
    done: list[str] = []
    for place in _places(folder):
        _check_regular(place)
        for path in sorted(place.glob('[!.]*.jsonl')):
            with locked(path):
                done += _mend_journal(path)
                if path.name == LEDGER_NAME:
                    done += _mend_campaign(place)
    return done


def _places(folder: Path) -> Iterator[Path]:
    """The folder and its subfolders, except bags and those of audits, which are no record."""
    if not folder.is_dir():
        raise UsageError(f'{folder}: no such folder; name that of a campaign, experiment or study')
    yield folder
    for path in sorted(folder.iterdir()):
        if path == folder / AUDIT_FOLDER.name and folder.name == AUDIT_FOLDER.parent.name:
            continue
        if path.is_dir() and not path.is_symlink() and not _is_bag(path):
            yield from _places(path)


def _is_bag(folder: Path) -> bool:
    """Whether a folder is a bag; a stray bag file in a folder with records does not count."""
    if not any(folder.glob(f'*.{STORAGE_ID}')):
        return False
    kinds = ('.jsonl', '.json', '.parquet')
    return not any(path.is_dir() or path.suffix in kinds for path in folder.iterdir())


def _files(place: Path, pattern: str, found: Examination) -> list[Path]:
    """Regular files by name; others, such as pipes, may block and are not read."""
    files = []
    for path in sorted(place.glob(pattern)):
        if path.is_file():
            files.append(path)
        else:
            found.count('entries that are no files')
            found.report(path, 'is not a regular file, and was not read')
    return files


def _check_regular(place: Path) -> None:
    for path in sorted(place.iterdir()):  # a glob for a name skips dangling links
        known = path.suffix == '.jsonl' or path.name in (FACTS_NAME, CSV_NAME, PARQUET_NAME)
        if known and not path.is_file():
            raise UsageError(f'{path}: is not a regular file; move it away, then repair the rest')


# Campaigns ---------------------------------------------------------------------------------------


def _check_campaign(
    folder: Path, found: Examination, on_bag: Callable[[Path], None]
) -> None:
    path = folder / LEDGER_NAME
    parsed = parse_journal(path.read_bytes())
    for number, why in parsed.troubles:
        found.report(f'{path}:{number}', why, MEND)
    if parsed.unprotected:
        found.notes.append(f'{path}: its first {parsed.unprotected} lines have no checksums')
    content = _content(folder, parsed, found)
    found.count('runs', len(content.rows))
    if not parsed.troubles:
        _check_tables(folder, content, found)
    for row in content.rows:
        if row.bag:
            on_bag(folder / row.bag)
            _check_bag(folder / row.bag, row, content.campaign, found)
    _check_runs(folder, content, found)


def _content(folder: Path, parsed: JournalContent, found: Examination) -> LedgerContent:
    """Content of the ledger's intact lines."""
    path = folder / LEDGER_NAME
    try:
        if not parsed.troubles:
            return read_ledger(path)
    except UsageError as error:
        where, _, what = str(error).partition(': ')
        if not any(where.startswith(one.where) for one in found.findings):
            found.report(where, what, MEND)
    facts = _trusted_facts(folder)
    own = facts.values if facts else {}
    return ledger_content(path, possible_events(_sound_events(parsed)[0], own))


def _check_tables(folder: Path, content: LedgerContent, found: Examination) -> None:
    """Check that the tables agree with the ledger."""
    names = [name for name in (CSV_NAME, PARQUET_NAME) if not (folder / name).is_file()]
    if names or not (folder / FACTS_NAME).is_file():
        names += [] if (folder / FACTS_NAME).is_file() else [FACTS_NAME]
        why = '' if content.finished else ' (the campaign has not ended in good order)'
        found.report(folder, f'{", ".join(names)} not there{why}', MEND)
    expected = table(content.rows, list(content.campaign.get('specs', {})))
    for name, same in ((CSV_NAME, _same_csv), (PARQUET_NAME, _same_parquet)):
        path = folder / name
        if path.is_file():
            found.count('tables', path=path)
            if not same(path, expected):
                more = _only_there(path, content)
                also = f': it has run {ranges(more)}, and the ledger has not' if more else ''
                found.report(path, f'does not say what the ledger says{also}', MEND)


def _only_there(path: Path, content: LedgerContent) -> list[int]:
    """Runs in a table but not in the ledger."""
    import pandas as pd

    try:
        csv = path.name == CSV_NAME
        frame = pd.read_csv(path, usecols=['index']) if csv else read_any_table(path)
        there = {int(index) for index in frame['index']}
    except (OSError, UsageError, ValueError, LookupError):
        return []
    return sorted(there - {row.index for row in content.rows})


def _same_csv(path: Path, expected: Any) -> bool:
    import pandas as pd

    def cells(text: str) -> Any:
        return pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)

    try:
        there = cells(path.read_text(encoding='utf-8'))
        wanted = cells(csv_text(expected))
        return bool(there.equals(wanted[list(there.columns)]) and len(there.columns))
    except (OSError, ValueError, KeyError):
        return False


def _same_parquet(path: Path, expected: Any) -> bool:
    try:
        there = read_any_table(path)
        return bool(there.equals(expected[list(there.columns)]))
    except (UsageError, KeyError):
        return False


def _check_bag(
    bag: Path, row: RunRow, facts: Mapping[str, Any], found: Examination
) -> None:
    """Check that a bag is intact and belongs to its row."""
    found.count('bags', path=bag)
    command = f'taxinet bag doctor {bag}'
    if not bag.is_dir():
        found.report(bag, f'is missing, but its run is {row.outcome}')
        return
    try:
        if row.outcome.judged and (wrong := check_bag(bag).findings):
            more = f' and {len(wrong) - 1} more' if len(wrong) > 1 else ''
            found.report(bag, f'{wrong[0].where}: {wrong[0].what}{more}', command)
        for what in bag_differences(row, facts, open_recording(bag)):
            found.report(bag, what)
    except (BagError, UsageError) as error:
        if row.outcome.judged:  # a broken run may lack messages
            found.report(bag, error, command)


def _check_runs(folder: Path, content: LedgerContent, found: Examination) -> None:
    """Check for intents without result, results without intent, and bags with neither."""
    for line in content.lost:
        if line in content.incomplete:
            found.report(folder / LEDGER_NAME, line.replace('; ', ', '))
        else:
            found.notes.append(f'{folder / LEDGER_NAME}: {line}')
    if content.unfinished:
        said = f'run {ranges(content.unfinished)}: started but has no result'
        if content.finished:
            found.report(folder / LEDGER_NAME, said, 'the command that made it, with --resume')
        else:
            found.notes.append(f'{folder / LEDGER_NAME}: {said}; --resume runs it again')
    if content.never_begun:
        said = f'run {ranges(content.never_begun)}: has a result but no record of its start'
        found.report(folder / LEDGER_NAME, said)
    known = {row.bag for row in content.rows}
    for bag in sorted({file.parent for file in folder.glob(f'*/*.{STORAGE_ID}')}):
        if bag.name not in known and '.broken-' not in bag.name:
            found.notes.append(f'{bag}: a bag without a result in the ledger{_verdict_of(bag)}')


def _verdict_of(bag: Path) -> str:
    """Short text on the verdict in a bag."""
    try:
        told = open_recording(bag).facts
    except (BagError, UsageError):
        return ''
    if told is None or not told.outcome:
        return ''
    rho = ', '.join(f'{name} {one.interval.upper:+.3f}' for name, one in told.judged.items())
    return f'; it says {told.outcome}{f" ({rho})" if rho else ""}'


# Everything else ---------------------------------------------------------------------------------


def _check_sealed(place: Path, found: Examination) -> None:
    """Check sealed JSON files, and the files and journals they have checksums of."""
    for path in _files(place, '*.json', found):
        data = path.read_bytes()
        if b'"seal"' not in data and b'"checksum"' not in data:
            if path.name == FACTS_NAME:
                found.notes.append(f'{path}: of an earlier version, without a checksum')
            continue
        found.count('indices', path=path)
        mended = MEND if path.name == FACTS_NAME else 'the command that made it, again'
        try:
            sealed = read_sealed(path)
        except UsageError as error:
            found.report(path, error, mended)
            continue
        found.checked |= {place / name for name in sealed.files}
        for name, digest in sealed.files.items():
            if not (place / name).is_file():
                found.report(place / name, f'is missing, but listed in {path.name}', mended)
            elif file_sha256(place / name) != digest:
                found.report(place / name, f'is not the file recorded in {path.name}', mended)
        for name, ended in sealed.journals.items():
            journal = place / name
            data = journal.read_bytes() if journal.is_file() else b''
            if why := lost_end(parse_journal(data), ended):
                found.report(journal, why, MEND if data else '')


def _check_experiment(place: Path, found: Examination) -> None:
    """Check that an experiment's sealed file exists if its arms and files imply it."""
    index = place / JSON_NAME
    if index in found.checked:
        return
    left = [name for name in (PAIRS_NAME, PAGE_NAME) if (place / name).is_file()]
    arms = _arms(place)
    if not (left or arms):
        return
    found.count('experiments without an index')
    there = [name for name, content in arms.items() if content is not None]
    missing = [name for name in arms if name not in there]
    # An arm starts when the previous one has completed all its runs.
    gone = [name for name in missing if any(name in _arms_before(arms, later) for later in there)]
    for name in gone:
        found.report(place / name, f'is not there, an arm of the experiment of {there[-1]}')
    counts = {len(content.rows) for content in arms.values() if content is not None}
    if left or gone or (not missing and len(counts) == 1):
        why = f'{", ".join(there)} have had their runs' if not gone else 'an arm is gone'
        why = f'{left[0]} is there' if left else why
        found.report(index, f'has no record of the experiment, although {why}', _RESUME)
    else:
        # An experiment interrupted between two arms looks the same; --resume gives the same result.
        which = f', without {" and ".join(missing)}' if missing else ''
        found.notes.append(f'{place}: an unfinished experiment{which}; continue with --resume')


def _arms(place: Path) -> dict[str, LedgerContent | None]:
    """The arms of the experiment in a folder, in recorded order; None for a missing one."""
    for path in sorted(place.glob(f'*/{LEDGER_NAME}')):
        names = _arm_content(path).campaign.get(ARMS, [])
        if isinstance(names, list) and path.parent.name in names:
            ledgers = {str(name): place / str(name) / LEDGER_NAME for name in names}
            return {
                name: _arm_content(ledger) if ledger.is_file() else None
                for name, ledger in ledgers.items()
            }
    return {}


def _arm_content(path: Path) -> LedgerContent:
    """Content of a ledger's intact lines; its damage is reported elsewhere."""
    return _content(path.parent, parse_journal(path.read_bytes()), Examination())


def _arms_before(arms: Mapping[str, object], name: str) -> list[str]:
    return list(arms)[:list(arms).index(name)]


def _check_pictures(place: Path, found: Examination) -> None:
    """Check a dataset's pictures against its labels."""
    if not (place / _LABELS).is_file():
        if (place / _REQUEST).is_file() and not (place / _DATASET).is_file():
            found.notes.append(f'{place}: an unfinished dataset; continue with --resume')
        return
    if not (place / _DATASET).is_file():
        found.report(place / _LABELS, f'cannot be verified: {_DATASET} is not there', _RESUME)
    import pandas as pd

    try:
        labels = pd.read_parquet(place / _LABELS, columns=[_IMAGE, _DIGEST])
    except Exception:  # third-party reader on untrusted bytes; reported with the index
        return
    for name, digest in zip(labels[_IMAGE], labels[_DIGEST], strict=True):
        path = place / str(name)
        found.count('pictures', path=path)
        if not path.is_file():
            found.report(path, f'is missing, but listed in {_LABELS}')
        elif file_sha256(path) != digest:
            found.report(path, f'is not the image recorded in {_LABELS}')


def _check_stages(path: Path, found: Examination) -> None:
    """Check that the outputs of a study's finished stages exist and are unchanged."""
    last = {
        line.event['stage']: line.event for line in parse_journal(path.read_bytes()).lines
        if line.event is not None and 'stage' in line.event
    }
    for stage, event in last.items():
        for name, digest in event.get('outputs', {}).items():
            output = path.parent / name
            found.checked.add(output)
            if not output.is_file():
                found.report(output, f'is missing, but was made by stage {stage}', _RESUME)
            elif file_sha256(output) != digest:
                found.report(output, f'is not the file made by stage {stage}', _RESUME)


def _name_unchecked(place: Path, places: set[Path], found: Examination) -> None:
    """Report all files in a folder that cannot be verified."""
    told = {Path(one.where) for one in found.findings}
    left = [
        path for path in sorted(place.iterdir())
        if path not in found.checked | places | told
    ]
    found.unchecked += left
    derived = [path for path in left if path.suffix in _DERIVED]
    for names, what in ((derived, 'made from the rest'), (
        [path for path in left if path not in derived], 'no record to verify against'
    )):
        if names:
            more = len(names) - _MOST_NAMED
            listed = ', '.join(path.name for path in names[:_MOST_NAMED])
            also = f' and {more} more' if more > 0 else ''
            found.notes.append(f'{place}: not checked, {what}: {listed}{also}')


def _check_drafts(place: Path, found: Examination) -> None:
    """Report files that a killed process was writing."""
    bags = {file.parent for file in place.glob(f'*/*.{STORAGE_ID}')}
    for folder in (place, *sorted(bags)):
        for path in sorted({path for words in DRAFTS for path in folder.glob(words)}):
            mended = f'taxinet bag doctor {folder}' if Path(METADATA_FILE).stem in path.name else ''
            found.report(path, 'left by a killed process; not used', mended)


# Mending -----------------------------------------------------------------------------------------


def _sound_events(content: JournalContent) -> tuple[list[dict[str, Any]], list[int]]:
    """Events of a journal's intact lines in writing order, without duplicates.

    Returns:
        The events, and the numbers of the lines that are damaged.
    """
    damaged = [at for at, line in enumerate(content.lines, 1) if line.event is None]
    old = [line.event for line in content.lines if line.event is not None and not line.link]
    left = {line.link: line.event for line in content.lines if line.event is not None and line.link}
    link, events = content.links[0], old
    while left:
        after = next((one for one in left if chained_line(link, left[one])[1] == one), None)
        link = after if after is not None else next(iter(left))
        events.append(left.pop(link))
    return events, damaged


def _mend_journal(path: Path) -> list[str]:
    """Keep a copy of a damaged journal and rewrite its intact lines; lines on the repair."""
    content = parse_journal(path.read_bytes())
    why = [f'line {number}: {words}' for number, words in content.troubles]
    events, damaged = _sound_events(content)
    if path.name == LEDGER_NAME:
        return _mend_ledger(path, content, why)
    if not why:
        return []
    return [_write_anew(path, events, damaged, _free_name(path))]


def _write_anew(path: Path, events: list[dict[str, Any]], damaged: list[int], aside: Path) -> str:
    shutil.copyfile(path, aside)
    write_atomically(path, b''.join(_chained(events)[0]))
    lost = f'; lost: line {ranges(damaged)}' if damaged else ''
    return f'{path}: copied to {aside.name}; its intact lines were rewritten{lost}'


def _chained(events: list[dict[str, Any]]) -> tuple[list[bytes], list[str]]:
    """The lines of a new journal, and the chain hash after each prefix."""
    lines, links = [], [JournalContent().end.link]
    for event in events:
        line, link = chained_line(links[-1], event)
        lines.append(line)
        links.append(link)
    return lines, links


def _mend_ledger(path: Path, content: JournalContent, why: list[str]) -> list[str]:
    """Like :func:`_mend_journal`; permanent losses are recorded in the ledger."""
    sound, damaged = _sound_events(content)
    trusted, facts = _trusted_facts(path.parent), _sealed_facts(path.parent)
    events = possible_events(sound, trusted.values if trusted else {})
    if len(events) < len(sound):
        why.append(
            f'{len(sound) - len(events)} lines are invalid or belong to another campaign'
        )
    foreign = any(event['event'] == 'campaign' and event not in events for event in sound)
    if restored := _with_facts(events, facts):
        events = restored
        why.append(f'what the campaign is was put back from {FACTS_NAME}')
    ended = facts.journals.get(path.name) if facts else None
    end = _end_trouble(content, events, ended)
    missing = _missing_runs(path.parent, events)
    if ended is None and (why or _needs_tables(path.parent, events)):
        why.append(f'no {FACTS_NAME} recorded its end, so its end is unverified')
    if missing:
        why.append(f'without a result that was in the tables: run {ranges(missing)}')
    why += [end] if end else []
    if not why:
        return []
    incomplete = bool(missing or foreign or (end and not _known_to_tables(path.parent, events)))
    aside = _free_name(path)
    said = f'{"; ".join(why)}; the original is kept as {aside.name}'
    events.append(lost_event(said, missing, incomplete=incomplete))
    return [_write_anew(path, events, damaged, aside)]


def _with_facts(
    events: list[dict[str, Any]], facts: SealedJson | None
) -> list[dict[str, Any]] | None:
    """Events with the campaign's lost facts restored; None if they are not lost."""
    if facts is None or any(event['event'] == 'campaign' for event in events):
        return None
    restored = possible_events([{'event': 'campaign', 'campaign': facts.values}, *events])
    return restored if len(restored) == 1 + len(events) else None


def _needs_tables(folder: Path, events: list[dict[str, Any]]) -> bool:
    """Whether the repair will rewrite ``campaign.json`` and the tables."""
    trouble = Examination()
    _check_sealed(folder, trouble)
    _check_tables(folder, ledger_content(folder / LEDGER_NAME, events), trouble)
    return bool(trouble.findings)


def _end_trouble(
    content: JournalContent, events: list[dict[str, Any]], ended: JournalEnd | None
) -> str:
    """Text on the difference of the intact lines from the ledger's recorded end, or ''."""
    why = lost_end(content, ended) if ended else ''
    if not ended or content.unprotected:
        return why
    links = _chained(events)[1]
    if len(links) > ended.lines >= 0:
        same = links[ended.lines] == ended.link
        return '' if same else f'its first {ended.lines} lines are not those that it had'
    return why or f'{ended.lines + 1 - len(links)} of the {ended.lines} lines that it had are lost'


def _sealed_facts(folder: Path) -> SealedJson | None:
    """An intact ``campaign.json`` with a checksum."""
    try:
        facts = read_facts(folder)
    except UsageError:
        return None
    return facts if facts and facts.sealed else None


def _trusted_facts(folder: Path) -> SealedJson | None:
    """An intact ``campaign.json`` whose tables belong to its campaign and are intact."""
    facts = _sealed_facts(folder)
    if facts is None or not facts.files:
        return None
    there = [folder / name for name in facts.files]
    same = all(path.is_file() and file_sha256(path) == facts.files[path.name] for path in there)
    return facts if same else None


def _missing_runs(folder: Path, events: list[dict[str, Any]]) -> list[int]:
    """Runs in a table but not in these events."""
    content = ledger_content(folder / LEDGER_NAME, events)
    there = (folder / name for name in (CSV_NAME, PARQUET_NAME))
    return sorted({
        index for path in there if path.is_file() for index in _only_there(path, content)
    })


def _known_to_tables(folder: Path, events: list[dict[str, Any]]) -> bool:
    """Whether the verified tables contain no more than these events."""
    content = ledger_content(folder / LEDGER_NAME, events)
    expected = table(content.rows, list(content.campaign.get('specs', {})))
    path = folder / PARQUET_NAME
    return bool(_trusted_facts(folder) and path.is_file() and _same_parquet(path, expected))


def _mend_campaign(folder: Path) -> list[str]:
    """Rewrite tables and ``campaign.json`` from an intact ledger; lines on the repair."""
    path, trouble = folder / FACTS_NAME, Examination()
    events = [line.event for line in parse_journal((folder / LEDGER_NAME).read_bytes()).lines]
    content = ledger_content(folder / LEDGER_NAME, [event for event in events if event])
    _check_sealed(folder, trouble)
    _check_tables(folder, content, trouble)
    told = [event['campaign'] for event in events if event and event['event'] == 'campaign']
    foreign = _is_foreign(folder, told)
    if not foreign and not trouble.findings:
        return []
    if not (content.campaign or path.is_file()):
        return [f'{folder}: its ledger does not say what the campaign is; no {FACTS_NAME}']
    done = _back_up(folder, content, foreign)
    if foreign:
        path.unlink()
        if not content.campaign:
            return [*done, f'{folder}: its ledger does not say what the campaign is']
    if content.campaign:
        write_facts(folder, content.campaign)
    write_tables(content.rows, folder, list(content.campaign.get('specs', {})))
    return [*done, f'{folder}: {FACTS_NAME}, {CSV_NAME} and {PARQUET_NAME} rewritten']


def _is_foreign(folder: Path, told: list[dict[str, Any]]) -> bool:
    """Whether ``campaign.json`` is damaged, or contradicts the ledger."""
    try:
        facts = read_facts(folder)
    except UsageError:
        return True
    return bool(facts is not None and facts.sealed and told and facts.values not in told)


def _back_up(folder: Path, content: LedgerContent, foreign: bool) -> list[str]:
    """Copy files with different content before they are overwritten; lines on the repair."""
    expected = table(content.rows, list(content.campaign.get('specs', {})))
    changed = [folder / FACTS_NAME] if foreign or _other_facts(folder, content) else []
    for name, same in ((CSV_NAME, _same_csv), (PARQUET_NAME, _same_parquet)):
        if (folder / name).is_file() and not same(folder / name, expected):
            changed.append(folder / name)
    done = []
    for path in changed:
        aside = _free_name(path)
        shutil.copyfile(path, aside)
        done.append(f'{path}: copied to {aside.name}')
    return done


def _other_facts(folder: Path, content: LedgerContent) -> bool:
    """Whether an intact ``campaign.json`` has more facts than its replacement."""
    facts = read_facts(folder)
    if facts is None:
        return False
    ended = facts.journals.get(LEDGER_NAME)
    parsed = parse_journal((folder / LEDGER_NAME).read_bytes())
    changed = bool(content.campaign) and facts.values != content.campaign
    return changed or bool(ended and lost_end(parsed, ended))


def _free_name(path: Path) -> Path:
    number = 1
    while (aside := path.with_name(f'{path.name}.damaged-{number}')).exists():
        number += 1
    return aside


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock a journal against appends by others."""
    with path.open('rb') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UsageError(f'{path}: in use by another process; wait until it ends') from error
        yield
