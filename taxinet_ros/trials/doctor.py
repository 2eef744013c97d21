"""Check a folder of results: what is damaged, missing or unfinished.

Checks, in the folder and its subfolders: every record, by SQLite's integrity check and the digests
of its entries; each bag of a campaign against its row, and bags that no row knows; every sealed
JSON file and the files it has checksums of; each picture of a dataset against its label; and drafts
left by a killed process. Everything else, such as derived pages and plots, is listed as not
checked. A campaign's tables are made again if they do not say what its record says; what is damaged
or missing otherwise is made again by ``--resume``.
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
from taxinet_ros.bag.layout import METADATA_FILE, STORAGE_ID, holds_bag, holds_results
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import DRAFTS
from taxinet_ros.files.record import RECORD_NAME, examine_record, no_writer, read_entry
from taxinet_ros.files.sealed_json import file_sha256, read_sealed
from taxinet_ros.trials.experiment import JSON_NAME as EXPERIMENT_NAME
from taxinet_ros.trials.options import AUDIT_FOLDER
from taxinet_ros.trials.past_runs.recorded_campaign import bag_differences
from taxinet_ros.trials.record.content import (
    AS_TEXT,
    CampaignContent,
    campaign_content,
    run_key,
)
from taxinet_ros.trials.record.facts import ARM, BEGUN, FACTS, is_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import (
    CSV_NAME,
    PARQUET_NAME,
    csv_text,
    read_any_table,
    table,
    write_tables,
)

_LABELS, _IMAGE, _DIGEST = 'labels.parquet', 'image', 'sha256'
_DATASET, _PROGRESS = 'dataset.json', 'progress.db'
_STAGE = 'stage'
_RESUME = 'the command that made it, resumed if it can be'
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

    def report(self, where: object, what: object, fix: str = '') -> None:
        """Add a finding, without repeating a place with which its text starts."""
        text = str(what).removeprefix(f'{where}:').strip().partition('; ')[0]
        self.findings.append(Finding(where=str(where), what=text, fix=fix))


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
        _check_record(place, found, on_bag)
        _check_sealed(place, found)
        _check_pictures(place, found)
        _check_drafts(place, found)
    if not found.looked_at:
        raise UsageError(
            f'{folder}: contains no bag, campaign, experiment, dataset or study, so there is '
            'nothing to check'
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
    return holds_bag(folder) and not holds_results(folder)


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


def _check_record(
    folder: Path, found: Examination, on_bag: Callable[[Path], None]
) -> None:
    for path in _files(folder, '*.db', found):
        found.count('records', path=path)
        try:
            content = _examined(path, found)
        except (UsageError, OSError) as error:
            found.report(path, error, _RESUME)
        else:
            if content is not None:
                _check_campaign(folder, content, found, on_bag)


def _examined(path: Path, found: Examination) -> CampaignContent | None:
    """Content of a campaign's record; its tables are made again if they do not say the same.

    Meanwhile no command can write it. The tables of a campaign that is running are not checked.
    """
    folder = path.parent
    with no_writer(path) as quiet:
        entries = examine_record(path, AS_TEXT)
        if FACTS not in entries or path.name != RECORD_NAME:
            _check_stages(folder, entries.get(_STAGE, {}), found)
            return None
        content = campaign_content(path, entries)
        found.count('runs', len(content.rows))
        if quiet:
            _check_tables(folder, content, found)
        else:
            found.notes.append(f'{folder}: its campaign is running, so its tables are not checked')
    return content


def _check_stages(
    folder: Path, stages: Mapping[str, Mapping[str, Any]], found: Examination
) -> None:
    """Check that the outputs of a study's finished stages exist and are unchanged."""
    for stage, values in stages.items():
        for name, digest in values['outputs'].items():
            output = folder / name
            found.checked.add(output)
            if not output.is_file():
                found.report(output, f'is missing, but was made by stage {stage}', _RESUME)
            elif file_sha256(output) != digest:
                found.report(output, f'is not the file made by stage {stage}', _RESUME)


