"""A perception or controller out of somebody's Python file: what is read, run, and refused."""

from __future__ import annotations

import hashlib
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.controller import SteeringGains, check_controller, make_controller
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.perception.perception import GroundTruth, check_perception, make_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NO_ESTIMATE, TaxiCommand, TrackingError
from taxinet_ros.core.user_code import UserCodeError, command_of, short_word
from taxinet_ros.errors import UsageError

FRAME = np.full((200, 360, 3), 7, np.uint8)
SEEN = TrackingError(cte_m=1.0, he_rad=0.1)


@pytest.fixture
def file(tmp_path):
    """Write a Python file; its word with a function's name."""
    def write(text: str, name: str = 'make') -> str:
        path = tmp_path / 'mine.py'
        path.write_text(text)
        return f'{path}:{name}'

    return write


def steering(word: str):
    return make_controller(word, SteeringGains())


@pytest.mark.parametrize('text', [
    'def make(image): return image.mean(), 0.5',
    'def make(): return lambda image: (image.mean(), 0.5)',
    'class make:\n    def __call__(self, image): return [image.mean(), 0.5]',
    'import numpy as np\ndef make(image): return np.array([image.mean(), 0.5], np.float32)',
    'from taxinet_ros.core.types import TrackingError\n'
    'make = lambda image: TrackingError(cte_m=7.0, he_rad=0.5)',
])
def test_given_a_function_or_what_makes_one_then_it_sees_the_frame(file, text):
    perception = make_perception(file(text))
    assert perception.estimate(FRAME, None) == TrackingError(cte_m=7.0, he_rad=0.5)
    assert (perception.word, perception.needs_image) == ('python', True)


@pytest.mark.parametrize('answer', ['None', '(float("nan"), 0.0)', '(0.0, float("inf"))'])
def test_given_no_number_then_there_is_no_estimate(file, answer):
    perception = make_perception(file(f'def make(image): return {answer}'))
    assert perception.estimate(FRAME, None) == NO_ESTIMATE
    assert perception.estimate(None, SEEN) == NO_ESTIMATE


def test_given_one_that_needs_no_image_then_it_is_told_the_truth(file):
    text = 'def make(truth): return truth.cte_m + 1, truth.he_rad\nmake.needs_image = False'
    perception = make_perception(file(text))
    assert not perception.needs_image
    assert perception.estimate(None, SEEN) == TrackingError(cte_m=2.0, he_rad=0.1)


def test_given_one_that_writes_on_its_frame_then_nobody_else_sees_it(file):
    perception = make_perception(file('def make(image):\n    image[:] = 0\n    return 0.0, 0.0'))
    frame = FRAME.copy()
    frame.flags.writeable = False
    assert perception.estimate(frame, None).usable
    assert frame.min() == 7


@pytest.mark.parametrize('answer', [
    '(estimate.cte_m / 10, 4.0)', '[0.1, 4]', 'TaxiCommand(steering_rad=0.1, speed_mps=4.0)'
])
def test_given_a_controller_then_its_answer_is_the_command(file, answer):
    text = f'from taxinet_ros.core.types import TaxiCommand\ndef make(estimate): return {answer}'
    assert steering(file(text)).command(SEEN) == TaxiCommand(steering_rad=0.1, speed_mps=4.0)


COUNTS = 'class make:\n    n = 0\n    def __call__(self, x):\n        self.n += 1\n' \
    '        return self.n, 1.0\n'


@pytest.mark.parametrize('text', [COUNTS, f'{COUNTS}    def reset(self): self.n = 0\n'])
def test_given_a_memory_then_each_run_begins_without_it(file, text):
    controller = steering(file(text))
    for _ in range(2):
        controller.begin()
        assert [controller.command(SEEN).steering_rad for _ in range(3)] == [1, 2, 3]


@pytest.mark.parametrize('listed', [
    "FILES = ['net.bin']\n", "from typing import Final\nFILES: Final = ['net.bin']\n",
])
def test_given_a_file_then_its_hash_is_its_own_and_that_of_what_it_lists(file, listed, tmp_path):
    text = 'def make(x): return 0.0, 0.0\n'
    alone = check_perception(file(text))
    assert alone == hashlib.sha256(text.encode()).hexdigest()
    (tmp_path / 'net.bin').write_bytes(b'1')
    first = check_controller(file(listed + text))
    (tmp_path / 'net.bin').write_bytes(b'2')
    assert check_controller(file(listed + text)) != first
    (tmp_path / 'net.bin').unlink()
    with pytest.raises(UsageError, match=r'mine\.py: FILES .*net\.bin: No such file'):
        check_controller(file(listed + text))


def test_given_a_file_that_closes_the_output_when_loaded_then_ours_stays(file):
    before = sys.stdout
    make_perception(file('import sys\nsys.stdout = None\ndef make():\n    return print'))
    assert sys.stdout is before


LOUD = """
print('loaded')
class make:
    def __init__(self):
        print('made')
    def reset(self):
        print('reset')
    def __call__(self, seen):
        print('asked')
        return 0.0, 1.0
"""


