"""``taxinet dataset``: shows how far the images are, and says how to go on after a stop."""

from __future__ import annotations

from rich.console import Console

from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.training.folder import DatasetOptions, write_dataset
from taxinet_ros.training.layout import LABELS, REQUEST


def run_dataset(options: DatasetOptions) -> None:
    """Make it or go on with it, and say what is there now."""
    try:
        with stage_bars(Console()) as show:
            rendered = write_dataset(options, show)
    except KeyboardInterrupt:
        if (options.out / REQUEST).exists():
            Console(stderr=True).print(
                f'interrupted; what is in {options.out} stays, continue with --resume',
                soft_wrap=True, highlight=False,
            )
        raise
    Console(highlight=False).print(
        f'{options.count} images in {options.out}, {rendered} of them rendered now; labels: '
        f'{options.out / LABELS}',
        soft_wrap=True,
    )
