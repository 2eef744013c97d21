"""``taxinet bag split``: one bag per run of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import BagArgument
from taxinet_ros.errors import ExitCode


def split(
    bag: BagArgument,
    out: Annotated[
        Path, typer.Option(metavar='DIR', help='folder for the new bags; must be new or empty')
    ],
) -> int:
    """Split a recording into one bag per run, as recorded by the recorder node.

    For bags from ros2 bag record: several runs in one bag, logged by wall-clock time, with foreign
        topics. Each new bag is named after its run; the recording is never modified.
    """
    from taxinet_ros.cli.bag.input import exit_code_of
    from taxinet_ros.trials.options import check_new

    check_new(out)
    return exit_code_of(bag, lambda: _split(bag, out))


def _split(bag: Path, out: Path) -> int:
    from taxinet_ros.bag.errors import BagForeign
    from taxinet_ros.bag.layout import run_folder
    from taxinet_ros.bag.rewrite.split import write_runs
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.bag.run.runs import is_run_topic
    from taxinet_ros.bag.run.topics import is_of_frames

    recording = open_recording(bag)
    present = [run for run in recording.runs if not run.absent]
    if not present:
        raise recording.without_run()
    folders = {run.name: run_folder(out, run.name.replace('/', '_').replace('#', '.'))
               for run in present}
    if len(set(folders.values())) < len(folders):
        raise BagForeign(f'{bag}: two of its runs would get the same folder', path=bag)
    write_runs(recording, folders)
    for run in recording.runs:
        where = f'-> {folders[run.name]}' if run.name in folders else 'nothing to write'
        print(f'{run.words()} {run.outcome or "without its end"} {where}')
    others = sorted(
        name for name, count in recording.info.counts.items()
        if count and not is_run_topic(name) and not is_of_frames(name)
    )
    if others:
        print(f'left out, as no run is judged by them: {", ".join(others)}')
    for error in recording.damage:
        print(f'damage: {error}')
    return ExitCode.INCOMPLETE if recording.damage else ExitCode.OK
