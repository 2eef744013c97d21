"""``taxinet``: run scenarios, search for failures, train the network, start nodes.

Exit codes: 0 every run satisfied its specifications, 1 some run violated one, 2 bad input,
4 the bench broke, 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from typer.exceptions import TyperException

from taxinet_ros import __version__
from taxinet_ros.cli.camera import camera_app
from taxinet_ros.cli.option_types import (
    BudgetOption,
    ImagesOption,
    MostRunsOption,
    OutOption,
    PerceptionOption,
    PicturesArgument,
    ProcessesOption,
    QuietOption,
    ResumeOption,
    RunsOption,
    SamplerOption,
    SamplerSettingOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    SpecOption,
    UntilOption,
    VariedOption,
    WorkersOption,
)
from taxinet_ros.core.errors import InfraError, UsageError

USAGE, INFRA, INTERRUPTED = 2, 4, 130

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help=(__doc__ or '').replace('``', ''),
)
app.add_typer(camera_app, name='camera')


@app.command()
def run(
    scenario: ScenarioArgument,
    runs: RunsOption = 1,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    settings: SetOption = None,
    spec: SpecOption = None,
    out: OutOption = None,
    processes: ProcessesOption = False,
    images: ImagesOption = 'all',
) -> None:
    """Run a Scenic program's scenes through the graph.

    Every run ends in a bag of its own, and in a row of the campaign's table.
    """
    from taxinet_ros.campaign.options import make_options
    from taxinet_ros.cli.campaign import run_campaign

    options = make_options(
        program=scenario, runs=runs, seed=seed, perception=perception,
        settings=settings or (), specs=spec or (), out=out, processes=processes,
        images=images,
    )
    raise typer.Exit(run_campaign(options))


@app.command()
def falsify(
    scenario: ScenarioArgument,
    runs: MostRunsOption = 100,
    sampler: SamplerOption = 'ce',
    sampler_option: SamplerSettingOption = None,
    workers: WorkersOption = 1,
    out: OutOption = None,
    resume: ResumeOption = False,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    settings: SetOption = None,
    spec: SpecOption = None,
    until: UntilOption = None,
    budget: BudgetOption = None,
    images: ImagesOption = 'none',
    quiet: QuietOption = False,
) -> None:
    """Search a Scenic program for violating scenes.

    The worse a run, the more like it the sampler may choose. Survives Ctrl-C and power cuts.
    """
    from taxinet_ros.campaign.options import make_options
    from taxinet_ros.campaign.search_options import make_search_options
    from taxinet_ros.cli.falsify import run_falsify

    campaign = make_options(
        program=scenario, runs=runs, seed=seed, perception=perception, settings=settings or (),
        specs=spec or (), out=out, processes=False, images=images, resume=resume,
    )
    options = make_search_options(
        campaign, sampler=sampler, sampler_options=sampler_option or (), workers=workers,
        resume=resume, until=until, budget_min=budget,
    )
    raise typer.Exit(run_falsify(options, quiet=quiet))


@app.command()
def demo(
    out: OutOption = None,
    runs: RunsOption = 10,
    seed: SeedOption = 1,
) -> None:
    """Run ten scenes with both networks and with the truth.

    Draws their paths and their camera frames.
    """
    from taxinet_ros.cli.demo import run_demo

    raise typer.Exit(run_demo(out, runs=runs, seed=seed))


@app.command()
def train(
    out: Annotated[Path, typer.Option(help='weights file to write, NAME.safetensors')],
    program: PicturesArgument = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(help='folder of labelled images, instead of a program; repeatable'),
    ] = None,
    images: Annotated[int, typer.Option(help='pictures to render, one per scene')] = 12_000,
    validation: Annotated[int, typer.Option(help='further ones held back to measure on')] = 1_500,
    validation_data: Annotated[
        Path | None, typer.Option(help='folder of images to measure on, instead')
    ] = None,
    varied: VariedOption = False,
    augment: Annotated[
        bool, typer.Option('--augment', help='change exposure, focus, noise at every look')
    ] = False,
    epochs: Annotated[int, typer.Option(help='times that every picture is seen')] = 20,
    batch: Annotated[int, typer.Option(help='pictures per step')] = 64,
    learning_rate: Annotated[float, typer.Option(help='highest of the schedule')] = 3e-3,
    patience: Annotated[
        int,
        typer.Option(
            help='stop after so many epochs without gain, 0 never; the best epoch is kept anyway, '
            'and most of the gain comes at the end of the schedule'
        ),
    ] = 0,
    seed: Annotated[int, typer.Option(help='of everything random')] = 1,
    workers: Annotated[int, typer.Option(help='processes that render')] = 2,
    overwrite: Annotated[bool, typer.Option('--overwrite', help='replace what is there')] = False,
) -> None:
    """Train TaxiNet on rendered scenes or labelled images.

    Writes weights, model card and learning curves.
    """
    from taxinet_ros.cli.train import run_train
    from taxinet_ros.training.options import TrainOptions

    run_train(TrainOptions(
        program=program, data=tuple(data or ()), validation_data=validation_data, out=out,
        images=images, validation=validation, varied=varied, augment=augment, epochs=epochs,
        batch=batch, learning_rate=learning_rate, patience=patience, seed=seed, workers=workers,
        overwrite=overwrite,
    ))


@app.command()
def dataset(
    program: ScenarioArgument,
    out: Annotated[Path, typer.Option(help='folder for images and labels; must be new')],
    count: Annotated[int, typer.Option(help='images, one per scene')],
    sampler: Annotated[
        str, typer.Option(help='how scenes are drawn: random, halton, sobol or grid')
    ] = 'random',
    seed: SeedOption = 0,
    varied: VariedOption = False,
    workers: Annotated[int, typer.Option(help='processes that render')] = 2,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue what was interrupted')
    ] = False,
) -> None:
    """Render labelled images of scenes, to train on."""
    from taxinet_ros.cli.dataset import run_dataset
    from taxinet_ros.training.folder import DatasetOptions

    run_dataset(DatasetOptions(
        program=program, out=out, count=count, sampler=sampler, seed=seed, varied=varied,
        workers=workers, resume=resume,
    ))


@app.command()
def evaluate(
    program: PicturesArgument = None,
    data: Annotated[
        Path | None, typer.Option(help='folder of labelled images, instead of a program')
    ] = None,
    perception: PerceptionOption = 'taxinet',
    images: Annotated[int, typer.Option(help='pictures to render, one per scene')] = 2_000,
    seed: Annotated[
        int, typer.Option(min=0, help='of the scenes; another than that of the training')
    ] = 2,
    workers: Annotated[int, typer.Option(help='processes that render')] = 2,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
) -> None:
    """Measure a network's errors on single frames.

    On rendered scenes by light and place, or on a folder of labelled images.
    """
    from taxinet_ros.cli.evaluate import run_evaluate

    run_evaluate(
        program, data, perception=perception, images=images, seed=seed, workers=workers,
        as_json=as_json,
    )


@app.command()
def bench(
    subjects: Annotated[
        list[str] | None,
        typer.Argument(
            metavar='[SUBJECT]...', help='camera, inference, physics, monitor, loop or all'
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(help='how often each is measured, in turns')] = 40,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
    compare: Annotated[
        Path | None, typer.Option(metavar='OLD.json', help='a report to print ratios to')
    ] = None,
) -> None:
    """Measure how long everything takes, on one core."""
    from taxinet_ros.cli.bench import run_bench

    run_bench(subjects or (), repeats=repeats, as_json=as_json, old=compare)


@app.command(context_settings={'ignore_unknown_options': True, 'allow_extra_args': True})
def node(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help='simulator, taxinet_perception, …')],
) -> None:
    """Start one node, as `ros2 run taxinet_ros NAME` does.

    What follows NAME goes to the node (--ros-args …).
    """
    from taxinet_ros.cli.node import start_node

    start_node(name, context.args)


@app.callback(invoke_without_command=True)
def _main(
    context: typer.Context,
    version: Annotated[bool, typer.Option('--version', help='print the version and leave')] = False,
) -> None:
    if version:
        print(f'taxinet {__version__}')
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())


def main() -> None:
    """Entry point of ``taxinet``."""
    sys.exit(_exit_code(lambda: app(standalone_mode=False)))


def _exit_code(command: Callable[[], object]) -> int:
    try:
        code = command()
    except TyperException as error:
        text = getattr(error, 'format_message', error.__str__)()
        return _complain(f'{text.rstrip(".")}; see taxinet --help', USAGE)
    except UsageError as error:
        return _complain(str(error), USAGE)
    except InfraError as error:
        return _complain(str(error), INFRA)
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except BrokenPipeError:
        return INFRA
    return code if isinstance(code, int) else 0


def _complain(line: str, code: int) -> int:
    print(f'taxinet: error: {" ".join(line.split())}', file=sys.stderr)
    return code
