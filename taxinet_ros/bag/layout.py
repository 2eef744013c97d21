"""File layout: a run is a folder ``<run_id>/`` with ``<run_id>_0.mcap`` and ``metadata.yaml``.

This is the layout of rosbag2 (package rosbag2_cpp, ``SequentialWriter``), so ``ros2 bag`` accepts
the folder. As in rosbag2, ``metadata.yaml`` is written last: a folder without it is unfinished.
"""

from __future__ import annotations

import re
from pathlib import Path

from taxinet_ros.bag.errors import BagEmpty, BagForeign
from taxinet_ros.errors import UsageError

METADATA_FILE = 'metadata.yaml'
STORAGE_ID = 'mcap'
_NUMBER = re.compile(r'_(\d+)$')
_RUN_ID = re.compile(r'[A-Za-z0-9_][A-Za-z0-9_.-]{0,199}')


def is_run_name(run_id: str) -> bool:
    """Whether a run's name is safe as a folder name."""
    return _RUN_ID.fullmatch(run_id) is not None


def is_bag_name(bag: str) -> bool:
    """Whether a text is a run's name, or an absolute path that ends in one."""
    path = Path(bag)
    return is_run_name(path.name if path.is_absolute() else bag)


def run_folder(out: Path, run_id: str) -> Path:
    """Folder of a run within the campaign's folder.

    Raises:
        UsageError: the name is not safe as a folder name.
    """
    if not is_run_name(run_id):
        text = 'use letters, digits, _, - and . only, and neither - nor . first'
        raise UsageError(f'run {run_id!r:.80}: {text}')
    return out / run_id


def holds_bag(folder: Path) -> bool:
    """Whether a folder has a bag."""
    return any(folder.glob(f'*.{STORAGE_ID}'))


def holds_results(folder: Path) -> bool:
    """Whether a folder has results: folders, databases, tables, or JSON, except beside a bag."""
    kinds = ['.db', '.parquet']
    if not (folder / METADATA_FILE).is_file():
        kinds.append('.json')
    return any(path.is_dir() or path.suffix in kinds for path in folder.iterdir())


def bag_files(folder: Path) -> list[Path]:
    """Files of a run's folder by name."""
    return [path for path in sorted(folder.iterdir()) if path.is_file()]


def mcap_path(folder: Path) -> Path:
    """Path of the storage file of the run in ``folder``, named as ``ros2 bag reindex`` requires."""
    return folder / f'{folder.name}_0.{STORAGE_ID}'


def storage_files(path: Path) -> tuple[Path, ...]:
    """Storage files of a bag, oldest first; ``path`` is a run folder or one ``.mcap`` file.

    The list of files in ``metadata.yaml`` is not used, because it could point anywhere.

    Raises:
        UsageError: ``path`` does not exist, or is a campaign's folder.
        BagEmpty: the folder contains no storage file.
        BagForeign: the folder contains a bag of another storage.
    """
    if not path.is_dir():
        return (_storage_file(path),)
    # A killed recorder has compressed all files except the last.
    if any(not file.with_suffix('').exists() for file in path.glob(f'*.{STORAGE_ID}.zstd')):
        raise BagForeign(compressed(path, 'file'), path=path)
    if files := sorted(path.glob(f'*.{STORAGE_ID}'), key=_split_number):
        return tuple(map(_storage_file, files))
    if any(path.glob('*.db3')):
        raise _sqlite3(path)
    if runs := sorted(folder for folder in path.glob('*/') if holds_bag(folder)):
        raise UsageError(f'{path} is a campaign; name a run in it, e.g. {runs[0]}')
    raise BagEmpty(f'{path}: contains no .mcap file, so nothing was recorded', path=path)


def _storage_file(path: Path) -> Path:
    if not path.exists():
        raise UsageError(f'{path}: no such bag; give a run folder or an .mcap file')
    if not path.is_file():
        raise UsageError(f'{path}: not a regular file')
    if path.name.endswith(f'.{STORAGE_ID}.zstd'):
        raise BagForeign(compressed(path, 'file'), path=path)
    if path.suffix == '.db3':
        raise _sqlite3(path)
    return path


def _sqlite3(path: Path) -> BagForeign:
    return BagForeign(f'{path}: an sqlite3 bag; convert it to MCAP: ros2 bag convert', path=path)


def compressed(path: Path, mode: str) -> str:
    """Message about a bag recorded with ``ros2 bag record --compression-mode``."""
    # ros2 bag needs metadata.yaml to detect the compression.
    folder = path if path.is_dir() else path.parent
    convert = (
        f'ros2 bag convert -i {folder} -o OPTIONS.yaml '
        'with "output_bags: [{uri: NEW, storage_id: mcap, all_topics: true}]" in OPTIONS.yaml'
    )
    if (folder / METADATA_FILE).is_file():
        how = convert
    elif mode == 'file':
        how = f'unzstd {folder}/*.{STORAGE_ID}.zstd'
    else:
        said = '"compression_mode: MESSAGE" and "compression_format: zstd"'
        how = f'ros2 bag reindex {folder}; {said} in its {METADATA_FILE}; {convert}'
    return f'{path}: compressed by {mode}; decompress it: {how}'


def _split_number(path: Path) -> tuple[int, str]:
    match = _NUMBER.search(path.stem)
    return (int(match.group(1)) if match else 0, path.name)
