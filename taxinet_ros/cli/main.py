"""``taxinet``: run scenarios, search for failures, train the network, start nodes.

Exit codes: 0 every run satisfied its specifications, 1 some run violated one, 2 bad input,
3 a recording is incomplete, 4 the bench broke, 130 interrupted, 143 by SIGTERM.
"""

from __future__ import annotations

import errno
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from typer.exceptions import TyperException

from taxinet_ros import __version__
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.layout import disk_words
from taxinet_ros.campaign.interrupts import (
    INTERRUPTED,
    end_now,
    handled,
    heard_again,
    told_apart,
)
from taxinet_ros.cli.analysis_commands import analyze, experiment, explain, gate, localize
from taxinet_ros.cli.bag import bag_app
from taxinet_ros.cli.camera import camera_app
from taxinet_ros.cli.given import given_options
from taxinet_ros.cli.monitor_command import monitor
from taxinet_ros.cli.run_commands import demo, falsify, learned, run, shrink, up
from taxinet_ros.cli.study_commands import case_study, improve
from taxinet_ros.cli.terminal import outlived_terminal
from taxinet_ros.cli.training_commands import dataset, evaluate, train
from taxinet_ros.core.errors import InfraError, UsageError

USAGE, INFRA = 2, 4
_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help=(__doc__ or '').replace('``', ''),
)
for command in (
    run, up, falsify, learned, shrink, analyze, localize, explain, experiment, gate, monitor, demo,
    train, dataset, evaluate, case_study, improve,
):
    app.command()(command)
app.add_typer(camera_app, name='camera')
app.add_typer(bag_app, name='bag')


@app.command()
def bench(
    context: typer.Context,
    subjects: Annotated[
        list[str] | None,
        typer.Argument(
            metavar='[SUBJECT]...',
            help='camera, inference, physics, monitor, samplers, loop, graph, start-up, campaign, '
            'or all (but the campaign), which none means too: 3 to 5 minutes on two cores; or '
            'soak; or intervals [SAMPLER]...',
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(help='how often each is measured, in turns')] = 40,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
    compare: Annotated[
        Path | None, typer.Option(metavar='OLD.json', help='a report to print ratios to')
    ] = None,
    peers: Annotated[
        str | None,
        typer.Option(metavar='PYTHON', help="one that has other people's monitors: measure them"),
    ] = None,
    guard: Annotated[
        bool, typer.Option('--guard', help='exit 1 if a guarded ratio is beyond its bounds')
    ] = False,
    runs: Annotated[int | None, typer.Option(min=1, help='soak: how many runs; 1000')] = None,
    duration: Annotated[
        float | None, typer.Option(help='soak: simulated length of each run; 3 [s]')
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(help='soak: wall time after which it ends; of --pid, 10 [min]')
    ] = None,
    pid: Annotated[
        int | None, typer.Option(min=1, help='soak: watch this process and its descendants instead')
    ] = None,
) -> None:
    """Measure how long everything takes, on one core; or soak.

    Medians, with their spread, and ratios between them: the closed loop over ROS 2, composed and
    as processes, and without; what a control step is made of; bytes and memory.

    `taxinet bench soak` runs very many short scenes in one process, or watches a process that runs
    already, for memory, files, threads and shared memory that grow; exit code 1 if any does.

    `taxinet bench intervals` searches landscapes whose failure rate is known, and says how often
    the intervals of `falsify` hold it and `gate` passes what it should not.
    """
    from taxinet_ros.cli.intervals import asks_for_intervals, run_intervals

    if asks_for_intervals(subjects or (), given_options(context)):
        raise typer.Exit(run_intervals((subjects or ())[1:], repeats=repeats, as_json=as_json))
    from taxinet_ros.cli.soak import asks_for_soak, run_soak

    if asks_for_soak(subjects or (), given_options(context)):
        raise typer.Exit(run_soak(
            runs=runs, duration_s=duration, minutes=minutes, pid=pid, as_json=as_json,
        ))
    from taxinet_ros.cli.bench import run_bench

    raise typer.Exit(run_bench(
        subjects or (), repeats=repeats, as_json=as_json, old=compare, peers=peers, guard=guard,
    ))


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
    with (
        outlived_terminal(), heard_again(), handled(end_now, (signal.SIGTERM, signal.SIGHUP))
    ):
        code = _exit_code(lambda: app(standalone_mode=False))
    sys.exit(told_apart(code))


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
    except BagError as error:
        return _complain(str(error), INFRA)
    except OSError as error:
        if error.errno not in _DISK_ERRORS:
            raise
        return _complain(f'{error.filename or "disk"}: {disk_words(error)}', INFRA)
    return code if isinstance(code, int) else 0


def _complain(line: str, code: int) -> int:
    print(f'taxinet: error: {" ".join(line.split())}', file=sys.stderr)
    return code
