from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from process_table import gone
from waiting import PATIENT_S, wait_for

import taxinet_ros
from taxinet_ros.processes.child import (
    ChildProcess,
    end_all,
    exit_words,
    module_command,
    open_pipe,
    package_environment,
)

SLEEPS = 'import time; print("up", flush=True); time.sleep(600)'
DEAF = f'import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {SLEEPS}'


def python(script: str) -> list[str]:
    return [sys.executable, '-c', script]


def started(child: ChildProcess) -> ChildProcess:
    wait_for(lambda: child.last_line() != '')
    return child


@pytest.mark.parametrize(('script', 'how'), [
    ('pass', 'exit code 0'),
    ('import sys; print("first"); sys.exit("the reason")', 'exit code 1: the reason'),
    ('import os; os.kill(os.getpid(), 9)', 'killed by SIGKILL'),
    ('import os; os.kill(os.getpid(), 64)', 'killed by SIGRTMAX'),
    ('import os; os.kill(os.getpid(), 40)', 'killed by signal 40'),
])
def test_given_a_child_that_has_ended_then_it_is_said_how(tmp_path: Path, script, how) -> None:
    with ChildProcess('it', python(script), log=tmp_path / 'log') as child:
        child.wait()
    assert child.dead
    assert child.how_it_ended() == how


def test_given_a_child_started_again_then_its_log_goes_on(tmp_path: Path) -> None:
    child = ChildProcess('it', python('print("once")'), log=tmp_path / 'log')
    child.wait()
    child.start()
    assert child.wait() == 0
    assert (tmp_path / 'log').read_text() == 'once\nonce\n'


def test_given_children_when_ended_then_only_a_deaf_one_is_killed(tmp_path: Path) -> None:
    polite, deaf = (
        started(ChildProcess(name, python(script), log=tmp_path / name))
        for name, script in (('polite', SLEEPS), ('deaf', DEAF))
    )
    assert end_all([polite], ((signal.SIGTERM, PATIENT_S),)) == []
    assert end_all([polite, deaf], ((signal.SIGTERM, 0.1),)) == ['deaf']
    assert (polite.code, deaf.code) == (-signal.SIGTERM, -signal.SIGKILL)


def test_given_a_child_with_a_child_when_left_then_both_are_gone(tmp_path: Path) -> None:
    script = (
        'import subprocess, sys; one = subprocess.Popen([sys.executable, "-c", "input()"], '
        'stdin=subprocess.PIPE); print(one.pid, flush=True); one.wait()'
    )
    with ChildProcess('it', python(script), log=tmp_path / 'log') as child:
        grandchild = int(started(child).last_line())
    assert child.dead
    wait_for(lambda: gone(grandchild))


def test_given_a_parent_that_is_killed_then_its_child_goes_with_it(tmp_path: Path) -> None:
    log = tmp_path / 'log'
    script = f"""
import sys, time
from pathlib import Path
from taxinet_ros.processes.child import ChildProcess
child = ChildProcess('it', [sys.executable, '-c', {SLEEPS!r}], log=Path({str(log)!r}),
                     killed_with_parent=True)
print(child.pid, flush=True)
time.sleep(600)
"""
    with subprocess.Popen(
        python(script), stdout=subprocess.PIPE, env=package_environment()
    ) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        wait_for(lambda: log.read_text() != '')
        assert not gone(pid)
        parent.kill()
    wait_for(lambda: gone(pid))


def test_given_modules_of_the_user_when_ours_is_run_then_it_is_this_one(tmp_path: Path) -> None:
    (tmp_path / 'taxinet_ros').mkdir()
    (tmp_path / 'random.py').write_text('raise SystemExit("not me")')
    with ChildProcess(
        'it', module_command('taxinet_ros.cli.main', '--version'), folder=tmp_path,
        log=tmp_path / 'log', environment=package_environment(),
    ) as child:
        assert child.wait() == 0
    first = package_environment()['PYTHONPATH'].split(os.pathsep)[0]
    assert Path(first, 'taxinet_ros', '__init__.py') == Path(taxinet_ros.__file__).resolve()


def test_given_a_pipe_then_the_child_has_its_end(tmp_path: Path) -> None:
    read, write = open_pipe()
    with ChildProcess(
        'it', python(f'import os; os.write({write}, b"said")'), descriptors=(write,)
    ) as child:
        os.close(write)
        assert os.read(read, 100) == b'said'
        assert child.wait() == 0
    os.close(read)
    assert exit_words(0) == 'exit code 0'
