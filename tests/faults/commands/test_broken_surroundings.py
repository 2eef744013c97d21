"""Closed, full and unread streams, no home, odd paths: one line, and an exit code of no verdict."""

from __future__ import annotations

import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from broken_surroundings import SURROUNDINGS
from typer.main import get_command

from taxinet_ros.cli.main import app

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).parents[3]
BAG = str(ROOT / 'bags' / 'golden' / 'truth-nominal')
SCRIPT = Path(sys.prefix) / 'bin' / 'taxinet'

Answer = tuple[int, str]
Ask = Callable[[list[str], str], Answer]

DOES_NOTHING = {
    'aircraft': ['show', 'nowhere'], 'analyze': ['nowhere'],
    'assure': ['judge', 'nothing', '--perception', 'nothing', '--monitor', 'nothing'],
    'bag': ['info', 'nowhere'], 'bench': ['nothing'],
    'bisect': ['nothing', 'nowhere', '--scene', 'nowhere'],
    'camera': ['frame', 'nothing'], 'case-study': ['--config', 'nowhere'],
    'check': ['nothing'], 'check-node': ['no_such_program'],
    'compare': ['nothing', 'nowhere', 'nowhere'],
    'dataset': ['nothing', '--out', 'data'], 'demo': ['--nothing'], 'doctor': ['nowhere'],
    'estimate': ['nothing'], 'evaluate': ['nothing'],
    'evidence': ['nowhere', '--out', 'evidence'],
    'experiment': ['nothing'], 'explain': ['nowhere'], 'falsify': ['nothing'],
    'flightgear': ['nothing'], 'forecast': ['show', 'nowhere', 'nowhere'],
    'fork': ['nowhere', '--at', '1'],
    'gate': ['nowhere'], 'improve': ['nothing'],
    'live-monitor': ['nothing'], 'localize': ['nowhere'],
    'monitor': ['nowhere'],
    'network': ['see', 'nowhere'], 'node': ['nothing'],
    'odd': ['show', 'nowhere'],
    'place': ['show', 'nowhere'], 'plan': ['nowhere', '--min-satisfaction', '0.9'],
    'plugins': ['nothing'], 'run': ['nothing'], 'setup-messages': ['nothing'],
    'shrink': ['nowhere'],
    'spec': ['nothing('], 'train': ['nothing'], 'tune': ['nothing'],
    'up': ['--perception', 'nothing'],
    'why': ['nowhere'], 'xplane': ['nothing'],
}
BREAK_ALL = ('few files', 'ASCII')
WRONG = re.compile('Traceback|a defect of taxinet|\x1b')
WORKS = (
    ['--version'], ['gate', '--help'], ['bag', 'info', BAG], ['bag', 'doctor', BAG],
    ['monitor', BAG],
)


@pytest.fixture(scope='module')
def ask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ask]:
    """Has a command run in surroundings that are broken."""
    with subprocess.Popen(
        [sys.executable, Path(__file__).with_name('broken_surroundings.py')], text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=tmp_path_factory.mktemp('asked'),
    ) as child:
        def answer(words: list[str], surroundings: str) -> Answer:
            coded = [os.fsencode(word).hex() for word in words]
            child.stdin.write(json.dumps([coded, surroundings]) + '\n')
            child.stdin.flush()
            code, complaints = json.loads(child.stdout.readline())
            return code, complaints

        yield answer
        child.stdin.close()


def test_f6_given_the_commands_then_each_is_tried():
    assert set(get_command(app).commands) == set(DOES_NOTHING)
    assert len(SURROUNDINGS) >= 12


@pytest.mark.parametrize('surroundings', SURROUNDINGS)
def test_f6_given_broken_surroundings_then_no_command_ends_in_a_traceback_or_a_verdict(
    ask: Ask, surroundings: str
):
    for name, words in DOES_NOTHING.items():
        code, complaints = ask([name, *words], surroundings)
        assert code == 2 or (code == 4 and surroundings in BREAK_ALL), (name, code, complaints)
        assert not WRONG.search(complaints), (name, complaints)
        assert len(complaints.splitlines()) <= 1, (name, complaints)


def test_given_too_few_files_for_the_nodes_of_ros_then_that_is_said_and_no_defect(tmp_path):
    asked = subprocess.run(
        [SCRIPT, 'run', 's_falsif', '--perception', 'truth', '--runs', '1', '--out', 'out'],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (13, 13)),
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )
    line = asked.stderr.splitlines()[-1]
    assert asked.returncode == 4, asked.stderr
    assert 'oo many open files' in line
    assert not WRONG.search(line)


@pytest.mark.parametrize(('surroundings', 'code', 'complaint'), [
    ('stdin closed', 0, ''),
    ('stdout closed', 2,
     'taxinet: error: standard output is closed; redirect it, e.g. to /dev/null\n'),
    ('stderr closed', 0, ''),
    ('stdout full', 4, 'taxinet: error: output: [Errno 28] No space left on device\n'),
    ('stderr full', 0, ''),
    ('stdout unread', 141, 'taxinet: error: output: closed by its reader\n'),
    ('no HOME', 0, ''),
    ('HOME nowhere', 0, ''),
    ('no PATH', 0, ''),
])
def test_f6_given_a_command_that_has_something_to_say_then_the_code_tells_whether_it_was_heard(
    ask: Ask, surroundings: str, code: int, complaint: str
):
    for words in WORKS:
        assert ask(words, surroundings) == (code, complaint), words


