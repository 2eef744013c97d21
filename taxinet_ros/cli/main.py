"""``taxinet``: run scenarios, search for failures, train the network, start nodes.

Exit codes: 0 every run satisfied its specifications, 1 some run violated one, 2 bad input,
3 a recording is incomplete, 4 the bench broke, 130 interrupted, 143 by SIGTERM, 141 nobody reads
the output any more.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
import resource
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from typer.exceptions import TyperException

from taxinet_ros.bag.errors import BagError
from taxinet_ros.cli.analysis.commands import (
    analyze,
    doctor,
    explain,
    gate,
    localize,
    monitor,
    spec,
)
from taxinet_ros.cli.bag.commands import bag_app
from taxinet_ros.cli.options import asks_for_study, given_options
from taxinet_ros.cli.run.commands import (
    check_node,
    demo,
    experiment,
    falsify,
    learned,
    run,
    shrink,
    up,
)
from taxinet_ros.cli.streams import (
    OutputUnreadError,
    flush_output,
    refuse_special_files,
    standard_streams,
)
from taxinet_ros.cli.study.commands import case_study, improve
from taxinet_ros.cli.training.commands import camera_app, dataset, evaluate, train
from taxinet_ros.errors import ExitCode, InfraError, RecordError, UsageError, plain_line
from taxinet_ros.files.atomic import disk_words
from taxinet_ros.processes.interrupts import (
    interrupted_exit_code,
    lost_interrupts_resent,
    raise_interrupt,
    signals_handled,
)
from taxinet_ros.version import __version__

NODES = (
    'simulator',
    'taxinet_perception',
    'ground_truth_perception',
    'steering_controller',
    'mtl_monitor',
    'scenario_sampler',
    'recorder',
    'bag_player',
    'scene_markers',
    'foxglove_server',
)


def start_node(name: str, arguments: Sequence[str]) -> None:
    """Run a node's ``main`` with ``arguments``; comes back by :class:`SystemExit`.

    Raises:
        UsageError: no such node.
    """
    if name not in NODES:
        raise UsageError(f'unknown node {name!r}; known: {", ".join(NODES)}')
    sys.argv = [name, *arguments]
    importlib.import_module(f'taxinet_ros.nodes.{name}').main()


_FILES_OF_A_NODE = 12
"""What a node opens at once, about: sockets, pipes, shared memory."""
_NOBODY_READS = 'output: nobody reads it any more'
_PATH_ERRORS = (
    errno.EACCES, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.ENOENT, errno.ENOTDIR,
    errno.EPERM,
)
"""Errors of the operating system that speak of a path that does not do."""
app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help=(__doc__ or '').replace('``', ''),
)
for command in (
    run, up, check_node, falsify, learned, shrink, analyze, localize, explain, experiment, gate,
    doctor, monitor, spec, demo, train, dataset, evaluate, case_study, improve,
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
            'soak; or chaos; or intervals [SAMPLER]...; or searches [SAMPLER|LANDSCAPE]...',
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
        float | None,
        typer.Option(help='soak, chaos: wall time after which it ends; of --pid, chaos 10 [min]')
    ] = None,
    pid: Annotated[
        int | None, typer.Option(min=1, help='soak: watch this process and its descendants instead')
    ] = None,
    seed: Annotated[int, typer.Option(help='chaos: seed of all random choices')] = 0,
    trials: Annotated[int | None, typer.Option(min=1, help='chaos: how many trials')] = None,
    trial: Annotated[int | None, typer.Option(min=0, help='chaos: only this trial')] = None,
) -> None:
    """Benchmark every part on one core; or run soak and chaos tests.

    Medians, with their spread, and ratios between them: the closed loop over ROS 2, composed and
    as processes, and without; what a control step is made of; bytes and memory.

    `taxinet bench soak` runs very many short scenes in one process, or watches a process that runs
    already, for memory, files, threads and shared memory that grow; exit code 1 if any does.

    `taxinet bench intervals` searches landscapes whose failure rate is known, and says how often
    the intervals of `falsify` hold it and `gate` passes what it should not.

    `taxinet bench searches` searches landscapes whose failure regions are known, and says how many
    of them each sampler finds in 200 runs.

    `taxinet bench chaos` kills, stops, moves and damages small campaigns, resumes them, and sees
    whether they end as if nobody had disturbed them; exit code 4 if one does not.
    """
    words, given = subjects or [], given_options(context)
    from taxinet_ros.cli.bench.chaos import asks_for_chaos, run_chaos

    if asks_for_chaos(words, given):
        raise typer.Exit(run_chaos(
            seed=seed, minutes=minutes, trials=trials, trial=trial, as_json=as_json,
        ))
    if asks_for_study('intervals', words, given):
        from taxinet_ros.cli.bench.samplers import run_intervals

        raise typer.Exit(run_intervals(words[1:], repeats=repeats, as_json=as_json))
    if asks_for_study('searches', words, given):
        from taxinet_ros.cli.bench.samplers import run_searches

        raise typer.Exit(run_searches(words[1:], repeats=repeats, as_json=as_json))
    from taxinet_ros.cli.bench.soak import asks_for_soak, run_soak

    if asks_for_soak(words, given):
        raise typer.Exit(run_soak(
            runs=runs, duration_s=duration, minutes=minutes, pid=pid, as_json=as_json,
        ))
    from taxinet_ros.cli.bench.subjects import run_bench

    raise typer.Exit(run_bench(
        words, repeats=repeats, as_json=as_json, old=compare, peers=peers, guard=guard,
    ))


@app.command(context_settings={'ignore_unknown_options': True, 'allow_extra_args': True})
def node(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help='simulator, taxinet_perception, …')],
) -> None:
    """Start one node, as `ros2 run taxinet_ros NAME` does.

    What follows NAME goes to the node (--ros-args …).
    """
    try:
        start_node(name, context.args)
    except SystemExit as end:  # as every node ends
        raise typer.Exit(end.code if isinstance(end.code, int) else ExitCode.INFRA) from None


@app.callback(invoke_without_command=True)
def _main(
    context: typer.Context,
    version: Annotated[bool, typer.Option('--version', help='print the version and exit')] = False,
) -> None:
    if version:
        print(f'taxinet {__version__}')
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())


def main() -> None:
    """Entry point of ``taxinet``."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, raise_interrupt)
    code: int = ExitCode.INTERRUPTED
    with (
        contextlib.suppress(KeyboardInterrupt),
        lost_interrupts_resent(),
        signals_handled(raise_interrupt, (signal.SIGTERM, signal.SIGHUP)),
        standard_streams() as closed,
    ):
        code = _delivered(_exit_code(lambda: _command(closed)))
    sys.exit(interrupted_exit_code(code))