def _check_campaign(
    folder: Path, content: CampaignContent, found: Examination, on_bag: Callable[[Path], None]
) -> None:
    arm = content.facts.get(ARM, folder.name)
    if arm != folder.name and (folder.parent / EXPERIMENT_NAME).is_file():
        found.report(folder, f'is arm {arm} of its experiment; was it renamed or exchanged?')
    for row in content.rows:
        if row.bag:
            on_bag(folder / row.bag)
            _check_bag(folder / row.bag, row, content.facts, found)
    _check_runs(folder, content, found)


def _check_tables(folder: Path, content: CampaignContent, found: Examination) -> None:
    """Check that the tables agree with the record; make them again if they do not."""
    expected = table(content.rows, tuple(content.facts.get('specs', {})))
    wrong = []
    for name, same in ((CSV_NAME, _same_csv), (PARQUET_NAME, _same_parquet)):
        path = folder / name
        if path.is_file():
            found.count('tables', path=path)
            if more := _only_there(path, content):
                found.report(path, f'has run {ranges(more)}, and the record has not: is the '
                             f'{RECORD_NAME} an older copy?')
                return
        if not path.is_file() or not same(path, expected):
            wrong.append(name)
    if not wrong:
        return
    try:
        write_tables(content.rows, folder, content.facts)
    except OSError as error:
        found.report(folder / wrong[0], f'does not say what the record says ({error.strerror})')
    else:
        found.checked |= {folder / name for name in wrong}
        found.notes.append(f'{folder}: {", ".join(wrong)} made again from the record')


def _only_there(path: Path, content: CampaignContent) -> list[int]:
    """Runs in a table but not in the record."""
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
    command = f'taxinet doctor {bag}'
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


def _check_runs(folder: Path, content: CampaignContent, found: Examination) -> None:
    """Check for runs that were started and have no result, and for bags that no row knows."""
    if content.unfinished:
        said = f'run {ranges(content.unfinished)}: started but has no result'
        if content.finished:
            found.report(folder / RECORD_NAME, said, _RESUME)
        else:
            found.notes.append(f'{folder / RECORD_NAME}: {said}; {_RESUME}, runs it again')
    known = {row.bag for row in content.rows}
    for bag in sorted({file.parent for file in folder.glob(f'*/*.{STORAGE_ID}')}):
        if bag.name in known or '.broken-' in bag.name:
            continue
        index, verdict = _verdict_of(bag)
        begun = None if index is None else read_entry(folder / RECORD_NAME, BEGUN, run_key(index))
        if index is None or begun is not None:  # read anew: the campaign may be running
            found.notes.append(f'{bag}: a bag without a result in the record{verdict}')
        else:  # the record says before each run that it begins
            found.report(bag, f'is of run {index}{verdict}, which the record does not know: is the '
                         f'{RECORD_NAME} an older copy?', _RESUME)


def _verdict_of(bag: Path) -> tuple[int | None, str]:
    """Index of the run of a bag, and short text on its verdict, as far as it says them."""
    try:
        told = open_recording(bag).facts
    except (BagError, UsageError):
        return None, ''
    if told is None or not told.outcome:
        return None, ''
    rho = (f'{name} {rho_text(one.interval.upper, ".3f")}' for name, one in told.judged.items())
    return told.index, f' (it says {", ".join([told.outcome, *rho])})'


# Everything else ---------------------------------------------------------------------------------


def _check_sealed(place: Path, found: Examination) -> None:
    """Check sealed JSON files, and the files they have checksums of."""
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
        for arm in sealed.values.get('arms') or () if path.name == EXPERIMENT_NAME else ():
            if not is_campaign(place / arm):
                found.report(place / arm, 'is an arm of the experiment, but no campaign', _RESUME)
        for name, digest in sealed.files.items():
            if not (place / name).is_file():
                found.report(place / name, f'is missing, but listed in {path.name}', _RESUME)
            elif file_sha256(place / name) != digest:
                found.report(place / name, f'is not the file recorded in {path.name}', _RESUME)


def _check_pictures(place: Path, found: Examination) -> None:
    """Check a dataset's pictures against its labels."""
    if not (place / _LABELS).is_file():
        if (place / _PROGRESS).is_file() and not (place / _DATASET).is_file():
            found.notes.append(f'{place}: an unfinished dataset; resume it')
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
            fixed = f'taxinet doctor {folder}' if Path(METADATA_FILE).stem in path.name else ''
            found.report(path, 'left by a killed process; not used', fixed)
