"""Check a folder of results: what is damaged, missing or unfinished.

Checks, in the folder and its subfolders: every journal (ledgers, trials, stages, rounds, finished
images), every sealed JSON file and the files it has checksums of, a campaign's tables against its
ledger, each bag against its row, each picture of a dataset against its label, the recorded outputs
of a study, and drafts left by a killed process. Everything else, such as derived pages and plots,
is listed as not checked. What is damaged or missing is made again by ``--resume``.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.check.findings import Finding, ranges
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.layout import METADATA_FILE, STORAGE_ID
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.campaign.options import AUDIT_FOLDER
from taxinet_ros.campaign.past_runs.judged_run import bag_differences
from taxinet_ros.campaign.record.facts import FACTS_NAME, LEDGER_NAME
from taxinet_ros.campaign.record.ledger import LedgerContent, ledger_content, read_ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import (
    CSV_NAME,
    PARQUET_NAME,
    csv_text,
    read_any_table,
    table,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import DRAFTS
from taxinet_ros.files.journal import lost_end, parse_journal
from taxinet_ros.files.sealed_json import file_sha256, read_sealed

_LABELS, _IMAGE, _DIGEST = 'labels.parquet', 'image', 'sha256'
_DATASET, _REQUEST, _STAGES = 'dataset.json', 'request.json', 'stages.jsonl'
_RESUME = 'the command that made it, with --resume if it has that'
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
                    found.report(f'{path}:{number}', why, _RESUME)
            if path.name == _STAGES:
                _check_stages(path, found)
        _check_sealed(place, found)
        if place / LEDGER_NAME in journals:
            _check_campaign(place, found, on_bag)
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


# Campaigns ---------------------------------------------------------------------------------------


def _check_campaign(
    folder: Path, found: Examination, on_bag: Callable[[Path], None]
) -> None:
    path = folder / LEDGER_NAME
    parsed = parse_journal(path.read_bytes())
    for number, why in parsed.troubles:
        found.report(f'{path}:{number}', why, _RESUME)
    intact = [line.event for line in parsed.lines if line.event is not None]
    try:
        content = ledger_content(path, intact) if parsed.troubles else read_ledger(path)
    except UsageError as error:
        where, _, what = str(error).partition(': ')
        if not any(where.startswith(one.where) for one in found.findings):
            found.report(where, what, _RESUME)
        return
    found.count('runs', len(content.rows))
    if not parsed.troubles:
        _check_tables(folder, content, found)
    for row in content.rows:
        if row.bag:
            on_bag(folder / row.bag)
            _check_bag(folder / row.bag, row, content.campaign, found)
    _check_runs(folder, content, found)


def _check_tables(folder: Path, content: LedgerContent, found: Examination) -> None:
    """Check that the tables agree with the ledger."""
    names = [name for name in (CSV_NAME, PARQUET_NAME) if not (folder / name).is_file()]
    if names or not (folder / FACTS_NAME).is_file():
        names += [] if (folder / FACTS_NAME).is_file() else [FACTS_NAME]
        why = '' if content.finished else ' (the campaign has not ended in good order)'
        found.report(folder, f'{", ".join(names)} not there{why}', _RESUME)
    expected = table(content.rows, list(content.campaign.get('specs', {})))
    for name, same in ((CSV_NAME, _same_csv), (PARQUET_NAME, _same_parquet)):
        path = folder / name
        if path.is_file():
            found.count('tables', path=path)
            if not same(path, expected):
                more = _only_there(path, content)
                also = f': it has run {ranges(more)}, and the ledger has not' if more else ''
                found.report(path, f'does not say what the ledger says{also}', _RESUME)


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
    """Check for runs that were started and have no result, and for bags without a result."""
    if content.unfinished:
        said = f'run {ranges(content.unfinished)}: started but has no result'
        if content.finished:
            found.report(folder / LEDGER_NAME, said, _RESUME)
        else:
            found.notes.append(f'{folder / LEDGER_NAME}: {said}; --resume runs it again')
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
        if not any(word in path.read_bytes() for word in (b'"seal"', b'"checksum"')):
            continue
        found.count('indices', path=path)
        try:
            sealed = read_sealed(path)
        except UsageError as error:
            found.report(path, error, _RESUME)
            continue
        found.checked |= {place / name for name in sealed.files}
        for name, digest in sealed.files.items():
            if not (place / name).is_file():
                found.report(place / name, f'is missing, but listed in {path.name}', _RESUME)
            elif file_sha256(place / name) != digest:
                found.report(place / name, f'is not the file recorded in {path.name}', _RESUME)
        for name, ended in sealed.journals.items():
            journal = place / name
            data = journal.read_bytes() if journal.is_file() else b''
            if why := lost_end(parse_journal(data), ended):
                found.report(journal, why, _RESUME)


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
