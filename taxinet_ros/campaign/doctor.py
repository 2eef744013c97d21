"""Checks a whole folder of results, and mends what can be mended without losing a recorded byte.

Looked at are, in the folder and in all below it: every journal (ledgers, trials, stages, rounds,
finished images), every sealed JSON file and the files that it vouches for, a campaign's tables
against its ledger, each bag against its row, each picture of a dataset against its label, and
drafts that a killed process has left.

Mending trusts the ledger. Tables and ``campaign.json`` are written anew from it. A journal with
damaged lines is put aside as it is, and its sound lines are written into a new one.
"""

from __future__ import annotations

import fcntl
import io
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.bag.checkup import check_bag
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.facts import read_facts as read_run
from taxinet_ros.bag.findings import Finding, ranges
from taxinet_ros.bag.layout import METADATA_FILE, STORAGE_ID, write_bytes_atomically
from taxinet_ros.campaign.facts import FACTS_NAME, LEDGER_NAME, read_facts, write_facts
from taxinet_ros.campaign.journal import JournalContent, chained_line, lost_end, parse_journal
from taxinet_ros.campaign.judged_run import bag_differences
from taxinet_ros.campaign.ledger import (
    LedgerContent,
    ledger_content,
    lost_event,
    possible_events,
    read_ledger,
)
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.sealed_json import file_sha256, read_sealed
from taxinet_ros.campaign.table import (
    CSV_NAME,
    PARQUET_NAME,
    csv_text,
    read_any_table,
    table,
    write_tables,
)
from taxinet_ros.core.errors import UsageError

MEND = 'taxinet doctor --mend {folder}'
"""The command that mends, with the folder's path to be filled in."""

_LABELS, _IMAGE, _DIGEST = 'labels.parquet', 'image', 'sha256'
_DRAFTS = ('*.tmp', '.*.part.*', '.*.draft')


@dataclass(kw_only=True)
class Examination:
    """What was looked at, and what came of it.

    Attributes:
        looked_at: how many there were, by what they are.
        findings: what is wrong.
        notes: what is not wrong, and yet to be known.
    """

    looked_at: dict[str, int] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def saw(self, what: str, number: int = 1) -> None:
        """Count what was looked at."""
        self.looked_at[what] = self.looked_at.get(what, 0) + number

    def wrong(self, where: object, what: object, mend: str = '') -> None:
        """One more finding; words that begin with the place do not repeat it."""
        text = str(what).removeprefix(f'{where}:').strip().partition('; ')[0]
        self.findings.append(Finding(where=str(where), what=text, mend=mend))


def examine(folder: Path, on_bag: Callable[[Path], None] = lambda bag: None) -> Examination:
    """Check everything in a folder.

    Args:
        folder: of a campaign, an experiment, a dataset, a study; anything that holds such.
        on_bag: told each bag before it is looked at, which takes the time.

    Raises:
        UsageError: there is nothing in it that could be checked.
    """
    found = Examination()
    for place in _places(folder):
        journals = sorted(place.glob('*.jsonl'))
        for path in journals:
            found.saw('journals')
            if path.name != LEDGER_NAME:
                for number, why in parse_journal(path.read_bytes()).troubles:
                    found.wrong(f'{path}:{number}', why, MEND)
        _check_sealed(place, found)
        if place / LEDGER_NAME in journals:
            _check_campaign(place, found, on_bag)
        _check_pictures(place, found)
        _check_drafts(place, found)
    if not found.looked_at:
        raise UsageError(
            f'{folder}: no campaign, experiment, dataset or study: nothing here can be checked'
        )
    return found


def mend(folder: Path) -> list[str]:
    """Mend the journals, tables and ``campaign.json`` of a folder and of all below it.

    Returns:
        Lines on what was done.

    Raises:
        UsageError: somebody is at work there.
    """
    done: list[str] = []
    for place in _places(folder):
        for path in sorted(place.glob('*.jsonl')):
            with _locked(path):
                done += _mend_journal(path)
                if path.name == LEDGER_NAME:
                    done += _mend_campaign(place)
    return done


def _places(folder: Path) -> Iterator[Path]:
    """The folder and all below it, but for those of bags."""
    if not folder.is_dir():
        raise UsageError(f'{folder}: no such folder; name that of a campaign, experiment or study')
    yield folder
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink() and not any(path.glob(f'*.{STORAGE_ID}')):
            yield from _places(path)


# Campaigns ---------------------------------------------------------------------------------------


