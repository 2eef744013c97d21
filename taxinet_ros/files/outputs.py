"""What a command may write: nothing in the place of a record, an input or no regular file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from taxinet_ros.errors import UsageError

RECORD_NAMES = frozenset({
    'campaign.db', 'progress.db', 'runs.csv', 'runs.parquet', 'learned.json',
    'metadata.yaml', 'stack.json', 'experiment.json',
    'pairs.parquet', 'analysis.json', 'localize.json', 'localize.parquet', 'localize.csv',
    'assurance.json', 'trials.csv', 'alarms.csv', 'rounds.json', 'dataset.json', 'labels.csv',
    'labels.parquet', 'evidence.json', 'MANIFEST',
})
"""Names of files in which campaigns, experiments, studies, data sets and bags are recorded."""

_RECORDING = '.mcap'


def check_output(
    where: str, path: Path, *, inputs: Iterable[Path] = (), folder: bool = False,
    own: Sequence[str] = (),
) -> None:
    """Refuse to write a file in the place of a record, an input or what is no regular file.

    An earlier output of the same kind, known by its suffix, may be replaced, if the command does.

    Args:
        where: option and value, which begin the message.
        path: the file.
        inputs: files that the command reads.
        folder: whether a folder may be there.
        own: suffixes of the files that the option writes, which it may replace.

    Raises:
        UsageError: it would destroy something.
    """
    if path.is_dir():
        if folder:
            return
        raise UsageError(f'{where}: is a folder; name a file')
    there = path.exists()
    if there and not path.is_file():
        raise UsageError(f'{where}: is not a regular file; choose another name')
    names = {path.name, path.resolve().name}
    if any(name.endswith(_RECORDING) for name in names):
        raise UsageError(f'{where}: {_RECORDING} is the name of a recording; choose another name')
    beside = path.parent
    if names & RECORD_NAMES and (there or _holds_records(beside)):
        raise UsageError(f'{where}: is the name of a record in {beside}; choose another name')
    if not there:
        return
    if any(_same(path, one) for one in inputs):
        raise UsageError(f'{where}: is read by this command; choose another name')
    if path.suffix not in own:
        if own:
            raise UsageError(f'{where}: exists, and is no {own[0]} file; choose another name')
        raise UsageError(f'{where}: already exists and is not overwritten; choose a new name')


def _holds_records(folder: Path) -> bool:
    return any((folder / name).exists() for name in RECORD_NAMES) or any(
        folder.glob(f'*{_RECORDING}'))


def _same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # not there, or no path
        return False
