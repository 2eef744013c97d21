"""``taxinet``: run scenarios, search for failures, train the network, start nodes.

Exit codes: 0 every run satisfied its specifications, 1 some run violated one, 2 bad input,
3 inconclusive, or a recording is incomplete, 4 infrastructure error, 130 interrupted,
143 terminated by SIGTERM, 141 output closed by its reader.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import logging
import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from taxinet_ros.bag.errors import BagError
from taxinet_ros.cli.commands import Commands
from taxinet_ros.cli.completion import ASKED_BY, answer_shell
from taxinet_ros.errors import ExitCode, InfraError, RecordError, UsageError, plain_line
from taxinet_ros.files.atomic import disk_words
from taxinet_ros.processes.interrupts import (
    ToldInterrupt,
    heeded_signals,
    interrupted_exit_code,
    raise_interrupt,
    say_interrupted,
    signals_handled,
)
from taxinet_ros.processes.streams import drop_output, fill_standard_streams
from taxinet_ros.version import __version__

_COMPLETING = {'--install-completion', '--show-completion'}
_UNREAD = 'output: closed by its reader'
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


class _App(typer.Typer):
    """Builds its commands once, and leaves exceptions to :func:`main`."""

    @functools.cached_property
    def built(self) -> Any:
        """The parser of all commands."""
        return typer.main.get_command(self)

    def __call__(self, words: Sequence[str], **_: Any) -> object:
        """Run the command that the words name.

        Returns:
            Its exit code, or None.
        """
        try:
            with self.built.make_context('taxinet', list(words)) as context:
                return self.built.invoke(context)
        except typer.Exit as end:
            return end.exit_code


app = _App(
    cls=Commands,
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
    """Run the command that the arguments name, and exit with its code."""
    with signals_handled(raise_interrupt, heeded_signals()):
        code = _delivered(_exit_code(lambda: _command(sys.argv[1:])))
    sys.exit(interrupted_exit_code(code))


def _command(words: Sequence[str]) -> object:
    closed = sys.stdout is None
    fill_standard_streams()
    if closed:
        raise UsageError('standard output is closed; redirect it, e.g. to /dev/null')
    for word in words:
        _check_word(word)
    with contextlib.suppress(OSError):  # few commands need the working directory to exist
        _check_word(os.getcwd())
    _have_folders_somewhere()
    if ASKED_BY in os.environ or {*words[:1]} & _COMPLETING:  # these end the process
        return answer_shell(
            lambda: app.built(standalone_mode=False, prog_name='taxinet'), os.environ
        )
    return app(words)


def _delivered(code: int) -> int:
    """``code``, if the output could be delivered; else the exit code of that failure."""
    try:
        sys.stdout.flush()
    except OSError as error:
        drop_output(1)
        if code in (ExitCode.UNREAD, ExitCode.INFRA):
            return code
        if isinstance(error, BrokenPipeError):
            return _complain(_UNREAD, ExitCode.UNREAD)
        return _complain(f'output: {disk_words(error)}', ExitCode.INFRA)
    return code


def _check_word(word: str) -> None:
    """Refuse text that cannot be encoded for printing, tables and bags."""
    try:
        word.encode()
    except UnicodeEncodeError:
        shown = os.fsencode(word).decode('utf-8', 'backslashreplace')
        raise UsageError(f'{shown}: is not UTF-8; give a name that is') from None


def _have_folders_somewhere() -> None:
    """Give rclpy and matplotlib folders to write in if there is no writable home directory."""
    logging.getLogger('matplotlib').setLevel(logging.ERROR)  # it tells of fonts before our lines
    home = os.environ.get('HOME')
    if home and os.access(home, os.W_OK | os.X_OK):
        return
    folder = os.path.join(tempfile.gettempdir(), f'taxinet_ros_{os.getuid()}')
    if not os.environ.get('ROS_HOME'):
        os.environ.setdefault('ROS_LOG_DIR', folder)
    os.environ.setdefault('MPLCONFIGDIR', folder)


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
    except KeyboardInterrupt as interrupt:
        if not isinstance(interrupt, ToldInterrupt):
            say_interrupted()
        return ExitCode.INTERRUPTED
    except (InfraError, RecordError, BagError) as error:
        return _complain(str(error), ExitCode.INFRA)
    except BrokenPipeError:
        return _complain(_UNREAD, ExitCode.UNREAD)
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
            'colcon build with msg_defs); --engine loop --audit 0 needs neither, taxinet doctor '
            'says what is here'
        ), ExitCode.USAGE
    if isinstance(error, SystemExit) and isinstance(error.__context__, BrokenPipeError):
        return _UNREAD, ExitCode.UNREAD  # so rich ends a program
    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f'{Path(frame.filename).name}:{frame.lineno}'
    what = 'this is a defect of taxinet' if isinstance(error, Exception) else 'it ended the command'
    return (
        f'{type(error).__name__} in {place}: {plain_line(str(error))}; {what} '
        '(set TAXINET_TRACEBACK=1 for the traceback)'
    ), ExitCode.INFRA


def _complain(line: str, code: int) -> int:
    with contextlib.suppress(OSError):  # nobody can be told
        print(f'taxinet: error: {" ".join(line.split())}', file=sys.stderr)
    return code