def test_given_a_file_that_prints_then_what_we_print_stays_alone(file, capfd):
    controller = steering(file(LOUD))
    controller.command(SEEN)
    controller.begin()
    assert tuple(capfd.readouterr()) == ('', 'loaded\nmade\nasked\nreset\n')


def test_given_a_ctrl_c_amid_a_function_then_it_is_one(file):
    text = 'import os\ndef make(seen):\n    os.kill(os.getpid(), 2)\n    while True: pass'
    with pytest.raises(KeyboardInterrupt):
        steering(file(text)).command(SEEN)


@pytest.mark.one_in(2)
@pytest.mark.parametrize('text', [
    'def make(seen): os.fork(); return 0.0, 1.0',
    'def make(seen): return (0.0, 1.0) if os.fork() else 1 / 0',
    'os.fork()\ndef make(seen): return 0.0, 1.0',
])
def test_given_code_that_forks_then_only_one_process_goes_on(file, text):
    script = (
        'import sys\n'
        'from taxinet_ros.core.motion.controller import SteeringGains, make_controller\n'
        'from taxinet_ros.core.types import TrackingError\n'
        'seen = TrackingError(cte_m=1.0, he_rad=0.1)\n'
        'print(make_controller(sys.argv[1], SteeringGains()).command(seen).speed_mps)\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', script, file(f'import os\n{text}')], capture_output=True, text=True,
        check=True,
    )
    assert (done.stdout, done.stderr) == ('1.0\n', '')


@pytest.mark.parametrize('text', [
    "def make(seen):\n    raise ValueError('y' * 10**7)",
    "make = lambda seen: type('y' * 10**7, (Exception,), {})() / 0",
])
def test_given_a_failure_of_many_words_then_it_is_cut(file, tmp_path, text):
    with pytest.raises(UserCodeError) as failed:
        steering(file(text)).command(SEEN)
    assert len(str(failed.value)) < 400 + len(str(tmp_path))


def test_given_a_failure_with_signs_that_a_terminal_obeys_then_they_are_spelled_out(file):
    text = "def make(seen):\n    raise ValueError('a\\x1b[2Jb\\ud800c\\0')"
    with pytest.raises(UserCodeError, match=re.escape(r'ValueError: a\x1b[2Jb\ud800c\x00')):
        steering(file(text)).command(SEEN)


def test_given_a_file_when_checked_then_it_is_not_run(file, tmp_path):
    text = f"import pathlib\npathlib.Path('{tmp_path}/ran').touch()\n"
    word = file(f'{text}def make(x): return 0.0, 0.0')
    check_perception(word)
    check_controller(word)
    assert not (tmp_path / 'ran').exists()
    make_perception(word)
    assert (tmp_path / 'ran').exists()


@pytest.mark.parametrize(('text', 'name', 'complaint'), [
    ('def make(x: return', 'make', r'mine\.py:1: '),
    ('def steer(x): return 0', 'make', r'mine\.py: no make in it, as in .*:NAME; it has: steer$'),
    ('FILES = 3\ndef make(x): pass', 'make', r'mine\.py:1: FILES: expected a list of file names'),
    ('FILES: list\ndef make(x): pass', 'make', r'mine\.py:1: FILES: expected a list of file names'),
    *((f'def make(x): pass\n{text}', 'make', r'mine\.py:\d: FILES: expected one assignment')
      for text in ("if make:\n    FILES = ['a']", "FILES = ['a']\nFILES += ['b']",
                   "FILES = ['a']\nFILES = ['b']", "FILES, other = ['a'], 1",
                   'from mine import FILES', "(FILES := ['a'])")),
    ('async def make(x): pass', 'make', r'mine\.py:1: make is an async function; expected a plain'),
    ('def make(x): return ' + '1+' * 100_000 + '1', 'make', r'mine\.py: an expression .* too long'),
    ('def make(x): return ' + '-' * 100_000 + '1', 'make', r'mine\.py: an expression .* too long'),
])
def test_given_a_file_that_cannot_be_read_when_checked_then_one_line(file, text, name, complaint):
    with pytest.raises(UsageError, match=complaint):
        check_perception(file(text, name))


def test_given_a_file_that_goes_elsewhere_when_loaded_then_we_stay_where_we_are(file, tmp_path):
    before = Path.cwd()
    text = f"import os\nos.chdir('{tmp_path}')\n"
    make_perception(file(f"{text}def make():\n    os.chdir('/')\n    return lambda image: None"))
    assert Path.cwd() == before


def test_given_a_file_without_a_name_then_its_functions_are_listed(file):
    text = 'def look(x):\n    def within(z): pass\n_all = [y for y in ()]\ndef _own(x): pass'
    word = file(text).removesuffix(':make')
    for text in (word, f'{word}:'):
        with pytest.raises(UsageError, match=r'name a function, as in .*:NAME; it has: look$'):
            check_perception(text)


