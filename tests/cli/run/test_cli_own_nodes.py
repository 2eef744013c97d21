"""Perceptions and controllers of one's own, in every layout, and what bags of them are good for."""

from __future__ import annotations

import contextlib
import json
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from taxinet_process import begun, taxinet, taxinet_apart
from waiting import wait_for

from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.record.table import read_table

EXAMPLES = Path(__file__).parents[3] / 'examples'
PERCEPTION, CONTROLLER = (
    shlex.join([sys.executable, str(EXAMPLES / name)])
    for name in ('my_perception_package/my_perception_package/perception.py', 'own_controller.py')
)
NODES = ('--perception', f'cmd:{PERCEPTION}', '--controller', f'cmd:{CONTROLLER}')
SHORT = ('--images', 'none', '--set', 'duration=1')

pytestmark = [pytest.mark.nightly, pytest.mark.ros]

MINE = """
class Guess:
    def __init__(self):
        self.frames = 0

    def __call__(self, image):
        self.frames += 1
        return self.frames / 100, 0.0


def steer(estimate):
    return -0.05 * estimate.cte_m - 1.2 * estimate.he_rad, 4.0


def hangs(estimate):
    open('hangs', 'w').close()
    while True:
        pass


def fails(estimate):
    return 1 / 0


def thread():
    import threading
    import time
    threading.Thread(target=time.sleep, args=(3600,)).start()
    return steer


def handles(estimate):
    import signal

    def ends(number, frame):
        raise SystemExit(0)

    signal.signal(signal.SIGALRM, ends)
    signal.setitimer(signal.ITIMER_REAL, 0.001)
    return steer(estimate)


def long(estimate):
    raise ValueError('y' * 10**7)


def loud(image):
    print('asked')
    return 0.0, 0.0
"""


@pytest.fixture(scope='module')
def folder(tmp_path_factory) -> Path:
    """Campaigns of two runs: ``p`` with functions of a file, ``n`` with nodes, ``t`` the truth."""
    folder = tmp_path_factory.mktemp('own')
    (folder / 'mine.py').write_text(MINE)
    for out, words in {
        'p': ('--perception', 'mine.py:Guess', '--controller', 'mine.py:steer'),
        'n': NODES,
        't': ('--perception', 'truth', '--controller', 'mine.py:steer'),
    }.items():
        done = taxinet('run', 'nominal', *words, *SHORT, '--runs', '2', '--out', out, cwd=folder)
        assert done.returncode in (0, 1), done.stdout + done.stderr
    return folder


@pytest.fixture
def controller(tmp_path) -> Path:
    """A controller that no other process on this machine runs."""
    return Path(shutil.copy(EXAMPLES / 'own_controller.py', tmp_path))


def running(program: Path) -> list[int]:
    """Processes of a program."""
    return [one.pid for one in psutil.process_iter() if str(program) in words_of(one)]


def words_of(process: psutil.Process) -> list[str]:
    with contextlib.suppress(psutil.Error):
        return process.cmdline()
    return []


def rows(folder: Path):
    return read_table(folder).set_index('run_id')[['outcome', 'rho']]


def test_given_functions_of_a_file_then_bags_and_facts_say_which(folder):
    facts = read_facts(folder / 'p')
    run = open_recording(folder / 'p' / 'nominal-s0-00001').run
    assert (run.perception, run.controller, run.gains) == ('python', 'python', {})
    assert run.fingerprint == run.controller_fingerprint == facts['controller_sha256']
    assert (facts['perception'], facts['controller']) == ('mine.py:Guess', 'mine.py:steer')


def test_given_functions_of_a_file_then_every_layout_has_the_same_rows(folder):
    words = ('nominal', '--perception', 'mine.py:Guess', '--controller', 'mine.py:steer', *SHORT)
    done = taxinet('run', *words, '--runs', '2', '--processes', '--out', 'pp', cwd=folder)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    assert rows(folder / 'pp').equals(rows(folder / 'p'))


