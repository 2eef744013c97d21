"""``taxinet bag recover``, ``split`` and ``render``: write new bags from existing ones."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import BagArgument, RunOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.version import __version__

if TYPE_CHECKING:
    from taxinet_ros.bag.rewrite.recovery import Recovery
    from taxinet_ros.bag.run.recording import Recording

_MIN_FREE_BYTES = 1_000_000_000


def recover(
    bag: BagArgument,
    out: Annotated[
        Path, typer.Option(metavar='NEW', help='folder for the new bag; must not exist')
    ],
) -> int:
    """Copy all messages up to the first damage, or to the end of an unfinished bag, to a new one.

    The original bag is never modified. mcap recover, a tool of MCAP, also looks behind the damage.
    """
    from taxinet_ros.cli.bag.input import exit_code_of

    if bag.is_dir() and out.resolve().is_relative_to(bag.resolve()):
        raise UsageError(f'--out {out}: is inside the bag {bag}, which is not modified')
    return exit_code_of(bag, lambda: _recover(bag, out))


def _recover(bag: Path, out: Path) -> int:
    from taxinet_ros.bag.errors import BagError
    from taxinet_ros.bag.rewrite.recovery import recover

    recovery = recover(bag, out)
    for line in recovery.damage:
        print(f'damage: {line}')
    if recovery.unchecked:
        print(recovery.unchecked)
    try:
        steps = list(_steps(out))
    except BagError:  # The recovered bag may still not be a valid run.
        steps = []
    one = f', {steps[0]},' if len(steps) == 1 else ''
    print(f'saved {recovery.saved} messages{one} into {out}')
    for line in steps[1:] and steps:
        print(line)
    lost = _lost(recovery)
    if lost:
        print(lost)
    for file in recovery.damaged_files:
        print(
            'the tool of MCAP also looks for messages behind the damage: '
            f'mcap recover {shlex.quote(str(file))} -o NEW.mcap'
        )
    return ExitCode.INCOMPLETE if lost else ExitCode.OK


def _steps(bag: Path) -> Iterator[str]:
    """Lines on how much of each run the new bag holds."""
    from taxinet_ros.bag.check.lockstep import checked_runs
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
    from taxinet_ros.core.types import NS_PER_S

    for name, recording, record in checked_runs(open_recording(bag)):
        fact = recording.facts
        if fact is not None:
            planned = round(fact.scene['duration_s'] * NS_PER_S) // CONTROL_PERIOD_NS + 1
            ended = f', ended as {fact.outcome}' if fact.outcome else ''
            of = f'{name}: ' if name else ''
            yield f'{of}{record.whole_steps()} whole control steps of {planned} planned{ended}'


def _lost(recovery: Recovery) -> str:
    """One line on what is lost; empty if nothing."""
    if recovery.declared is not None and recovery.declared < recovery.saved:
        return f'saved more messages than the {recovery.declared} declared'
    if recovery.declared is not None and recovery.declared > recovery.saved:
        return f'lost {recovery.declared - recovery.saved} of {recovery.declared} messages'
    if recovery.damage and recovery.declared is None:
        return 'lost an unknown amount of data being written when the recording ended'
    return 'lost no message except as stated above' if recovery.damage else ''


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
    for error in recording.damage:
        print(f'damage: {error}')
    return ExitCode.INCOMPLETE if recording.damage else ExitCode.OK


def render(
    bag: BagArgument,
    out: Annotated[
        Path | None,
        typer.Option(metavar='NEW', help='folder for a new bag (default: add them to BAG itself)'),
    ] = None,
    run_id: RunOption = None,
) -> int:
    """Add camera frames to a bag recorded without them.

    The frames are bit-identical to those of the run: the aircraft is re-simulated from the recorded
    commands and checked against the recorded odometry. Under the same name, the new bag is
    byte-identical to one recorded with --images all.
    """
    from taxinet_ros.bag.rewrite.split import write_runs
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.cli.bag.input import exit_code_of
    from taxinet_ros.trials.past_runs.repeated_run import one_run

    def work() -> int:
        recording = one_run(bag, run_id)
        if not recording.name:
            return _render(recording, out)
        if out is None:
            raise UsageError(f'{bag}: not from the taxinet_ros recorder; name a new bag with --out')
        with tempfile.TemporaryDirectory(prefix='taxinet-run-') as scratch:
            folder = Path(scratch) / recording.run_id
            write_runs(open_recording(bag), {recording.name: folder})
            return _render(open_recording(folder), out)

    return exit_code_of(bag, work)


def _render(recording: Recording, out: Path | None) -> int:
    from rich.progress import track

    from taxinet_ros.bag.reader import read_info
    from taxinet_ros.bag.rewrite.frames import (
        IMAGE,
        missing_frames,
        restore_frames,
        restore_in_place,
    )
    from taxinet_ros.bag.writer import RUN_METADATA

    console = line_console()
    bag, info = recording.path, recording.info
    missing = missing_frames(info)
    if not missing and not info.trouble:
        frames = info.counts[IMAGE]
        if out is not None:
            raise UsageError(
                f'--out {out}: nothing to render for it: all {frames} frames are in {bag}'
            )
        console.print(f'nothing to do: all {frames} frames are in {bag}')
        return ExitCode.OK
    steps = (
        restore_in_place(bag, _MIN_FREE_BYTES) if out is None
        else restore_frames(recording, out, _MIN_FREE_BYTES)
    )
    shown = track(
        steps, 'rendering', total=missing, console=console, transient=True,
        disable=not console.is_terminal,
    )
    for _ in shown:
        pass
    done = read_info(out or bag)
    console.print(
        f'{missing - missing_frames(done)} frames rendered into {out or bag}; the re-simulated '
        'aircraft matches the recorded odometry at every step, bit for bit',
    )
    version = info.metadata.get(RUN_METADATA, {}).get('taxinet_ros_version', 'unknown')
    if version != __version__:
        console.print(
            f'recorded by version {version}, rendered by {__version__}: check for camera changes '
            f'with taxinet bag replay {out or bag} --into perception',
        )
    return ExitCode.OK
