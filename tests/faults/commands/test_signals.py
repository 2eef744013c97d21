"""Ctrl-C, SIGTERM and a closed terminal, wherever a campaign stands: code, bag, no leftovers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
from importlib.machinery import ExtensionFileLoader, ModuleSpec
from types import ModuleType

import pytest
from command_process import COMMAND, ended, on_terminal, taxinet
from fault_runs import grown, steps_in
from process_table import children, gone
from waiting import wait_for

from taxinet_ros.bag.reader import read_info
from taxinet_ros.campaign.record.ledger import read_ledger
from taxinet_ros.campaign.record.table import read_table
from taxinet_ros.errors import ExitCode
from taxinet_ros.processes.interrupts import (
    interrupted_exit_code,
    interrupts,
    lost_interrupts_resent,
    raise_interrupt,
    signals_handled,
)

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

RUN = ('run', 'nominal', '--runs', '3', '--perception', 'truth', '--images', 'none',
       '--set', 'duration=600', '--out', 'c')
BAG = 'c/nominal-s0-00000'
SIGNALS = pytest.mark.parametrize(
    ('number', 'code'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=['INT', 'TERM']
)


@SIGNALS
def test_given_a_signal_while_the_program_is_compiled_then_nothing_is_left_behind(
    number, code, tmp_path
):
    with taxinet(*RUN, cwd=tmp_path) as campaign:
        wait_for(lambda: children(campaign.pid, 'scenic_child'))
        pids = [*children(campaign.pid, '')]
        campaign.send_signal(number)
        result = ended(campaign)
    assert result == (code, '', 'taxinet: interrupted\n')
    wait_for(lambda: all(map(gone, pids)))
    assert list(tmp_path.iterdir()) == []


@SIGNALS
def test_given_a_signal_while_nodes_find_each_other_then_the_run_is_interrupted(
    number, code, tmp_path
):
    with taxinet(*RUN, '--processes', cwd=tmp_path) as campaign:
        wait_for(lambda: len(children(campaign.pid, 'taxinet_ros.nodes')) == 5)
        pids = [*children(campaign.pid, '')]
        campaign.send_signal(number)
        found, out, err = ended(campaign)
    assert found == code, err
    assert 'Traceback' not in err
    assert '1 INTERRUPTED' in out
    assert list(read_table(tmp_path / 'c')['outcome']) == ['INTERRUPTED']
    wait_for(lambda: all(map(gone, pids)))


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
    (row,) = read_ledger(tmp_path / 'c' / 'ledger.jsonl').rows
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
    assert read_ledger(tmp_path / 'c' / 'ledger.jsonl').unfinished == (0,)


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


@SIGNALS
def test_given_a_signal_in_a_callback_that_may_not_raise_then_it_comes_again(number, code, capfd):
    class Forgotten:
        def __del__(self) -> None:
            os.kill(os.getpid(), number)

    def forget() -> None:
        Forgotten()
        threading.Event().wait()

    with (
        signals_handled(raise_interrupt),
        lost_interrupts_resent(),
        pytest.raises(KeyboardInterrupt),
    ):
        forget()
    assert interrupted_exit_code(ExitCode.INTERRUPTED) == code
    assert capfd.readouterr().err == ''


def test_given_a_signal_while_a_library_is_loaded_then_it_comes_when_that_is_done(monkeypatch):
    """An exception in there would abort the process: pybind11 lets none out."""
    seen = []

    def load(spec: ModuleSpec) -> ModuleType:
        os.kill(os.getpid(), signal.SIGINT)
        seen.append('on')
        return ModuleType(spec.name)

    def be_loaded() -> None:
        loader = ExtensionFileLoader('library', 'library.so')
        loader.create_module(ModuleSpec('library', loader, origin='library.so'))
        seen.append('loaded')
        threading.Event().wait()

    monkeypatch.setattr('_imp.create_dynamic', load)
    with signals_handled(raise_interrupt), pytest.raises(KeyboardInterrupt):
        be_loaded()
    assert seen == ['on', 'loaded']


def test_given_a_signal_while_an_executor_of_ros_is_destroyed_then_it_comes_when_that_is_done():
    """An exception in there would abort the process: a destructor of C++ lets none out."""
    seen: list[str] = []
    names = {'__name__': 'rclpy.event_handler', 'seen': seen, 'os': os, 'signal': signal}
    exec(textwrap.dedent("""
        class Handler:
            def __enter__(self): pass
            def __exit__(self, *_):
                os.kill(os.getpid(), signal.SIGINT)
                seen.append('let go')
    """), names)

    def destroy() -> None:
        with interrupts(lambda: seen.append('first')):
            os.kill(os.getpid(), signal.SIGINT)
            with names['Handler']():
                pass
            seen.append('destroyed')
            threading.Event().wait()

    with pytest.raises(KeyboardInterrupt):
        destroy()
    assert seen == ['first', 'let go', 'destroyed']


def test_given_another_error_in_a_callback_then_it_is_told_as_ever(monkeypatch):
    told = []
    monkeypatch.setattr(sys, 'unraisablehook', lambda what: told.append(what.exc_type))

    class Broken:
        def __del__(self) -> None:
            raise ValueError

    with lost_interrupts_resent():
        Broken()
    Broken()
    assert told == [ValueError, ValueError]


@SIGNALS
@pytest.mark.parametrize('told', [True, False])
def test_given_signal_after_signal_then_the_second_gives_up_and_the_third_ends_all(
    told, number, code
):
    heard = []

    def thrice() -> None:
        with interrupts(lambda: heard.append('first'), lambda: heard.append('second') or told):
            for _ in range(3):
                os.kill(os.getpid(), number)
                heard.append('and on')

    with pytest.raises(KeyboardInterrupt):
        thrice()
    assert heard == ['first', 'and on', 'second', *['and on'] * told]
    assert interrupted_exit_code(ExitCode.INTERRUPTED) == code
    assert interrupted_exit_code(1) == 1


def test_given_a_second_interrupt_that_is_lost_then_what_has_to_be_gone_is_gone_all_the_same():
    """As one is that comes while a library's own code in C calls back and forgets it."""
    program = '\n'.join((
        'import os, signal, time',
        'from taxinet_ros.processes.interrupts import interrupts',
        'with interrupts(lambda: None, gone_s=0.2):',
        '    for _ in range(2):',
        '        try:',
        '            os.kill(os.getpid(), signal.SIGINT)',
        '        except KeyboardInterrupt:',
        '            pass',
        '    while True:',
        '        time.sleep(1)',
    ))
    lost = subprocess.run([sys.executable, '-P', '-c', program], capture_output=True, check=False)
    assert lost.returncode == 130
    assert lost.stderr.count(b'\n') == 1