@pytest.mark.parametrize('words', [('estimate', 'nothing'), ('--version',)])
@pytest.mark.parametrize('variables', [
    {'HOME': '/dev/null'}, {'HOME': 'home'}, {'MPLCONFIGDIR': '/dev/null/here'},
    {'HOME': '/dev/null', 'TMPDIR': '/dev/null'},
])
def test_given_no_place_for_the_settings_of_matplotlib_then_it_prints_and_leaves_nothing(
    tmp_path: Path, variables: dict[str, str], words: tuple[str, ...]
):
    for folder in ('home', 'tmp', 'here'):
        (tmp_path / folder).mkdir()
    (tmp_path / 'home' / '.config').write_text('a file where the folder has to be')
    kept = {name: value for name, value in os.environ.items()
            if name not in ('XDG_CONFIG_HOME', 'XDG_CACHE_HOME', 'MPLCONFIGDIR')}
    given = {name: str(tmp_path / value) for name, value in variables.items()}
    done = subprocess.run(
        [SCRIPT, *words], capture_output=True, text=True, cwd=tmp_path / 'here', check=False,
        env={**kept, 'TMPDIR': str(tmp_path / 'tmp'), **given},
    )
    broken = words == ('estimate', 'nothing')
    assert (done.returncode, done.stderr.count('\n')) == ((2, 1) if broken else (0, 0)), done.stderr
    assert done.stderr.startswith('taxinet: error: ') or not broken
    assert list((tmp_path / 'tmp').iterdir()) == list((tmp_path / 'here').iterdir()) == []


def test_people2_attack_given_a_working_folder_that_is_not_utf8_then_nothing_is_written(
    tmp_path: Path
):
    folder = tmp_path / os.fsdecode(b'a\xff')
    folder.mkdir()
    done = subprocess.run(
        [SCRIPT, 'run', 'nominal', '--set', 'duration=1', '--perception', 'truth', '--images',
         'none'],
        cwd=folder, capture_output=True, text=True, check=False,
    )
    assert done.returncode == 2
    assert done.stderr == (
        f'taxinet: error: {tmp_path}/a\\xff: is not UTF-8; give a name that is\n'
    )
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(('word', 'complaint'), [
    ('x' * 300, 'taxinet: error: '),
    ('y/' * 2500, 'taxinet: error: '),
    (os.fsdecode(b'\xff\xfe'), '\\xff\\xfe: is not UTF-8; give a name that is'),
    ('a\x1b[31mb', ''),
])
@pytest.mark.parametrize('words', [
    ['run', 'nominal', '--out'], ['falsify', 's_falsif', '--out'], ['bag', 'info'], ['gate'],
    ['monitor'], ['analyze'], ['dataset', 's_falsif', '--count', '1', '--out'], ['run'],
    ['evaluate', 's_falsif', '--perception'], ['bag', 'recover', BAG, '--out'],
], ids=' '.join)
def test_f7_given_a_path_that_cannot_be_then_one_line_says_so(
    ask: Ask, words: list[str], word: str, complaint: str
):
    if word.isprintable() or words[0] not in ('run', 'falsify', 'dataset'):
        code, complaints = ask([*words, word], 'no PATH')
        assert code in ((2, 4) if complaint else (0, 2, 4)), complaints
        assert complaint in complaints
        assert not WRONG.search(complaints), complaints
        assert len(complaints.splitlines()) <= 1


@pytest.mark.skipif(shutil.which('env') is None, reason='no env that holds signals back')
@pytest.mark.parametrize(('number', 'moments', 'more'), [
    (signal.SIGINT, (0, 0.01, 0.03, 0.06, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2), ()),
    (signal.SIGINT, sorted(random.Random(21).uniform(0, 3) for _ in range(12)), ('--free',)),
    (signal.SIGTERM, (0.02, 0.2, 0.6), ()), (signal.SIGHUP, (0.02, 0.2, 0.6), ()),
], ids=['INT', 'INT of a free run', 'TERM', 'HUP'])
def test_f7_given_a_signal_at_any_moment_of_the_start_then_it_ends_in_one_line(
    tmp_path: Path, number: int, moments: Sequence[float], more: tuple[str, ...]
):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
    for moment in moments:
        with subprocess.Popen(
            [SCRIPT, 'run', 'nominal', '--set', 'duration=600', '--perception', 'truth',
             '--images', 'none', '--out', tmp_path / str(moment), *more],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        ) as command:
            time.sleep(moment)  # not waited for: the moment is the point
            command.send_signal(number)
            output, complaints = command.communicate()
        if command.returncode == -number:
            continue  # the shell that holds signals back may be met before it does
        assert command.returncode == 128 + number, (moment, complaints)
        told = '1 INTERRUPTED' in output
        assert complaints == ('' if told else 'taxinet: interrupted\n'), (moment, output)
