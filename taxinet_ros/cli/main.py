"""``taxinet``: run scenarios, search for failures, train the network, start nodes.

Exit codes: 0 every run satisfied its specifications, 1 some run violated one, 2 bad input,
3 inconclusive, or a recording is incomplete, 4 infrastructure error, 130 interrupted,
143 terminated by SIGTERM, 141 output closed by its reader.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import functools
import logging
import os
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from taxinet_ros.bag.errors import BagError
from taxinet_ros.cli.commands import Commands
from taxinet_ros.cli.completion import ASKED_BY, answer_shell
from taxinet_ros.cli.streams import (
    OutputUnreadError,
    flush_output,
    refuse_special_files,
    standard_streams,
)
from taxinet_ros.errors import ExitCode, InfraError, RecordError, UsageError, plain_line
from taxinet_ros.files.atomic import disk_words
from taxinet_ros.processes.interrupts import (
    ToldInterrupt,
    interrupted_exit_code,
    lost_interrupts_resent,
    raise_interrupt,
    signals_handled,
)
from taxinet_ros.version import __version__

_COMPLETING = {'--install-completion', '--show-completion'}
_FILES_OF_A_NODE = 12
"""File descriptors a node opens at start, roughly: sockets, pipes, shared memory."""
_NOBODY_READS = 'output: closed by its reader'
_ROS = frozenset({
    'rclpy', 'taxinet_msgs', 'tf2_msgs', 'std_msgs', 'sensor_msgs', 'geometry_msgs', 'nav_msgs',
    'diagnostic_msgs', 'action_msgs', 'rosgraph_msgs', 'visualization_msgs', 'builtin_interfaces',
    'rcl_interfaces', 'std_srvs', 'domain_coordinator',
})
"""Packages of ROS 2, and of the messages built on it."""
_PATH_ERRORS = (
    errno.EACCES, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.ENOENT, errno.ENOTDIR,
    errno.EPERM,
)
"""Operating system errors that mean the path is unusable."""


class _Interrupted(BaseException):
    """Carries an interrupt past typer, which would turn it into an exit code silently."""


@contextlib.contextmanager
def _past_typer() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt as interrupt:
        raise _Interrupted from interrupt


class _Commands(Commands):
    def make_context(self, *words: Any, **named: Any) -> Any:
        with _past_typer():
            return super().make_context(*words, **named)

    def invoke(self, *words: Any, **named: Any) -> Any:
        with _past_typer():
            return super().invoke(*words, **named)


class _App(typer.Typer):
    """Builds its commands once: that takes a tenth of a second, and typer does it at each call."""

    @functools.cached_property
    def _built(self) -> Callable[..., object]:
        return typer.main.get_command(self)

    def __call__(self, *words: Any, **named: Any) -> Any:
        return self._built(*words, **named)


app = _App(
    cls=_Commands,
    context_settings={'help_option_names': ['-h', '--help']},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help=(__doc__ or '').replace('``', ''),
)


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
    code: int | None = None
    with (
        contextlib.suppress(KeyboardInterrupt),
        lost_interrupts_resent(),
        signals_handled(raise_interrupt, (signal.SIGTERM, signal.SIGHUP)),
        standard_streams() as closed,
    ):
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, raise_interrupt)
        code = _delivered(_exit_code(lambda: _command(closed)))
    sys.exit(interrupted_exit_code(_interrupted() if code is None else code))


def _interrupted() -> int:
    """Report an interrupt on stderr; return its exit code."""
    with contextlib.suppress(OSError):
        os.write(2, b'taxinet: interrupted\n')
    return ExitCode.INTERRUPTED


def _command(output_closed: bool) -> object:
    if output_closed:
        raise UsageError('standard output is closed; redirect it, e.g. to /dev/null')
    for word in sys.argv[1:]:
        _check_word(word)
    with contextlib.suppress(OSError):  # few commands need the working directory to exist
        _check_word(os.getcwd())
    _have_ros_log_somewhere()
    _have_matplotlib_somewhere()
    refuse_special_files()
    if ASKED_BY in os.environ or {*sys.argv[1:2]} & _COMPLETING:  # these end the process
        return answer_shell(lambda: app(standalone_mode=False, prog_name='taxinet'), os.environ)
    return app(standalone_mode=False, prog_name='taxinet')


def _delivered(code: int) -> int:
    """``code``, if the output could be delivered; else the exit code of that failure."""
    try:
        flush_output()
    except OutputUnreadError:
        return code if code == ExitCode.UNREAD else _complain(_NOBODY_READS, ExitCode.UNREAD)
    except OSError as error:
        if code != ExitCode.INFRA:
            return _complain(f'output: {disk_words(error)}', ExitCode.INFRA)
    return code


def _check_word(word: str) -> None:
    """Refuse text that cannot be encoded for printing, tables and bags."""
    try:
        word.encode()
    except UnicodeEncodeError:
        shown = os.fsencode(word).decode('utf-8', 'backslashreplace')
        raise UsageError(f'{shown}: is not UTF-8; give a name that is') from None


def _have_ros_log_somewhere() -> None:
    """Set a log folder for rclpy if there is no writable home directory."""
    if any(os.environ.get(name) for name in ('ROS_LOG_DIR', 'ROS_HOME')):
        return
    home = os.environ.get('HOME')
    if not (home and os.access(home, os.W_OK | os.X_OK)):
        os.environ['ROS_LOG_DIR'] = os.path.join(
            tempfile.gettempdir(), f'taxinet_ros_log_{os.getuid()}'
        )


def _have_matplotlib_somewhere() -> None:
    """Set a folder for matplotlib, removed at exit, if it has none; its children share it."""
    # Otherwise it prints lines about folders and fonts before ours.
    logging.getLogger('matplotlib').setLevel(logging.ERROR)
    own = os.environ.get('MPLCONFIGDIR')
    home = os.path.expanduser('~')
    usual = [
        os.path.join(os.environ.get(f'XDG_{name.upper()}_HOME') or f'{home}/.{name}', 'matplotlib')
        for name in ('config', 'cache')
    ]
    if all(map(_takes_folders, [own] if own else usual)):
        return
    with contextlib.suppress(OSError):
        folder = tempfile.mkdtemp(prefix='taxinet_matplotlib_')
        os.environ['MPLCONFIGDIR'] = folder
        atexit.register(shutil.rmtree, folder, ignore_errors=True)


def _takes_folders(path: str) -> bool:
    """Whether this folder is writable, or can be made."""
    while not os.path.lexists(path) and os.path.dirname(path) != path:
        path = os.path.dirname(path)
    return os.path.isdir(path or '.') and os.access(path or '.', os.W_OK | os.X_OK)


def _exit_code(command: Callable[[], object]) -> int:
    try:
        code = command()
    except TyperException as error:
        text = getattr(error, 'format_message', error.__str__)()
        context: Any = getattr(error, 'ctx', None)
        where = 'taxinet' if context is None else context.command_path
        return _complain(f'{text.rstrip(".")}; see {where} --help', ExitCode.USAGE)
    except UsageError as error:
        return _complain(str(error), ExitCode.USAGE)
    except (_Interrupted, KeyboardInterrupt, typer.Abort) as end:
        told = isinstance(end.__cause__, ToldInterrupt)
        return ExitCode.INTERRUPTED if told else _interrupted()
    except (InfraError, RecordError, BagError) as error:
        return _complain(str(error), ExitCode.INFRA)
    except OutputUnreadError:
        return _complain(_NOBODY_READS, ExitCode.UNREAD)
    except OSError as error:
        code = ExitCode.USAGE if error.errno in _PATH_ERRORS else ExitCode.INFRA
        return _complain(f'{error.filename or "output"}: {disk_words(error)}', code)
    except MemoryError:
        return _complain('out of memory', ExitCode.INFRA)
    except BaseException as error:  # an exit without a result is not a success
        return _complain(*_unforeseen(error))
    return code if isinstance(code, int) else ExitCode.OK


def _unforeseen(error: BaseException) -> tuple[str, int]:
    """A line for an unexpected error, and its exit code; the traceback if asked for."""
    if os.environ.get('TAXINET_TRACEBACK'):
        traceback.print_exception(error)
    if isinstance(error, ModuleNotFoundError) and (error.name or '').partition('.')[0] in _ROS:
        return (
            f'no {error.name} in this Python: it belongs to ROS 2 (make installs it as wheels; or '
            'source a Jazzy installation) or to its messages (make, taxinet setup-messages, or '
            'colcon build with msg_defs); --engine loop needs neither, taxinet doctor says what is '
            'here'
        ), ExitCode.USAGE
    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f'{Path(frame.filename).name}:{frame.lineno}'
    if scarce := _scarce_files():
        what = scarce
    elif isinstance(error, Exception):
        what = 'this is a defect of taxinet'
    else:  # SystemExit, for example from user code
        what = 'it ended the command'
    return (
        f'{type(error).__name__} in {place}: {plain_line(str(error))}; {what} '
        '(set TAXINET_TRACEBACK=1 for the traceback)'
    ), ExitCode.INFRA


def _scarce_files() -> str:
    """A message if the process is close to its limit of open files; else ''.

    ROS gives no reason when it runs out of file descriptors for its sockets.
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
