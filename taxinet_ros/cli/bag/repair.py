"""``taxinet bag recover``, ``split`` and ``render``: write bags from what others hold."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import track

from taxinet_ros.bag.check.lockstep import run_record, run_records, whole_steps
from taxinet_ros.bag.errors import BagError, BagForeign
from taxinet_ros.bag.layout import run_folder
from taxinet_ros.bag.reader import read_info, unchecked_files
from taxinet_ros.bag.rewrite.frames import IMAGE, missing_frames, restore_frames, restore_in_place
from taxinet_ros.bag.rewrite.recovery import Recovery, recover
from taxinet_ros.bag.rewrite.split import write_runs
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.writer import RUN_METADATA
from taxinet_ros.campaign.options import check_new
from taxinet_ros.cli.bag.input import exit_code_of, one_run
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.version import __version__


def run_recover(bag: Path, out: Path) -> int:
    """Save what is sound and print what was saved and what is lost.

    Returns:
        Exit code: 0 everything was saved, 3 something is lost, 2 nothing could be saved, 4 the new
        bag does not fit on the disk.

    Raises:
        UsageError: there is nothing at ``bag``, or something at ``out``.
    """
    if bag.is_dir() and out.resolve().is_relative_to(bag.resolve()):
        raise UsageError(f'--out {out}: lies within the bag {bag}, which is left as it is')
    return exit_code_of(bag, lambda: _recover(bag, out))


def _recover(bag: Path, out: Path) -> int:
    recovery = recover(bag, out)
    for line in recovery.damage:
        print(f'damage: {line}')
    if bare := unchecked_files(bag):
        print(bare)
    try:
        steps = list(_steps(out))
    except BagError:  # What is saved need not be sound as a run.
        steps = []
    one = f', {steps[0]},' if len(steps) == 1 else ''
    print(f'saved {recovery.saved} messages{one} into {out}')
    for line in steps[1:] and steps:
        print(line)
    lost = _lost(recovery)
    if lost:
        print(lost)
    return ExitCode.INCOMPLETE if lost else ExitCode.OK


def _steps(bag: Path) -> Iterator[str]:
    """How much the new bag holds of each run; nothing where it holds none of ours."""
    recording = open_recording(bag)
    if recording.plain:
        told = [('', recording.facts, run_record(recording))]
    else:
        records = run_records(recording)
        told = [
            (f'{run.name}: ', one.facts, record)
            for run, one, record in zip(recording.runs, recording, records, strict=True)
            if not run.absent
        ]
    for name, fact, record in told:
        if fact is not None:
            whole = whole_steps(record, list(record.counts))
            planned = round(fact.scene['duration'] * NS_PER_S) // CONTROL_PERIOD_NS + 1
            ended = f', ended as {fact.outcome}' if fact.outcome else ''
            yield f'{name}{whole} whole control steps of {planned} planned{ended}'


def _lost(recovery: Recovery) -> str:
    """One line on what is lost; empty if nothing."""
    if recovery.declared is not None and recovery.declared < recovery.saved:
        return f'saved more messages than the {recovery.declared} that it says it holds'
    if recovery.declared is not None and recovery.declared > recovery.saved:
        return f'lost {recovery.declared - recovery.saved} of {recovery.declared} messages'
    if recovery.damage and recovery.declared is None:
        return 'lost what was being written when the recording ended; how much, nothing tells'
    return 'lost no message, but what stands above' if recovery.damage else ''


def run_split(bag: Path, out: Path) -> int:
    """Write the bags, and say what came of each run.

    Returns:
        Exit code: 0 all of them are written, 2 nothing can be read, 3 some of the recording is
        damaged and not in them, 4 no room.

    Raises:
        UsageError: ``out`` is in use, or what is recorded does not tell of a run what it was.
    """
    check_new(out)
    return exit_code_of(bag, lambda: _split(bag, out))


def _split(bag: Path, out: Path) -> int:
    recording = open_recording(bag)
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
    return ExitCode.INCOMPLETE if recording.damage else ExitCode.OK


_MIN_FREE_BYTES = 1_000_000_000


def run_render(bag: Path, out: Path | None, run: str | None = None) -> int:
    """Render what is missing, in place or into a new bag, and print what came of it.

    Returns:
        Exit code: 0 every frame is there, 2 the bag cannot be read or its frames not be had,
        4 no room.

    Raises:
        UsageError: there is nothing at ``bag``, it is damaged, or ``out`` exists.
    """
    def work() -> int:
        with one_run(bag, run) as whole:
            if whole.path != bag and out is None:
                raise UsageError(f'{bag}: is not a bag of our recorder; name a new one with --out')
            return _render(whole, out)

    return exit_code_of(bag, work)


def _render(recording: Recording, out: Path | None) -> int:
    console = Console(highlight=False)
    bag, info = recording.path, recording.info
    missing = missing_frames(info)
    if not missing and not info.trouble:
        frames = info.counts[IMAGE]
        console.print(f'nothing to do: all {frames} frames are in {bag}', soft_wrap=True)
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
        f'{missing - missing_frames(done)} frames rendered into {out or bag}; driven again, the '
        'aircraft is where the bag has it at every step, to the bit', soft_wrap=True,
    )
    version = info.metadata.get(RUN_METADATA, {}).get('taxinet_ros_version', 'unknown')
    if version != __version__:
        console.print(
            f'recorded by version {version}, rendered by {__version__}: whether the camera still '
            f'sees the same, taxinet bag replay {out or bag} --into perception tells',
            soft_wrap=True,
        )
    return ExitCode.OK