def _check_campaign(
    folder: Path, found: Examination, on_bag: Callable[[Path], None]
) -> None:
    path = folder / LEDGER_NAME
    parsed = parse_journal(path.read_bytes())
    for number, why in parsed.troubles:
        found.wrong(f'{path}:{number}', why, MEND)
    if parsed.unprotected:
        found.notes.append(f'{path}: its first {parsed.unprotected} lines have no checksums')
    content = _content(folder, parsed, found)
    found.saw('runs', len(content.rows))
    if not parsed.troubles:
        _check_tables(folder, content, found)
    for row in content.rows:
        if row.bag:
            on_bag(folder / row.bag)
            _check_bag(folder / row.bag, row, found)
    _check_runs(folder, content, found)


def _content(folder: Path, parsed: JournalContent, found: Examination) -> LedgerContent:
    """What the ledger's sound lines come to."""
    path = folder / LEDGER_NAME
    try:
        if not parsed.troubles:
            return read_ledger(path)
    except UsageError as error:
        where, _, what = str(error).partition(': ')
        if not any(where.startswith(one.where) for one in found.findings):
            found.wrong(where, what, MEND)
    return ledger_content(path, possible_events(_sound_events(parsed)[0]))


def _check_tables(folder: Path, content: LedgerContent, found: Examination) -> None:
    """Whether the tables say what the ledger says."""
    names = [name for name in (CSV_NAME, PARQUET_NAME) if not (folder / name).is_file()]
    if names or not (folder / FACTS_NAME).is_file():
        names += [] if (folder / FACTS_NAME).is_file() else [FACTS_NAME]
        why = '' if content.finished else ' (the campaign has not ended in good order)'
        found.wrong(folder, f'{", ".join(names)} not there{why}', MEND)
    expected = table(content.rows, list(content.campaign.get('specs', {})))
    for name, same in ((CSV_NAME, _same_csv), (PARQUET_NAME, _same_parquet)):
        path = folder / name
        if path.is_file():
            found.saw('tables')
            if not same(path, expected):
                found.wrong(path, 'does not say what the ledger says', MEND)


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


def _check_bag(bag: Path, row: RunRow, found: Examination) -> None:
    """Whether a bag is sound, and that of its row."""
    found.saw('bags')
    command = f'taxinet bag doctor {bag}'
    if not bag.is_dir():
        found.wrong(bag, f'is not there, and its run is {row.outcome}')
        return
    try:
        if row.outcome.judged and (wrong := check_bag(bag).findings):
            more = f' and {len(wrong) - 1} more' if len(wrong) > 1 else ''
            found.wrong(bag, f'{wrong[0].where}: {wrong[0].what}{more}', command)
        for what in bag_differences(row, bag):
            found.wrong(bag, what)
    except (BagError, UsageError) as error:
        if row.outcome.judged:  # of a run that broke nobody expects more
            found.wrong(bag, error, command)


def _check_runs(folder: Path, content: LedgerContent, found: Examination) -> None:
    """What has an intent and no result, a result and no intent, or a bag and neither."""
    for line in content.lost:
        found.notes.append(f'{folder / LEDGER_NAME}: {line}')
    if content.unfinished:
        said = f'run {ranges(content.unfinished)}: begun, without a result'
        if content.finished:
            found.wrong(folder / LEDGER_NAME, said, 'the command that made it, with --resume')
        else:
            found.notes.append(f'{folder / LEDGER_NAME}: {said}; --resume runs it again')
    if content.unasked:
        said = f'run {ranges(content.unasked)}: a result, and nothing says that it was begun'
        found.wrong(folder / LEDGER_NAME, said)
    known = {row.bag for row in content.rows}
    for bag in sorted({file.parent for file in folder.glob(f'*/*.{STORAGE_ID}')}):
        if bag.name not in known and '.broken-' not in bag.name:
            found.notes.append(f'{bag}: a bag without a result in the ledger{_verdict_of(bag)}')


def _verdict_of(bag: Path) -> str:
    """What a bag says of its run, in a few words."""
    try:
        told = read_run(bag)
    except (BagError, UsageError):
        return ''
    if told is None or not told.outcome:
        return ''
    rho = ', '.join(f'{name} {one.upper:+.3f}' for name, one in told.judged.items())
    return f'; it says {told.outcome}{f" ({rho})" if rho else ""}'


# Everything else ---------------------------------------------------------------------------------


def _check_sealed(place: Path, found: Examination) -> None:
    """Sealed JSON files, and the files and journals that they vouch for."""
    for path in sorted(place.glob('*.json')):
        data = path.read_bytes()
        if b'"seal"' not in data and b'"checksum"' not in data:
            if path.name == FACTS_NAME:
                found.notes.append(f'{path}: of an earlier version, without a checksum')
            continue
        found.saw('indices')
        mended = MEND if path.name == FACTS_NAME else 'the command that made it, again'
        try:
            sealed = read_sealed(path)
        except UsageError as error:
            found.wrong(path, error, mended)
            continue
        for name, digest in sealed.files.items():
            if not (place / name).is_file():
                found.wrong(place / name, f'is not there, and {path.name} tells of it', mended)
            elif file_sha256(place / name) != digest:
                found.wrong(place / name, f'is not the file that {path.name} tells of', mended)
        for name, ended in sealed.journals.items():
            journal = place / name
            data = journal.read_bytes() if journal.is_file() else b''
            if why := lost_end(parse_journal(data), ended):
                found.wrong(journal, why, MEND if data else '')


