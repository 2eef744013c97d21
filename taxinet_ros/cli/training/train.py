"""``taxinet train``: train a network on rendered scenes or labelled images."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.completion import complete_program
from taxinet_ros.cli.options import VariedOption, refuse_given
from taxinet_ros.cli.show import line_console
from taxinet_ros.files.outputs import check_output

if TYPE_CHECKING:
    from taxinet_ros.training.options import TrainOptions


def train(
    context: typer.Context,
    out: Annotated[
        Path,
        typer.Option(
            metavar='NAME.safetensors', writable=True, dir_okay=False, help='weights file to write'
        ),
    ],
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar='SCENARIO|DIR', autocompletion=complete_program,
            help='program to render pictures of, or folders of labelled images',
        ),
    ] = None,
    place: Annotated[
        list[str] | None,
        typer.Option(
            help='train at places instead: random:0-299, or one of any kind; '
            'repeatable'
        ),
    ] = None,
    architecture: Annotated[
        str | None,
        typer.Option(
            help='layers of the network: cnn5-64x192, or the wider cnn5w-64x192  [default: those '
            'of --start, else cnn5-64x192]',
        ),
    ] = None,
    view: Annotated[
        str | None,
        typer.Option(help='virtual camera through which the network sees any camera: ahead'),
    ] = None,
    images: Annotated[
        int, typer.Option(help='images to render, one per scene, spread over the places')
    ] = 12_000,
    validation: Annotated[
        int, typer.Option(
            help='additional validation images; what is added brings more, in proportion'
        )
    ] = 1_500,
    validation_data: Annotated[
        Path | None, typer.Option(help='folder of validation images, instead')
    ] = None,
    sampler: Annotated[
        str, typer.Option(help='how scenes are drawn: random, halton, sobol or grid')
    ] = 'random',
    validation_program: Annotated[
        str | None, typer.Option(help='program of the validation scenes, instead')
    ] = None,
    add: Annotated[
        list[str] | None,
        typer.Option(
            metavar='PROGRAM=COUNT|FOLDER', help='add scenes of another program, or a folder of '
            'labelled images, of a recording; repeatable'
        ),
    ] = None,
    add_runs: Annotated[
        list[str] | None,
        typer.Option(
            metavar='CAMPAIGN=COUNT',
            help="add positions along the paths of a campaign's failed runs; repeatable",
        ),
    ] = None,
    start: Annotated[
        str | None, typer.Option(help='initial weights, word or file (default: random)')
    ] = None,
    varied: VariedOption = False,
    augment: Annotated[
        bool,
        typer.Option(
            '--augment', help='augment images: random exposure, focus and noise at each use'
        ),
    ] = False,
    epochs: Annotated[int, typer.Option(help='epochs')] = 20,
    batch: Annotated[int, typer.Option(help='batch size')] = 64,
    learning_rate: Annotated[float, typer.Option(help='maximum learning rate of the '
    'schedule')] = 3e-3,
    seed: Annotated[int, typer.Option(help='random seed')] = 1,
    device: Annotated[
        str, typer.Option(help='cpu, or cuda: train on the GPU; other weights')
    ] = 'cpu',
    workers: Annotated[int, typer.Option(help='rendering processes')] = 2,
    overwrite: Annotated[bool, typer.Option('--overwrite', help='overwrite existing '
    'output')] = False,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue an interrupted command')
    ] = False,
) -> None:
    """Train TaxiNet on rendered scenes or labelled images.

    Writes weights, model card and learning curves; until then NAME.part, for --resume.
    """
    from taxinet_ros.cli.training.pictures import picture_sources
    from taxinet_ros.training.data.portions import parse_portion
    from taxinet_ros.training.options import TrainOptions

    program, data = picture_sources(sources or ())
    if data and not place:
        why = 'for rendered scenes; of folders every image is used, leave it out'
        refuse_given(context, ('images', 'sampler'), why)
    if validation_data is not None:
        why = 'with --validation-data all of its images are used; leave one out'
        refuse_given(context, ('validation',), why)
    run_train(TrainOptions(
        program=program, places=tuple(place or ()), view=view,
        architecture=architecture, data=data,
        validation_data=validation_data, out=out,
        sampler=sampler, validation_program=validation_program, start=start,
        add=(
            *(parse_portion(text, 'program') for text in add or () if not Path(text).is_dir()),
            *(parse_portion(text, 'runs') for text in add_runs or ()),
        ),
        add_data=tuple(Path(text) for text in add or () if Path(text).is_dir()),
        images=images, validation=validation, varied=varied, augment=augment, epochs=epochs,
        batch=batch, learning_rate=learning_rate, seed=seed, device=device, workers=workers,
        overwrite=overwrite, resume=resume,
    ))


def run_train(options: TrainOptions) -> None:
    """Train, with a bar per stage, and print the errors on the validation images.

    Raises:
        UsageError: an option is invalid, or a file beside the weights would replace a record.
    """
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.core.perception.domain import domain_words
    from taxinet_ros.core.perception.weights import card_path
    from taxinet_ros.processes.interrupts import ToldInterrupt
    from taxinet_ros.training.train import train

    beside = card_path(options.out), options.curves_path, options.history_path
    for path in beside if options.out.suffix else ():
        check_output(f'train: --out {options.out}: {path}', path, own=[path.suffix])
    console = line_console()
    try:
        with stage_bars(console) as show:
            card = train(options, show)
    except KeyboardInterrupt:
        if not options.unfinished.exists():
            raise
        words = [word for word in sys.argv[1:] if word != '--resume']
        line_console(stderr=True).print(
            f'interrupted; {options.unfinished} keeps pictures and epochs, continue with '
            f'{shlex.join(["taxinet", *words, "--resume"])}',
        )
        raise ToldInterrupt from None
    for quantity, errors in card.errors.items():
        figures = ', '.join(f'{name} {value:.3g}' for name, value in errors.items())
        console.print(f'{quantity}: {figures}')
    console.print(f'domain: {domain_words(card.domain)}')
    console.print(
        f'weights: {options.out} (epoch {card.best_epoch}), model card: {card_path(options.out)}, '
        f'learning curves: {options.curves_path}, {options.history_path.name}',
    )
