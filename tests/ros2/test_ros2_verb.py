"""``ros2 taxinet``: every word reaches the executable, and ``ros2 --help`` stays what it was.

ros2cli does not come as a wheel: where it is not installed, a parser that is built as its own is
stands in for it.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import ros2taxinet

ROOT = Path(__file__).parents[2]
WORDS = [
    ['--help'],
    [],
    ['run', 's_falsif', '--runs', '2', '--help'],
    ['--version'],
    ['run', '--', '-x', ''],
]
with_ros2cli = pytest.mark.skipif(
    importlib.util.find_spec('ros2cli') is None,
    reason='ros2cli is not installed, and does not come as a wheel',
)


@pytest.fixture
def prefix(tmp_path, monkeypatch) -> Path:
    """A prefix in which the executable prints its words, one a line."""
    program = tmp_path / 'lib' / 'taxinet_ros' / 'taxinet'
    program.parent.mkdir(parents=True)
    program.write_text('#!/bin/sh\nfor word; do echo "[$word]"; done; exit 3\n')
    program.chmod(0o755)
    marker = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'packages' / 'taxinet_ros'
    marker.parent.mkdir(parents=True)
    marker.touch()
    others = os.environ.get('AMENT_PREFIX_PATH', '')
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}{os.pathsep}{others}')
    return tmp_path


def parsed(words: list[str]) -> argparse.Namespace:
    """What ros2cli's ``main`` makes of ``ros2 taxinet WORDS``: its parsers, twice."""
    root = argparse.ArgumentParser('ros2')
    commands = root.add_subparsers(dest=' _command')
    command = commands.add_parser('taxinet')
    ros2taxinet.TaxinetCommand().add_arguments(command, 'ros2 taxinet')
    return root.parse_args(['taxinet', *words])


@pytest.mark.parametrize('words', WORDS, ids=' '.join)
def test_given_words_when_parsed_as_ros2cli_does_then_all_of_them_are_the_command_s(words):
    assert parsed(words).words == words


def test_given_words_when_the_command_is_called_then_it_becomes_the_executable(prefix):
    code = ('import argparse, ros2taxinet; ros2taxinet.TaxinetCommand().main(parser=None, '
            'args=argparse.Namespace(words=["run", "--out", "a b"]))')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, cwd=ROOT,
                          check=False)
    assert (done.returncode, done.stderr) == (3, '')
    assert done.stdout.split('\n') == ['[run]', '[--out]', '[a b]', '']


def test_given_no_such_package_then_one_line_says_so(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    asked = argparse.Namespace(words=['run'])
    assert ros2taxinet.TaxinetCommand().main(parser=argparse.ArgumentParser(), args=asked) == 2
    told = capsys.readouterr().err
    assert re.fullmatch(r'error: cannot start taxinet: .*taxinet_ros.*\n', told)


def test_given_the_module_then_ros2_help_loads_neither_the_package_nor_numpy():
    code = ('import sys, ros2taxinet; '
            'print(sorted({"taxinet_ros", "numpy", "rclpy"} & {*sys.modules}))')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, cwd=ROOT,
                          check=True)
    assert done.stdout == '[]\n'


@with_ros2cli
def test_given_genuine_ros2cli_then_its_help_lists_the_command_and_it_gets_its_words(prefix):
    def ros2(*words: str) -> subprocess.CompletedProcess[str]:
        code = 'import sys; from ros2cli.cli import main; sys.exit(main())'
        return subprocess.run([sys.executable, '-c', code, *words], capture_output=True, text=True,
                              check=False)

    told = ros2('--help')
    assert re.search(r'\n  taxinet +Test vision-based aircraft taxiing', told.stdout), told.stderr
    for words in WORDS:
        done = ros2('taxinet', *words)
        assert (done.returncode, done.stdout.split('\n')[:-1]) == (3, [f'[{w}]' for w in words])
