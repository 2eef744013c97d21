"""``taxinet bag render``: add the camera frames to a bag recorded without them."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import BagArgument, RunOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.version import __version__

if TYPE_CHECKING:
    from taxinet_ros.bag.run.recording import Recording


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
    from taxinet_ros.bag.writer import MIN_FREE_BYTES, RUN_METADATA

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
        restore_in_place(bag, MIN_FREE_BYTES) if out is None
        else restore_frames(recording, out, MIN_FREE_BYTES)
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
