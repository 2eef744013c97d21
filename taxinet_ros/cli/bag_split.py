"""``taxinet bag split``: a bag of each run that a recording holds."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.bag.errors import BagForeign
from taxinet_ros.bag.layout import run_folder
from taxinet_ros.bag.runs import read_recording, write_runs
from taxinet_ros.campaign.options import check_new
from taxinet_ros.cli.bag_errors import LOSSY, WHOLE, exit_code_of


def run_split(bag: Path, out: Path) -> int:
    """Write the bags, and say what came of each run.

    Returns:
        Exit code: 0 all of them are written, 3 some of the recording is damaged and not in them,
        1 nothing can be read, 4 no room.

    Raises:
        UsageError: ``out`` is in use, or what is recorded does not tell of a run what it was.
    """
    check_new(out)
    return exit_code_of(bag, lambda: _split(bag, out))


def _split(bag: Path, out: Path) -> int:
    recording = read_recording(bag)
    present = [run for run in recording.runs if not run.absent]
    if not present:
        raise recording.without_run()
    folders = {run.name: run_folder(out, run.name.replace('/', '_').replace('#', '.'))
               for run in present}
    if len(set(folders.values())) < len(folders):
        raise BagForeign(f'{bag}: two of its runs would get one folder', path=bag)
    write_runs(recording, folders)
    for run in recording.runs:
        where = f'-> {folders[run.name]}' if run.name in folders else 'nothing to write'
        print(f'{run.words()} {run.outcome or "without its end"} {where}')
    for error in recording.damage:
        print(f'damage: {error}')
    return LOSSY if recording.damage else WHOLE
