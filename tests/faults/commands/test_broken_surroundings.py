"""Closed, full and unread streams, no home, odd paths: one line, and an exit code of no verdict."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_process import COMMAND, RUN

pytestmark = pytest.mark.nightly
WRONG = re.compile('Traceback|a defect of taxinet|\x1b')
CLOSED = 'standard output is closed; redirect it, e.g. to /dev/null'
BROKEN = {  # shell words around the command, and exit code and complaint where it has output
    'stdin closed': ('exec "$@" <&-', 0, ''),
    'stdout closed': ('exec "$@" >&-', 2, CLOSED),
    'stderr closed': ('exec "$@" 2>&-', 0, ''),
    'stdout full': ('exec "$@" >/dev/full', 4, 'output: [Errno 28] No space left on device'),
    'stderr full': ('exec "$@" 2>/dev/full', 0, ''),
    'no HOME': ('unset HOME; exec "$@"', 0, ''),
    'HOME nowhere': ('HOME=/nowhere exec "$@"', 0, ''),
    'no place for temporary files': ('TMPDIR=/nowhere HOME=/nowhere exec "$@"', 0, ''),
    'folder gone': ('mkdir d; cd d; rmdir ../d; exec "$@"', 0, ''),
    'folder not UTF-8': (r"d=$(printf 'd\377'); mkdir $d; cd $d; exec " '"$@"', 2,
                         r'd\xff: is not UTF-8; give a name that is'),
    'ASCII': ('PYTHONIOENCODING=ascii exec "$@"', 0, ''),
    'no PATH': ('unset PATH; exec "$@"', 0, ''),
}


def asked(around: str, *words: str | bytes, cwd: Path) -> tuple[int, str]:
    """Exit code and complaint of a command."""
    done = subprocess.run(
        ['sh', '-c', around, 'sh', *COMMAND, *words], capture_output=True, text=True, cwd=cwd,
        check=False,
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize('name', BROKEN)
def test_f6_given_broken_surroundings_then_the_code_tells_whether_the_output_was_heard(
    name, tmp_path
):
    around, code, complaint = BROKEN[name]
    found, err = asked(around, '--help', cwd=tmp_path)
    assert (found, err.count('\n')) == (code, int(bool(complaint))), err
    assert err.endswith(f'{complaint}\n' if complaint else '')
    assert not WRONG.search(err)
    if name in ('stderr closed', 'stdout full', 'folder gone'):
        (tmp_path / 'again').mkdir()
        refused, err = asked(around, 'gate', 'nowhere', cwd=tmp_path / 'again')
        assert (refused, len(err.splitlines()) <= 1, WRONG.search(err)) == (2, True, None), err


def test_f6_given_output_that_nobody_reads_then_the_code_is_that_of_sigpipe(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [*COMMAND, 'plugins'], stdout=writing, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        check=False,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, 'taxinet: error: output: closed by its reader\n')


@pytest.mark.parametrize(('word', 'complaint'), [
    (b'x' * 300, 'taxinet: error: '), (b'y/' * 2500, 'taxinet: error: '),
    (b'\xff\xfe', r'\xff\xfe: is not UTF-8; give a name that is'), (b'a\x1b[31mb', ''),
])
def test_f7_given_a_path_that_cannot_be_then_one_line_says_so(word, complaint, tmp_path):
    code, err = asked('exec "$@"', 'bag', 'info', word, cwd=tmp_path)
    assert (code, err.count('\n'), complaint in err, WRONG.search(err)) == (2, 1, True, None), err


@pytest.mark.ros
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_f7_given_a_signal_at_the_start_then_it_ends_in_one_line(number, tmp_path):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
    begun = 'import os; from taxinet_ros.cli.start import main; os.write(1, b"begun"); main()'
    for moment_s in (0.02, 0.3, 1.0):
        with subprocess.Popen(
            [sys.executable, '-P', '-c', begun, *RUN, '--out', str(moment_s)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        ) as command:
            command.stdout.read(5)
            time.sleep(moment_s)  # not waited for: the moment is the point
            command.send_signal(number)
            _, err = command.communicate()
        # A shell has one code for both; before the command handles signals, the system does.
        assert command.returncode in (128 + number, -number), err
        assert err in ('', 'taxinet: interrupted\n')
