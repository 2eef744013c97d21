"""``taxinet``: run scenarios, train the network, start nodes.

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
from taxinet_ros.core.errors import InfraError, UsageError

USAGE, INFRA, INTERRUPTED = 2, 4, 130

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help=(__doc__ or '').replace('``', ''),
)

ScenarioArgument = Annotated[
    str, typer.Argument(metavar='SCENARIO', help='shipped program (s_falsif, …) or a .scenic file')
]
RunsOption = Annotated[int, typer.Option(min=1, help='number of scenes to draw and run')]
SeedOption = Annotated[int, typer.Option(min=0, help='seed of the scenes')]
OutOption = Annotated[Path | None, typer.Option(help='folder for bags and table; must be new')]
PerceptionOption = Annotated[
    str, typer.Option(help='truth, taxinet, or a .safetensors weights file')
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        '--set', metavar='KEY=VALUE',
        help='fix a scenario value (clouds=clear, time_of_day=9.5, heading=-20, duration=10, …) '
        'or a gain (steering.heading_gain=1.2); repeatable',
    ),
]
SpecOption = Annotated[
    list[str] | None,
    typer.Option(
        '--spec', metavar='FORMULA',
        help='phi_eventually (default), phi_always, on_runway, NAME=FORMULA or a formula; '
        'repeatable, the first is the headline',
    ),
]
ProcessesOption = Annotated[
    bool, typer.Option('--processes', help='every node a process of its own, same results')
]


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
) -> None:
    """Draw scenes from a Scenic program and run each through the whole graph into a bag."""
    from taxinet_ros.campaign.options import make_options
    from taxinet_ros.cli.campaign import run_campaign

    options = make_options(
        program=scenario, runs=runs, seed=seed, perception=perception,
        settings=settings or (), specs=spec or (), out=out, processes=processes,
    )
    raise typer.Exit(run_campaign(options))


@app.command()
def demo(
    out: OutOption = None,
    runs: RunsOption = 10,
    seed: SeedOption = 1,
) -> None:
    """Run the same scenes of S_falsif with the network and with the truth, and picture both."""
    from taxinet_ros.cli.demo import run_demo

    raise typer.Exit(run_demo(out, runs=runs, seed=seed))


@app.command()
def train(
    program: ScenarioArgument,
    out: Annotated[Path, typer.Option(help='weights file to write, NAME.safetensors')],
    images: Annotated[int, typer.Option(help='pictures to train on, one per scene')] = 12_000,
    validation: Annotated[int, typer.Option(help='scenes held back to measure on')] = 1_500,
    epochs: Annotated[int, typer.Option(help='times that every picture is seen')] = 20,
    batch: Annotated[int, typer.Option(help='pictures per step')] = 64,
    learning_rate: Annotated[float, typer.Option(help='highest of the schedule')] = 3e-3,
    seed: Annotated[int, typer.Option(help='of everything random')] = 1,
    workers: Annotated[int, typer.Option(help='processes that render')] = 2,
    overwrite: Annotated[bool, typer.Option('--overwrite', help='replace what is there')] = False,
) -> None:
    """Train TaxiNet on rendered frames of a program's scenes; writes weights and model card."""
    from taxinet_ros.cli.train import run_train
    from taxinet_ros.training.train import TrainOptions

    run_train(TrainOptions(
        program=program, out=out, images=images, validation=validation, epochs=epochs,
        batch=batch, learning_rate=learning_rate, seed=seed, workers=workers, overwrite=overwrite,
    ))


@app.command(context_settings={'ignore_unknown_options': True, 'allow_extra_args': True})
def node(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help='simulator, taxinet_perception, …')],
) -> None:
    """Start one node, as `ros2 run taxinet_ros NAME` does; the rest goes to it (--ros-args …)."""
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
