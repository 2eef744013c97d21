"""``taxinet dataset``: render labelled images of scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from taxinet_ros.cli.options import RendererOption, ScenarioArgument, SeedOption, VariedOption
from taxinet_ros.cli.show import line_console


def dataset(
    program: ScenarioArgument,
    out: Annotated[Path, typer.Option(help='folder for images and labels; must be new')],
    count: Annotated[int, typer.Option(help='images, one per scene')],
    sampler: Annotated[
        str, typer.Option(help='how scenes are drawn: random, halton, sobol or grid')
    ] = 'random',
    seed: SeedOption = 0,
    varied: VariedOption = False,
    camera: RendererOption = 'ours',
    workers: Annotated[int, typer.Option(help='rendering processes')] = 2,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue an interrupted command')
    ] = False,
) -> None:
    """Render labelled training images of scenes."""
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.processes.interrupts import ToldInterrupt
    from taxinet_ros.training.data.dataset_folder import LABELS, DatasetOptions, write_dataset
    from taxinet_ros.training.data.unfinished import is_begun

    options = DatasetOptions(
        program=program, out=out, count=count, sampler=sampler, seed=seed, varied=varied,
        camera=camera, workers=workers, resume=resume,
    )
    try:
        with stage_bars(Console()) as show:
            rendered = write_dataset(options, show)
    except KeyboardInterrupt:
        if is_begun(out):
            line_console(stderr=True).print(
                f'interrupted; images in {out} are kept, continue with --resume')
            raise ToldInterrupt from None
        raise
    line_console().print(
        f'{count} images in {out}, {rendered} of them rendered now; labels: {out / LABELS}')
