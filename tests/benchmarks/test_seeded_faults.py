"""Faults are drawn, planted, put back and counted, in a package of one file."""

from __future__ import annotations

import ast
import subprocess
from pathlib import Path

import draw_faults
import pytest
import seeded_faults
from seeded_faults import KINDS, changed, places, planted, read_faults

from taxinet_ros.errors import UsageError

CODE = '''\
import math


def is_low(x, low):
    """Words of 1 < 2."""
    return x < low


def check(x_deg):
    if x_deg:
        raise ValueError(f'{x_deg + 1} is too much')


def turned(x_deg, *, unit: 'int' = 0):
    return math.radians(x_deg)


def rest(values):
    return values[1:]


def missing(low, x):
    return low - x
'''
NEW = {
    'comparison': 'x <= low', 'check': 'pass', 'off by one': 'values[0:]',
    'unit': 'return x_deg', 'sign': 'low + x',
}


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    (tmp_path / 'taxinet_ros/core').mkdir(parents=True)
    (tmp_path / 'taxinet_ros/core/clip.py').write_text(CODE)
    for words in (['init', '-q'], ['add', '.'], [
        '-c', 'user.name=x', '-c', 'user.email=x', 'commit', '-q', '-m', 'x',
    ]):
        subprocess.run(['git', *words], cwd=tmp_path, check=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def drawn(checkout: Path) -> dict[str, seeded_faults.Fault]:
    return {fault.kind: fault for fault in draw_faults.draw(checkout, 0, each=9)}


def test_given_a_function_when_a_fault_is_planted_then_one_line_differs_until_it_is_put_back(
    checkout,
):
    faults = drawn(checkout)
    assert {kind: NEW[kind] in fault.new for kind, fault in faults.items()} == dict.fromkeys(
        KINDS, True)
    fault = faults['comparison']
    assert fault.path == 'core/clip.py'
    file = checkout / 'taxinet_ros/core/clip.py'
    with changed(planted(fault, places([fault])[fault.name])):
        assert file.read_text() == CODE.replace(fault.old, fault.new) != CODE
        ast.parse(file.read_text())
        with pytest.raises(UsageError, match=r'taxinet_ros is not as committed'), changed({}):
            pass
    assert file.read_text() == CODE


def test_given_results_when_counted_then_what_was_missed_is_named(checkout, tmp_path, capsys):
    file, results = tmp_path / 'faults.jsonl', tmp_path / 'results.jsonl'
    faults = list(drawn(checkout).values())
    seeded_faults.write_faults(faults, file)
    caught = [{'name': fault.name, 'suite': 'fast', 'caught': 'test_x'} for fault in faults[1:]]
    results.write_text('\n'.join(map(seeded_faults.json.dumps, caught)))
    assert seeded_faults.main(['table', str(results), '--faults', str(file)]) == 0
    assert [fault.caught for fault in read_faults(file)] == [{}, *[{'fast': 'test_x'}] * 4]
    *_, total, missed = capsys.readouterr().out.splitlines()
    assert total.split() == ['all', '5', '4', '4', '1', '0']
    assert missed.startswith(f'{faults[0].name}: core/clip.py: ')