def _check_pictures(place: Path, found: Examination) -> None:
    """Whether a dataset's pictures are those of its labels."""
    if not (place / _LABELS).is_file():
        return
    import pandas as pd

    try:
        labels = pd.read_parquet(place / _LABELS, columns=[_IMAGE, _DIGEST])
    except Exception:  # a foreign reader on untrusted bytes; the index has told of it
        return
    for name, digest in zip(labels[_IMAGE], labels[_DIGEST], strict=True):
        path = place / str(name)
        found.saw('pictures')
        if not path.is_file():
            found.wrong(path, f'is not there, and {_LABELS} has it')
        elif file_sha256(path) != digest:
            found.wrong(path, f'is not the picture that {_LABELS} tells of')


def _check_drafts(place: Path, found: Examination) -> None:
    """Files that a process was at when it was killed."""
    bags = {file.parent for file in place.glob(f'*/*.{STORAGE_ID}')}
    for folder in (place, *sorted(bags)):
        for path in sorted({path for words in _DRAFTS for path in folder.glob(words)}):
            mended = f'taxinet bag doctor {folder}' if path.name.startswith(METADATA_FILE) else ''
            found.wrong(path, 'left by a process that was killed; nothing reads it', mended)


# Mending -----------------------------------------------------------------------------------------


def _sound_events(content: JournalContent) -> tuple[list[dict[str, Any]], list[int]]:
    """What a journal's sound lines say in the order in which they were written, each once.

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
    """Put a damaged journal aside and write its sound lines anew; lines on what was done."""
    content, is_ledger = parse_journal(path.read_bytes()), path.name == LEDGER_NAME
    why = [f'line {number}: {words}' for number, words in content.troubles]
    events, damaged = _sound_events(content)
    if is_ledger:
        why += [words for words in [_lost_end(path, content)] if words]
        sound, events = events, possible_events(events)
        if len(events) < len(sound):
            why.append(f'{len(sound) - len(events)} lines say what cannot be')
    if not why:
        return []
    aside = _free_name(path)
    if is_ledger:
        events.append(lost_event(f'{"; ".join(why)}; as it was it is kept as {aside.name}'))
    text, link = b'', JournalContent().end.link
    for event in events:
        line, link = chained_line(link, event)
        text += line
    shutil.copyfile(path, aside)
    write_bytes_atomically(path, text)
    lost = f'; lost: line {ranges(damaged)}' if damaged else ''
    return [f'{path}: kept as it was as {aside.name}; its sound lines were written anew{lost}']


def _lost_end(path: Path, content: JournalContent) -> str:
    try:
        facts = read_facts(path.parent)
    except UsageError:
        return ''
    ended = facts.journals.get(path.name) if facts else None
    return lost_end(content, ended) if ended else ''


def _mend_campaign(folder: Path) -> list[str]:
    """Write tables and ``campaign.json`` anew from a sound ledger; lines on what was done."""
    done: list[str] = []
    path, trouble = folder / FACTS_NAME, Examination()
    events = [line.event for line in parse_journal((folder / LEDGER_NAME).read_bytes()).lines]
    content = ledger_content(folder / LEDGER_NAME, [event for event in events if event])
    _check_sealed(folder, trouble)
    _check_tables(folder, content, trouble)
    try:
        facts = read_facts(folder)
        told = [event['campaign'] for event in events if event and event['event'] == 'campaign']
        foreign = facts is not None and facts.sealed and told and facts.values not in told
    except UsageError:
        foreign = True
    if foreign:
        aside = _free_name(path)
        path.rename(aside)
        done.append(f'{path}: put aside as {aside.name}')
    elif not trouble.findings:
        return done
    if content.campaign:
        write_facts(folder, content.campaign)
    elif not path.is_file():
        return [*done, f'{folder}: its ledger does not say what the campaign is; no {FACTS_NAME}']
    write_tables(content.rows, folder, list(content.campaign.get('specs', {})))
    return [*done, f'{folder}: {FACTS_NAME}, {CSV_NAME} and {PARQUET_NAME} written anew']


def _free_name(path: Path) -> Path:
    number = 1
    while (aside := path.with_name(f'{path.name}.damaged-{number}')).exists():
        number += 1
    return aside


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Keep others from appending to a journal meanwhile."""
    with path.open('rb') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UsageError(f'{path}: somebody is at work on it; wait for its end') from error
        yield