def _command(output_closed: bool) -> object:
    if output_closed:
        raise UsageError('standard output is closed; send it somewhere, if to /dev/null')
    for word in sys.argv[1:]:
        _check_word(word)
    with contextlib.suppress(OSError):  # a folder that is gone matters to few commands
        _check_word(os.getcwd())
    _have_ros_log_somewhere()
    refuse_special_files()
    return app(standalone_mode=False, prog_name='taxinet')


def _delivered(code: int) -> int:
    """An exit code, where what was printed has come to where it was to go."""
    try:
        flush_output()
    except OutputUnreadError:
        return code if code == ExitCode.UNREAD else _complain(_NOBODY_READS, ExitCode.UNREAD)
    except OSError as error:
        if code != ExitCode.INFRA:
            return _complain(f'output: {disk_words(error)}', ExitCode.INFRA)
    return code


def _check_word(word: str) -> None:
    """Refuse what cannot be printed, nor written into tables and bags."""
    try:
        word.encode()
    except UnicodeEncodeError:
        shown = os.fsencode(word).decode('utf-8', 'backslashreplace')
        raise UsageError(f'{shown}: is not UTF-8; give a name that is') from None


def _have_ros_log_somewhere() -> None:
    """Name a folder for what rclpy logs, where there is no home that it could write to."""
    if any(os.environ.get(name) for name in ('ROS_LOG_DIR', 'ROS_HOME')):
        return
    home = os.environ.get('HOME')
    if not (home and os.access(home, os.W_OK | os.X_OK)):
        os.environ['ROS_LOG_DIR'] = os.path.join(
            tempfile.gettempdir(), f'taxinet_ros_log_{os.getuid()}'
        )


def _exit_code(command: Callable[[], object]) -> int:
    try:
        code = command()
    except TyperException as error:
        text = getattr(error, 'format_message', error.__str__)()
        return _complain(f'{text.rstrip(".")}; see taxinet --help', ExitCode.USAGE)
    except UsageError as error:
        return _complain(str(error), ExitCode.USAGE)
    except (KeyboardInterrupt, typer.Abort):
        return ExitCode.INTERRUPTED
    except (InfraError, RecordError, BagError) as error:
        return _complain(str(error), ExitCode.INFRA)
    except OutputUnreadError:
        return _complain(_NOBODY_READS, ExitCode.UNREAD)
    except OSError as error:
        code = ExitCode.USAGE if error.errno in _PATH_ERRORS else ExitCode.INFRA
        return _complain(f'{error.filename or "output"}: {disk_words(error)}', code)
    except MemoryError:
        return _complain('out of memory', ExitCode.INFRA)
    except BaseException as error:  # to be at its end without a result is nobody's success
        return _complain(_unforeseen(error), ExitCode.INFRA)
    return code if isinstance(code, int) else ExitCode.OK


def _unforeseen(error: BaseException) -> str:
    """One line on a mistake of ours; all of it where somebody asks for it."""
    if os.environ.get('TAXINET_TRACEBACK'):
        traceback.print_exception(error)
    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f'{Path(frame.filename).name}:{frame.lineno}'
    if scarce := _scarce_files():
        what = scarce
    elif isinstance(error, Exception):
        what = 'this is a defect of taxinet'
    else:  # it is SystemExit, as out of somebody's handler
        what = 'it ended what was at hand'
    return (
        f'{type(error).__name__} in {place}: {plain_line(str(error))}; {what} '
        '(TAXINET_TRACEBACK=1 shows where it comes from)'
    )


def _scarce_files() -> str:
    """What there is to say where there are hardly any files left to open; else ''.

    ROS tells no reason where it has none for its sockets.
    """
    allowed = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    try:
        in_use = len(os.listdir('/proc/self/fd'))
    except OSError as error:
        in_use = allowed if error.errno in (errno.EMFILE, errno.ENFILE) else 0
    if in_use + _FILES_OF_A_NODE <= allowed:
        return ''
    return f'too many open files: ulimit -n is {allowed}, and {in_use} are open; raise it'


def _complain(line: str, code: int) -> int:
    print(f'taxinet: error: {" ".join(line.split())}', file=sys.stderr)
    return code
