"""Ctrl-C, SIGTERM and a closed terminal, wherever a campaign stands: code, bag, no leftovers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest
from command_process import COMMAND, RUN, ended, on_terminal, taxinet
from graph_runs import grown, steps_in
from process_table import children, gone
from waiting import wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.processes.interrupts import interrupts, interrupts_delayed, raise_interrupt
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.table import read_table

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

RUN = (*RUN, '--out', 'c')
BAG = 'c/nominal-s0-00000'
SIGNALS = pytest.mark.parametrize(
    ('number', 'code'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=['INT', 'TERM']
)


def test_given_a_signal_while_the_program_is_compiled_then_nothing_is_left_behind(tmp_path):
    with taxinet(*RUN, cwd=tmp_path) as campaign:
        wait_for(lambda: children(campaign.pid, 'scenic_child'))
        pids = [*children(campaign.pid, '')]
        campaign.send_signal(signal.SIGINT)
        result = ended(campaign)
    assert result == (130, '', 'taxinet: interrupted\n')
    wait_for(lambda: all(map(gone, pids)))
    assert list(tmp_path.iterdir()) == []


@SIGNALS
def test_given_a_signal_amid_a_run_then_its_bag_is_closed_and_no_other_run_begins(
    number, code, tmp_path
):
    with taxinet(*RUN, cwd=tmp_path) as campaign:
        wait_for(lambda: grown(tmp_path / BAG))
        campaign.send_signal(number)
        found, out, err = ended(campaign)
    assert (found, err) == (code, '')
    assert '1 INTERRUPTED' in out
    assert list(read_table(tmp_path / 'c')['outcome']) == ['INTERRUPTED']
    assert read_info(tmp_path / BAG).complete
    (row,) = read_campaign(tmp_path / 'c').rows
    assert steps_in(tmp_path / BAG) == list(range(row.steps))


def test_given_signal_after_signal_then_nothing_is_waited_for_and_nothing_is_left(tmp_path):
    with taxinet(*RUN, '--processes', cwd=tmp_path) as campaign:
        wait_for(lambda: grown(tmp_path / BAG))
        pids = children(campaign.pid, '')
        (simulator,) = children(campaign.pid, 'nodes.simulator')
        os.kill(simulator, signal.SIGSTOP)  # One signal would now wait for it for a minute.
        campaign.send_signal(signal.SIGINT)
        campaign.send_signal(signal.SIGTERM)
        result = ended(campaign)
    assert (result[0], result[2]) == (143, 'taxinet: interrupted\n')
    wait_for(lambda: all(map(gone, pids)))
    steps = steps_in(tmp_path / BAG)
    assert len(steps) > 3
    assert steps == list(range(len(steps)))
    assert read_campaign(tmp_path / 'c').unfinished == (0,)


def test_given_a_terminal_that_is_closed_amid_a_run_then_its_bag_is_closed(tmp_path):
    with on_terminal(*COMMAND, *RUN, cwd=tmp_path) as terminal:
        wait_for(lambda: grown(tmp_path / BAG))
        pids = [*children(terminal.process.pid, '')]
        terminal.close()
        assert terminal.process.wait() == 129
    wait_for(lambda: all(map(gone, pids)))
    table = read_table(tmp_path / 'c')
    assert set(table['outcome']) == {'INTERRUPTED'}
    for name in table['run_id']:
        assert read_info(tmp_path / 'c' / name).complete


def test_given_work_that_does_not_return_then_the_second_interrupt_ends_the_process_at_once():
    program = (
        'import os, signal, time\n'
        'from taxinet_ros.processes.interrupts import interrupts\n'
        'with interrupts(lambda: print("first", flush=True)):\n'
        '    os.kill(os.getpid(), signal.SIGINT)\n'
        '    os.kill(os.getpid(), signal.SIGTERM)\n'
        '    time.sleep(600)\n'
    )
    done = subprocess.run(
        [sys.executable, '-P', '-c', program], capture_output=True, text=True, check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (
        143, 'first\n', 'taxinet: interrupted\n')


@pytest.mark.parametrize('lost', [
    'callback = weakref.ref(thing, lambda gone: os.kill(os.getpid(), signal.SIGTERM)); del thing',
    'type(thing).__del__ = lambda gone: os.kill(os.getpid(), signal.SIGTERM); del thing',
    'import interrupted',
])
def test_given_an_interrupt_that_other_code_would_drop_then_the_command_still_ends(lost, tmp_path):
    (tmp_path / 'interrupted.py').write_text(  # like numpy's C modules
        'import os, signal\n'
        'try: os.kill(os.getpid(), signal.SIGTERM)\n'
        'except BaseException as error: raise ImportError("failed to import") from error\n'
    )
    program = (
        'import os, signal, weakref\n'
        'from taxinet_ros.cli.start import _run\n'
        'from taxinet_ros.processes.interrupts import handle_signals, raise_interrupt\n'
        'def work():\n'
        '    handle_signals(raise_interrupt)\n'
        '    thing = type("Thing", (), {})()\n'
        f'    {lost}\n'
        '    print("went on")\n'
        '_run(work)'
    )
    done = subprocess.run(
        [sys.executable, '-P', '-c', program], capture_output=True, text=True, check=False,
        env=os.environ | {'PYTHONPATH': str(tmp_path)},
    )
    assert (done.returncode, done.stdout, done.stderr) == (143, '', 'taxinet: interrupted\n')


def test_given_nohup_then_a_closed_terminal_ends_nothing():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    heard: list[str] = []
    try:
        with interrupts(lambda: heard.append('first')):
            os.kill(os.getpid(), signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert heard == []


def test_given_a_closing_then_an_interrupt_takes_effect_at_its_end():
    done: list[str] = []
    before = signal.signal(signal.SIGTERM, raise_interrupt)

    def close() -> None:
        with interrupts_delayed():
            os.kill(os.getpid(), signal.SIGTERM)
            done.append('closed')
        done.append('and on')

    try:
        with pytest.raises(KeyboardInterrupt):
            close()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert done == ['closed']
