"""``taxinet bag render``: puts the frames into a bag that was recorded without them."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import track

from taxinet_ros import __version__
from taxinet_ros.bag.frames import missing_frames, restore_frames, restore_in_place
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.writer import RUN_METADATA
from taxinet_ros.cli.bag_errors import WHOLE, exit_code_of
from taxinet_ros.cli.bag_input import one_run
from taxinet_ros.core.errors import UsageError

_MIN_FREE_BYTES = 1_000_000_000


def run_render(bag: Path, out: Path | None, run: str | None = None) -> int:
    """Render what is missing, in place or into a new bag, and print what came of it.

    Returns:
        Exit code: 0 every frame is there, 1 the bag cannot be read or its frames not be had,
        4 no room.

    Raises:
        UsageError: there is nothing at ``bag``, it is damaged, or ``out`` exists.
    """
    def work() -> int:
        with one_run(bag, run) as whole:
            if whole != bag and out is None:
                raise UsageError(f'{bag}: is not a bag of our recorder; name a new one with --out')
            return _render(whole, out)

    return exit_code_of(bag, work)


def _render(bag: Path, out: Path | None) -> int:
    console = Console(highlight=False)
    info = read_info(bag)
    missing = missing_frames(info)
    if not missing and not info.trouble:
        frames = info.counts['/camera/image_raw']
        console.print(f'nothing to do: all {frames} frames are in {bag}', soft_wrap=True)
        return WHOLE
    steps = (
        restore_in_place(bag, _MIN_FREE_BYTES) if out is None
        else restore_frames(bag, out, _MIN_FREE_BYTES)
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
    return WHOLE
