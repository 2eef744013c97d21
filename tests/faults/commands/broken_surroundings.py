"""``taxinet`` where something around it is broken: forked, so that a command costs no start.

Read from stdin, a line of JSON each: words of the command and name of what is broken. Written to
stdout: exit code, and what it printed to stderr.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import io
import json
import os
import pkgutil
import resource
import shutil
import sys
import tempfile
from collections.abc import Callable
from typing import Any

from typer.main import get_command

import taxinet_ros.cli
from taxinet_ros.cli import main as program
from taxinet_ros.errors import UsageError


def closed(descriptor: int) -> Callable[[], None]:
    def set_up() -> None:
        os.close(descriptor)
        setattr(sys, ('stdin', 'stdout', 'stderr')[descriptor], None)
    return set_up


def full(descriptor: int) -> Callable[[], None]:
    return lambda: os.dup2(os.open('/dev/full', os.O_WRONLY), descriptor) and None


def unread() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    os.dup2(writing, 1)


def without(*names: str) -> Callable[[], None]:
    def set_up() -> None:
        for name in names:
            os.environ.pop(name, None)
    return set_up


def with_variable(name: str, value: str) -> Callable[[], None]:
    return lambda: os.environ.update({name: value})


def folder_gone() -> None:
    folder = tempfile.mkdtemp()
    os.chdir(folder)
    shutil.rmtree(folder)


def folder_not_utf8() -> None:
    os.makedirs(b'folder-\xff', exist_ok=True)
    os.chdir(b'folder-\xff')


def no_temporary() -> None:
    os.environ['TMPDIR'] = '/nowhere'
    tempfile.tempdir = '/nowhere'


def in_ascii() -> None:
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(encoding='ascii', errors='strict')


def few_files() -> None:
    resource.setrlimit(resource.RLIMIT_NOFILE, (12, 12))


SURROUNDINGS: dict[str, Callable[[], None]] = {
    'stdin closed': closed(0),
    'stdout closed': closed(1),
    'stderr closed': closed(2),
    'stdout full': full(1),
    'stderr full': full(2),
    'stdout unread': unread,
    'no HOME': without('HOME', 'ROS_HOME', 'ROS_LOG_DIR'),
    'HOME nowhere': with_variable('HOME', '/nowhere'),
    'no place for temporary files': no_temporary,
    'folder gone': folder_gone,
    'folder not UTF-8': folder_not_utf8,
    'ASCII': in_ascii,
    'no PATH': without('PATH'),
    'few files': few_files,
}


def trial(words: list[str], surroundings: str) -> tuple[int, str]:
    """Exit code and complaints of a command."""
    with tempfile.TemporaryFile() as complaints:
        child = os.fork()
        if not child:
            _be(words, surroundings, complaints.fileno())
        _, status = os.waitpid(child, 0)
        complaints.seek(0)
        return os.waitstatus_to_exitcode(status), complaints.read().decode(errors='replace')


def _be(words: list[str], surroundings: str, complaints: int) -> None:
    code: Any = 'nothing'
    try:
        os.dup2(os.open(os.devnull, os.O_RDWR), 1)
        os.dup2(complaints, 2)
        sys.argv = ['taxinet', *map(os.fsdecode, map(bytes.fromhex, words))]
        SURROUNDINGS[surroundings]()
        program.main()
    except SystemExit as error:
        code = error.code
    except BaseException as error:
        with contextlib.suppress(Exception):
            os.write(2, f'Traceback: {error!r}'.encode())
    with contextlib.suppress(Exception):
        sys.stdout.flush()
    os._exit(code if isinstance(code, int) else 99)


if __name__ == '__main__':
    # What takes time at the start of a command, once for all of them.
    loaded = [
        importlib.import_module(module.name)
        for module in pkgutil.walk_packages(taxinet_ros.cli.__path__, 'taxinet_ros.cli.')
    ]
    assert len(loaded) > 30
    program.app = get_command(program.app)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(UsageError):
        program.app(['gate', 'nowhere'], standalone_mode=False)
    gc.freeze()
    answers = os.fdopen(os.dup(1), 'w')
    for line in sys.stdin:
        answers.write(json.dumps(trial(*json.loads(line))) + '\n')
        answers.flush()
