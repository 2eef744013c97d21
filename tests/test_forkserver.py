"""A fork is to its starter, and to itself, what a process started anew would be."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from forkserver import FORKED

pytestmark = pytest.mark.skipif(
    os.environ.get('TAXINET_FORKSERVER') == 'no', reason='each process is started anew'
)

PROBE = """
import json, os, resource, signal, sys, threading
def found(number):
    stream = (sys.stdin, sys.stdout, sys.stderr)[number]
    return [stream.name, stream.mode, stream.encoding, stream.errors, stream.line_buffering,
            stream.write_through, type(stream.buffer).__name__, stream.fileno(), stream.isatty()]
print(json.dumps({
    'argv': sys.argv, 'main': __name__, 'folder': os.getcwd(), 'path': sys.path,
    'environment': dict(os.environ), 'parent': os.getppid(), 'leads': os.getpgrp() == os.getpid(),
    'session': os.getsid(0) == os.getpid(), 'umask': os.umask(0),
    'threads': threading.active_count(), 'limits': [*map(resource.getrlimit, range(9))],
    'hooks': [repr(sys.excepthook), sys.getrecursionlimit(), sys.getswitchinterval()],
    'blocked': sorted(map(int, signal.pthread_sigmask(signal.SIG_BLOCK, ()))),
    'handlers': [repr(signal.getsignal(number)).split(' at ')[0] for number in range(1, 32)],
    'streams': [found(number) for number in range(3)], 'input': sys.stdin.read(),
    'passed': os.read(int(sys.argv[1]), 9).decode(),
}))
print('told', file=sys.stderr)
sys.exit(7)
"""
END = """
import os, sys
if sys.argv[1] == 'raise':
    raise ValueError('no')
if sys.argv[1] == 'words':
    sys.exit('words')
if sys.argv[1] == 'kill':
    os.kill(os.getpid(), 9)
"""
FAMILY = FORKED + """
import subprocess, sys
words = [sys.executable, '-c', sys.argv[1]]
child = subprocess.run(words, stdout=subprocess.PIPE, text=True)
print('torch' in sys.modules, 'scenic' in sys.modules, child.stdout.strip())
"""


def probed(code: str, folder: Path) -> tuple[dict[str, object], subprocess.CompletedProcess[str]]:
    read, write = os.pipe()
    os.write(write, b'passed on')
    os.close(write)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})
    try:
        done = subprocess.run(
            [sys.executable, '-c', code, str(read), 'a b'], input='typed', capture_output=True,
            text=True, cwd=folder, env={**os.environ, 'MINE': 'yes', 'PYTHONPATH': str(folder)},
            pass_fds=(read,), start_new_session=True, process_group=None, check=False,
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(read)
    return json.loads(done.stdout), done


def test_given_the_same_request_then_a_fork_finds_what_a_new_process_finds(tmp_path):
    (new, new_done), (fork, fork_done) = probed(PROBE, tmp_path), probed(FORKED + PROBE, tmp_path)
    assert (fork_done.returncode, fork_done.stderr) == (7, 'told\n')
    assert (new_done.returncode, new_done.stderr) == (7, 'told\n')
    environment, more = new.pop('environment'), fork.pop('environment')
    assert fork.pop('argv')[1:] == new.pop('argv')[1:]
    assert fork == new
    assert (new['passed'], new['input'], new['parent']) == ('passed on', 'typed', os.getpid())
    assert environment.items() <= more.items()


@pytest.mark.parametrize(('how', 'code', 'last'), [
    ('raise', 1, 'ValueError: no\n'), ('words', 1, 'words\n'), ('kill', -9, ''), ('', 0, ''),
])
def test_given_an_end_then_a_fork_ends_so(how, code, last):
    for first in ('', FORKED):
        done = subprocess.run(
            [sys.executable, '-c', first + END, how], capture_output=True, text=True, check=False)
        assert done.returncode == code
        assert done.stderr.endswith(last)
        assert bool(done.stderr) == bool(last)


def test_given_a_fork_then_what_it_starts_is_a_fork_of_its_own_server():
    code = FORKED + 'import os, sys; print(os.getppid(), "scenic" in sys.modules)'
    done = subprocess.Popen([sys.executable, '-c', FAMILY, code], stdout=subprocess.PIPE, text=True)
    out, _ = done.communicate()
    assert out == f'False True {done.pid} True\n'
    assert done.returncode == 0


def test_given_variables_that_are_read_while_python_starts_then_no_fork_is_made():
    code = FORKED + 'import sys; print("scenic" in sys.modules)'
    for variables, forked in (({}, True), ({'PYTHONHASHSEED': '3'}, False)):
        out = subprocess.run(
            [sys.executable, '-c', code], capture_output=True, text=True, check=True,
            env={**os.environ, **variables},
        ).stdout
        assert out == f'{forked}\n'