@pytest.mark.parametrize('campaign', ['p', 'n', 't'])
def test_given_a_controller_of_ones_own_then_the_campaign_is_sound(folder, campaign):
    done = taxinet('doctor', campaign, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    spec = 'soon=always(cte < 100)'
    done = taxinet('monitor', campaign, '--spec', spec, '--add', cwd=folder)
    assert (done.returncode, done.stderr) == (0, ''), done.stdout
    assert f'{campaign}: rho_soon added for 2 runs' in done.stdout


def test_given_nodes_then_they_are_named_as_they_name_themselves(folder):
    run = open_recording(folder / 'n' / 'nominal-s0-00000').run
    assert (run.perception, run.controller) == ('bright paint', 'proportional')
    assert set(read_table(folder / 'n')['perception']) == {'bright paint'}


@pytest.mark.parametrize(('campaign', 'words'), [
    ('p', ('--perception', 'mine.py:Guess', '--controller', 'mine.py:steer')),
    ('n', (*NODES, '--processes')),
    ('n', NODES),
])
def test_given_bags_of_ones_own_when_run_again_then_they_are_the_same(folder, campaign, words):
    bag = f'{campaign}/nominal-s0-00000'
    out = f'again-{campaign}{len(words)}'
    done = taxinet('run', '--from', bag, *words, '--out', out, cwd=folder)
    assert (done.returncode, done.stdout.splitlines()[-1][:9]) == (0, 'the same:'), done.stderr


@pytest.mark.parametrize(('words', 'says'), [
    (('run', '--from', 'n/nominal-s0-00000'),
     "own perception is 'bright paint', not a shipped one"),
    (('run', '--from', 'n/nominal-s0-00000', '--perception', 'truth'),
     "own controller is 'proportional'; name one as controller"),
    (('bag', 'replay', 'p/nominal-s0-00000', '--into', 'steering_controller'),
     "own controller is 'python' of sha256"),
    (('explain', 'n/nominal-s0-00000'), "own perception is 'bright paint', not a shipped one"),
    (('evaluate', 'nominal', '--perception', 'external'), 'is a node of a graph'),
    (('run', 'nominal', '--perception', 'cmd:no_such_program'),
     'perception: no_such_program: no such program'),
    (('run', 'nominal', '--controller', 'mine.py:steer', '--set', 'steering.heading_gain=1'),
     'steering.heading_gain: gains apply only'),
])
def test_given_what_cannot_be_done_with_them_then_one_line_says_what_is_needed(
    folder, words, says,
):
    done = taxinet(*words, cwd=folder)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert says in done.stderr


def test_given_a_bag_of_a_file_when_replayed_into_it_then_every_bit_is_the_same(folder):
    words = ('bag', 'replay', 'p/nominal-s0-00000', '--into', 'steering_controller')
    done = taxinet(*words, '--controller', 'mine.py:steer', cwd=folder)
    assert done.returncode == 0, done.stderr
    assert 'bit-identical' in done.stdout


def test_given_failures_of_a_file_when_localized_then_it_steers_the_trials(folder):
    spec = 'never=always(cte_estimate < -100)'  # what no run satisfies, whoever steers
    words = ('--perception', 'mine.py:Guess', '--controller', 'mine.py:steer', '--spec', spec)
    assert taxinet('run', 'nominal', *words, *SHORT, '--out', 'f', cwd=folder).returncode == 1
    done = taxinet('localize', 'f', '--out', 'l', '--workers', '1', cwd=folder)
    assert done.returncode == 0, done.stderr
    assert 'were not reproduced' not in done.stdout
    (folder / 'mine.py').write_text(MINE + '\n')
    done = taxinet('localize', 'f', '--out', 'l2', cwd=folder)
    (folder / 'mine.py').write_text(MINE)
    assert (done.returncode, 'mine.py' in done.stderr) == (2, True)


def test_given_a_function_that_fails_then_its_line_is_named_and_the_bench_broke(folder):
    words = ('nominal', '--perception', 'truth', '--controller', 'mine.py:fails', *SHORT)
    done = taxinet('run', *words, '--out', 'b', cwd=folder)
    assert done.returncode == 4
    assert 'node_error steering_controller: UserCodeError: mine.py:22: ZeroDivisionError' \
        in done.stdout


def test_given_a_function_that_never_returns_then_two_interrupts_end_it(folder):
    words = ('run', 'nominal', '--perception', 'truth', '--controller', 'mine.py:hangs', *SHORT)
    with begun(*words, '--out', 'h', cwd=folder, stderr=subprocess.PIPE) as process:
        wait_for((folder / 'hangs').exists)
        for _ in range(2):
            process.send_signal(signal.SIGINT)
            time.sleep(0.5)  # two that are one to the kernel are one
        _, complaint = process.communicate()
    assert process.returncode == 130
    assert complaint.splitlines()[-1] == 'taxinet: interrupted'


def test_given_a_function_whose_thread_goes_on_then_the_command_ends(folder):
    executable = str(Path(sys.executable).with_name('taxinet'))
    words = ('run', 'nominal', '--perception', 'truth', '--controller', 'mine.py:thread', *SHORT)
    done = subprocess.run(
        [executable, *words, '--out', 'th'], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode in (0, 1), done.stderr


@pytest.mark.parametrize('layout', [(), ('--processes',)])
def test_given_a_function_that_would_flood_the_command_then_its_run_has_a_row(tmp_path, layout):
    (tmp_path / 'mine.py').write_text(MINE)
    words = ('nominal', '--perception', 'truth', '--controller', 'mine.py:long', *SHORT)
    done = taxinet_apart('run', *words, *layout, '--out', 'c', cwd=tmp_path)
    assert (done.returncode, len(done.stdout + done.stderr) < 5000) == (4, True)
    says = 'UserCodeError: mine.py:44: ValueError: yyy'
    assert f'INFRA_ERROR node_error steering_controller: {says}' in done.stdout
    assert list(read_table(tmp_path / 'c')['outcome']) == ['INFRA_ERROR']


def test_given_a_handler_that_exits_amid_a_run_then_the_exit_code_is_no_verdict(folder):
    words = ('nominal', '--perception', 'truth', '--controller', 'mine.py:handles')
    done = taxinet_apart('run', *words, '--images', 'none', '--out', 'ha', cwd=folder)
    assert done.returncode == 4, done.stdout + done.stderr


def test_given_a_function_that_prints_then_json_stays_json(folder):
    words = ('nominal', '--perception', 'mine.py:loud', '--images', '2', '--json')
    done = taxinet_apart('evaluate', *words, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    assert 'asked' in done.stderr


def test_given_a_search_with_nodes_then_each_worker_has_its_own_and_none_is_left(
    folder, controller
):
    command = shlex.join([sys.executable, str(controller)])
    words = ('s_falsif', '--controller', f'cmd:{command}', '--perception', 'mine.py:Guess', *SHORT)
    done = taxinet(
        'falsify', *words, '--runs', '3', '--sampler', 'random', '--workers', '2', '--out', 'w',
        cwd=folder,
    )
    assert done.returncode in (0, 1), done.stdout + done.stderr
    assert len(rows(folder / 'w')) == 3
    assert not running(controller)


def test_given_a_killed_campaign_then_its_nodes_end_too(folder, controller):
    program = shlex.join([sys.executable, str(controller)])
    command = shlex.join(['sh', '-c', f'{program} "$@"; true', 'sh'])  # has a child, as ros2 run
    words = ('run', 'nominal', '--perception', 'truth', '--controller', f'cmd:{command}')
    with begun(*words, '--out', 'k', cwd=folder) as process:
        while not running(controller):
            assert process.poll() is None
            time.sleep(0.05)
        process.kill()
    while running(controller):
        time.sleep(0.05)


@pytest.mark.parametrize(('program', 'says'), [
    ("raise SystemExit('out of paint')", 'exit code 1: out of paint'),
    ('import os; os.kill(os.getpid(), 9)', 'killed by SIGKILL'),
])
def test_given_a_node_that_dies_then_it_is_named_with_its_last_words(folder, program, says):
    command, out = shlex.join([sys.executable, '-c', program]), f'd{len(says)}'
    words = ('--perception', f'cmd:{command}', *SHORT)
    done = taxinet('run', 'nominal', *words, '--out', out, cwd=folder)
    assert done.returncode == 4
    assert f'died perception: {says}' in done.stdout


def test_a_node_with_an_int_in_a_float_field_ends_the_run_and_names_field_and_type(folder):
    program = (EXAMPLES / 'own_controller.py').read_text()
    assert program.count(', angle)), 5.0') == 1
    (folder / 'ints.py').write_text(program.replace(', angle)), 5.0', ', angle)), 5'))
    command = shlex.join([sys.executable, 'ints.py'])
    words = ('--perception', 'truth', '--controller', f'cmd:{command}', *SHORT)
    done = taxinet('run', 'nominal', *words, '--out', 'ints', cwd=folder)
    assert done.returncode == 4
    assert 'INFRA_ERROR died steering_controller: exit code 1: AssertionError: ' \
        "The 'speed' field must be of type 'float'" in done.stdout


def test_given_a_command_that_starts_what_has_a_session_of_its_own_then_that_ends_too(folder):
    other = f'setsid sh -c "while :; do sleep 1; done # {folder}" &'
    command = shlex.join(['sh', '-c', f'{other} exec {CONTROLLER} "$@"', 'sh'])
    words = ('--perception', 'truth', '--controller', f'cmd:{command}', *SHORT)
    assert taxinet('run', 'nominal', *words, '--out', 'o', cwd=folder).returncode in (0, 1)
    left = [one for one in psutil.process_iter() if str(folder) in ' '.join(words_of(one))]
    assert not left


CHANGES = """
import os
import re
from pathlib import Path


def steer(estimate):
    with Path(__file__).open('a') as file:
        file.write('#')
    {ending}
"""


@pytest.mark.parametrize(('words', 'ending'), [
    (('run',), '1 / 0'), (('run', '--processes'), '1 / 0'),
    (('falsify', '--sampler', 'random', '--workers', '1'), '1 / 0'),
])
def test_given_a_controller_that_changes_amid_a_campaign_then_it_is_not_mixed_in(
    tmp_path, words, ending
):
    (tmp_path / 'turns.py').write_text(CHANGES.format(ending=ending))
    name, *more = words
    done = taxinet_apart(
        name, 's_falsif', *more, '--perception', 'truth', '--controller', 'turns.py:steer',
        *SHORT, '--runs', '3', '--out', 'c', cwd=tmp_path,
    )
    last = done.stderr.splitlines()[-1]
    assert (done.returncode, 'controller turns.py:steer has changed since' in last) == (2, True), \
        done.stdout + done.stderr


def test_r11_given_an_experiment_whose_arms_differ_in_the_controller_then_its_tables_say_so(folder):
    (folder / 'e.yaml').write_text(
        'program: nominal\nruns: 2\nperception: truth\nset: {duration: 1}\n'
        'arms: {law: {}, mine: {controller: "mine.py:steer"}}\n'
    )
    done = taxinet('experiment', 'e.yaml', '--out', 'e', cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    facts = [read_facts(folder / 'e' / arm) for arm in ('law', 'mine')]
    assert [one['controller'] for one in facts] == ['steering', 'mine.py:steer']
    assert 'controller mine.py:steer' in (folder / 'e' / 'experiment.html').read_text()
    assert not rows(folder / 'e' / 'law')['rho'].equals(rows(folder / 'e' / 'mine')['rho'])


def test_given_a_function_that_fails_when_checked_then_its_line_is_named(
    folder
):
    done = taxinet(
        'check-node', 'mine.py:fails', '--role', 'controller', '--json', cwd=folder,
    )
    found = json.loads(done.stdout)
    came = {one['clause']: one['came'] for one in found['clauses'] if one['status'] == 'FAIL'}
    assert (done.returncode, found['kept'], list(came)) == (2, False, ['answers']), done.stderr
    assert 'mine.py:22: ZeroDivisionError' in came['answers']
    assert done.stderr == 'taxinet: error: check-node: the controller breaks: answers\n'


@pytest.mark.parametrize(('words', 'says'), [
    (('no_such_program',), 'check-node: no_such_program: no such program'),
    (('true', '--role', 'pilot'), '--role pilot: unknown; known: perception, controller'),
    (('mine.py:steer',), '--role: mine.py:steer is a function; give perception or controller'),
    (('mine.py:nothing', '--role', 'controller'), 'no nothing in it'),
    (("ros2 'run",), 'No closing quotation'),
])
def test_given_what_cannot_be_checked_then_one_line_says_why(folder, words, says):
    done = taxinet('check-node', *words, cwd=folder)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert says in done.stderr