@pytest.mark.parametrize('text', [
    'if True:\n    def make(x): pass', 'try:\n    import make\nexcept ImportError:\n    make = len',
    'def first():\n    global make\n    make = len\nfirst()', 'make, other = len, 1',
])
def test_given_a_name_that_is_bound_in_another_way_then_it_is_there(file, text):
    check_perception(file(text, 'make'))


@pytest.mark.parametrize(('text', 'complaint'), [
    ('import nosuchmodule\ndef make(x): pass', r'mine\.py:1: ModuleNotFoundError: No module'),
    ('def make():\n    return 1 / 0', r'mine\.py:2: ZeroDivisionError: division by zero'),
    ('def make(): return 3', r'mine\.py: make\(\) returned int, which cannot be called'),
    ('make = 3', r'mine\.py: make is int; expected a function or class'),
    ('raise SystemExit(0)\ndef make(x): pass', r'mine\.py:1: SystemExit: 0'),
    ('def make(): raise GeneratorExit', r'mine\.py:1: GeneratorExit$'),
    ('class Odd(BaseException): pass\nraise Odd(1)\ndef make(x): pass', r'mine\.py:2: Odd: 1'),
])
def test_given_a_file_that_fails_when_loaded_then_one_line(file, text, complaint):
    with pytest.raises(UsageError, match=complaint):
        make_perception(file(text))


@pytest.mark.parametrize(('text', 'complaint'), [
    ('def make(x):\n    return x.nothing', r'mine\.py:2: AttributeError: '),
    ('def make(x):\n    raise SystemExit(1)', r'mine\.py:2: SystemExit: 1'),
    ('def make(x): return 3', r'mine\.py: make returned 3; expected a pair \(steering_rad, '),
    ('def make(x):\n    raise GeneratorExit', r'mine\.py:2: GeneratorExit$'),
    ('class Odd(BaseException):\n    def __str__(self): return 1 / 0\ndef make(x): raise Odd',
     r'mine\.py:3: Odd: <Odd whose str\(\) fails: ZeroDivisionError>$'),
    ('class Odd(Exception):\n    def __str__(self): raise SystemExit\ndef make(x): raise Odd',
     r'mine\.py:3: Odd: <Odd whose str\(\) fails: SystemExit>$'),
    ('class Odd:\n    def __float__(self): raise SystemExit\ndef make(x): return Odd(), 1.0',
     r'make returned .*; expected a pair'),
    ('class Odd:\n    def __repr__(self): return 1 / 0\ndef make(x): return Odd()',
     r'mine\.py: make returned <Odd whose repr\(\) fails: ZeroDivisionError>; expected a pair'),
    ('class Odd:\n    def __iter__(self): raise SystemExit(0)\ndef make(x): return Odd()',
     r'mine\.py: make returned <.*Odd object at .*; expected a pair'),
    ('def make(x): return "left", 1', r"make returned \('left', 1\); expected a pair"),
    ('def make(x): return None', r'make returned None; expected a pair'),
])
def test_given_an_answer_that_is_none_then_it_says_where(file, text, complaint):
    with pytest.raises(UserCodeError, match=complaint):
        steering(file(text)).command(SEEN)


@pytest.mark.parametrize('check', [check_perception, check_controller])
def test_given_a_node_elsewhere_then_it_is_for_graphs_only(check):
    for word in ('external', 'cmd:ros2 run my_pkg my_node', 'cmd:python3 my_node.py'):
        assert check(word, graph=True) == ''
        with pytest.raises(UsageError, match='is a node of a graph, but this command'):
            check(word)
    for word in ('cmd:', "cmd:ros2 'run"):
        with pytest.raises(UsageError, match=r'names no program|No closing quotation'):
            check(word, graph=True)


def test_given_another_controller_then_gains_of_the_law_are_refused():
    with pytest.raises(UsageError, match=r'steering\.heading_gain: .*not to controller external'):
        check_controller('external', {'heading_gain': 1.0}, graph=True)
    with pytest.raises(UsageError, match="'pid' is unknown; known: steering, hold_short, or"):
        check_controller('pid')


def test_given_a_command_then_it_is_split_as_a_shell_does():
    words = ['ros2', 'run', 'my pkg', 'node', '--x=1']
    assert command_of("cmd:ros2 run 'my pkg' node --x=1") == words
    assert [short_word(word) for word in ('cmd:a/b.py', 'x/my.py:look', 'x/net.onnx', 'truth')] \
        == ['cmd', 'my', 'net', 'truth']


def test_given_a_controller_of_ones_own_then_the_loop_without_ros_uses_it(file):
    word = file('def make(e): return -0.05 * e.cte_m - 1.2 * e.he_rad, 5.0')
    scene, specs = Scenario(cross_track_m=2.0, duration_s=2.0), [parse_spec('phi_always')]
    steps: list = []
    run_closed_loop(scene, GroundTruth(), specs=specs, controller=steering(word),
                    on_step=steps.append)
    assert math.isclose(steps[0].command.steering_rad, -0.05 * steps[0].estimate.cte_m)
