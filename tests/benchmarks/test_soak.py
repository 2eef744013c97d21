"""What leaks is found, what does not is flat, nothing is left behind."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import soak
from hypothesis import given
from hypothesis import strategies as st
from soak import FLAT, GROWS, MOST_SAMPLES, UNSETTLED, Series, holdings, trend

from taxinet_ros.errors import UsageError

pytestmark = pytest.mark.nightly

LEAK = """
import mmap, sys, time
kept, files = [], []
sys.stdout.write('here\\n')
sys.stdout.flush()
for line in sys.stdin:
    kept.append(bytearray(4 << 20))
    files.append(open('/dev/null'))
    sys.stdout.write('more\\n')
    sys.stdout.flush()
"""

TAKE = """
import mmap, sys, tempfile, threading
print('here', flush=True)
sys.stdin.readline()
threading.Thread(target=threading.Event().wait, daemon=True).start()
with tempfile.TemporaryFile(dir='/dev/shm') as file:
    file.truncate(1 << 24)
    mapped = mmap.mmap(file.fileno(), 0)
    mapped[:] = bytes(1 << 24)
    print('taken', flush=True)
    sys.stdin.read()
"""


@contextlib.contextmanager
def child_of(script: str) -> Iterator[tuple[int, Callable[[], str]]]:
    """A process that says it is here; its id, and what has it go on and gives its answer."""
    with subprocess.Popen(
        [sys.executable, '-c', script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        told, answers = child.stdin, child.stdout
        assert told is not None
        assert answers is not None
        assert answers.readline() == 'here\n'

        def go_on() -> str:
            told.write('\n')
            told.flush()
            return answers.readline()

        yield child.pid, go_on  # What ends it is the end of its input.


def fitted(x: np.ndarray, y: np.ndarray) -> float:
    return trend(x, y, per_unit=0.0, once=0.0).slope


# Of three samples the warm-up leaves two, and a line takes two.
@given(st.integers(3, 40), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_given_points_on_a_line_with_an_outlier_when_fitted_then_the_slope_is_the_lines(
    count: int, slope: float, start: float
) -> None:
    x = np.arange(count, dtype=float)
    y = slope * x + start
    assert fitted(x, y) == pytest.approx(slope, abs=1e-6)
    if count > 10:
        y[count // 2] += 1e6
        assert fitted(x, y) == pytest.approx(slope, abs=1e-6)


def test_given_a_quantity_when_it_grows_only_while_warming_up_then_it_is_flat() -> None:
    at = list(range(100))
    warming = [min(step, 15) * 1e6 for step in at]
    leaking = [step * 2000.0 for step in at]
    assert trend(at, warming, per_unit=1024, once=0.0).verdict == FLAT
    assert trend(at, leaking, per_unit=1024, once=0.0).verdict == GROWS
    assert trend(at, leaking, per_unit=1024, once=1e6).verdict == FLAT
    assert trend(at[:10], leaking[:10], per_unit=1024, once=0.0).verdict == UNSETTLED


def test_given_very_many_samples_when_kept_then_few_and_evenly() -> None:
    series = Series()
    for number in range(5000):
        series.add(number, [number])
    steps = np.diff(series.at)
    assert MOST_SAMPLES // 2 <= len(series.at) <= MOST_SAMPLES
    assert (steps == steps[0]).all()
    assert series.at[-1] > 4900
    assert [row[0] for row in series.rows] == series.at


def test_given_a_process_when_it_takes_more_then_its_holdings_say_so() -> None:
    with child_of(TAKE) as (pid, go_on):
        before = holdings(pid)
        assert go_on() == 'taken\n'
        after = holdings(pid)
    assert before is not None
    assert after is not None
    assert after.processes == before.processes == 1
    assert after.threads == before.threads + 1
    assert after.files >= before.files + 1
    assert after.segments == before.segments + 1
    assert after.memory > before.memory + (1 << 23)


def test_given_a_child_that_leaks_when_watched_then_it_is_counted_and_found_to_grow(
    monkeypatch
) -> None:
    with child_of(LEAK) as (pid, go_on):
        both = holdings(os.getpid())
        assert both is not None
        assert both.processes >= 2
        moment = [0.0]

        def leak(seconds: float) -> None:
            moment[0] += seconds
            assert go_on() == 'more\n'

        monkeypatch.setattr(soak.time, 'sleep', leak)
        monkeypatch.setattr(soak.time, 'monotonic', lambda: moment[0])
        found = soak.watch(pid, 0.5, lambda done, total: None)
    assert found.samples == 31
    assert found.trends['memory'].verdict == GROWS
    assert found.trends['memory'].slope == pytest.approx(4 << 20, rel=0.2)
    assert found.trends['files'].slope == pytest.approx(1, abs=0.01)
    assert found.trends['threads'].verdict == FLAT
    assert found.verdict == GROWS


def test_given_a_process_that_ends_when_watched_then_what_was_seen_is_told(monkeypatch) -> None:
    with subprocess.Popen([sys.executable, '-c', LEAK], stdin=subprocess.PIPE) as child:
        monkeypatch.setattr(soak.time, 'sleep', lambda seconds: (child.kill(), child.wait()))
        found = soak.watch(child.pid, 1.0, lambda done, total: None)
    assert found.samples == 1
    assert found.verdict == UNSETTLED


@pytest.mark.nightly
@pytest.mark.ros
def test_given_a_few_runs_when_soaked_then_a_report_of_them_and_nothing_left(
    capfd, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    assert soak.main(['--runs', '7', '--duration', '0.5', '--json']) == 0
    report = json.loads(capfd.readouterr().out)
    assert report['amount'] == 7
    assert sum(report['outcomes'].values()) == 7
    assert report['samples'] == 2
    assert set(report['trends']) == {*soak.QUANTITIES, soak.OBJECTS}
    assert report['trends']['memory']['first'] > 50e6
    assert report['trends']['segments']['first'] > 0
    assert report['verdict'] == UNSETTLED
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(('words', 'message'), [
    (['--pid', '1', '--runs', '3'], '--pid watches a running process'),
    (['--minutes', '-1'], 'argument --minutes: -1, needs to be more than 0'),
])
def test_given_bad_options_then_they_are_refused(words: list[str], message: str, capsys) -> None:
    with pytest.raises(SystemExit, match='2'):
        soak.main(words)
    assert message in capsys.readouterr().err


def test_given_no_such_process_then_that_is_said() -> None:
    with pytest.raises(UsageError, match='no such process is running'):
        soak.main(['--pid', str(2**22 + 1), '--minutes', '1'])
