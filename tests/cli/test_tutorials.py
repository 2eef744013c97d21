"""The tutorials do what they say: files are written, commands run, and the output is as shown.

A fenced block whose first line is a file's name is that file. The lines of a block ``sh`` are
commands; one that does not end with 0 says ``# exit code N``, or which two it may be. A block
``text`` after it shows lines of what they print, ``…`` standing for anything.

Nothing is downloaded: the page on a stranger's network runs on one that is made here, and what its
blocks ``output`` show is of the real one, so it is not compared. It and the page on your airport
are followed with fewer runs and pictures.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from nnet_samples import TINY, sample
from taxinet_process import taxinet

DOCS = Path(__file__).resolve().parents[2] / 'docs'
PAGES = [
    DOCS / 'start.md',
    *sorted(page for page in DOCS.glob('tutorials/*.md') if page.stem != 'index'),
]
BLOCK = re.compile(r'^```(\w+)\n(.*?)^```$', re.MULTILINE | re.DOTALL)
FILE = re.compile(r'^# ([\w-]+\.\w+)$')
EXIT_CODE = re.compile(r'\s+# exit code (\d+)(?: or (\d+))?$')
SHELL = re.compile(r'[|&;<>$]|^(?!taxinet )')
STRANGER = 'strangers_network'
SHORTENED = (STRANGER, 'own_runway')
DOWNLOADS = re.compile(r'^curl |\| sha256sum --check$')
FEWER = {
    r'--runs \d+': '--runs 4', r'--images \d+': '--images 8',
    r'--validation \d+': '--validation 4', r'--epochs \d+': '--epochs 1 --batch 8',
    r'(measure\.py \S+) \d+': r'\1 2',
    '--engine loop': '--engine loop --audit 0 --set duration=3',
}
"""What shortens the commands of these pages."""
SET_UP = ('make', '. .venv/bin/activate')
"""What stands in ``Start`` and has been done before any test."""


def commands(block: str) -> list[str]:
    """Command lines of a block, continued ones in one piece, without comments of their own."""
    lines = block.replace('\\\n', ' ').splitlines()
    return [line for line in map(str.strip, lines) if line and not line.startswith('#')]


def done(command: str, folder: Path) -> tuple[int, str]:
    """Exit code and output of a command in a folder; what needs no shell runs in this process."""
    plain = re.sub(r'\s+# .*$', '', command)
    if not SHELL.search(plain):
        end = taxinet(*shlex.split(plain)[1:], cwd=folder)
        return end.returncode, end.stdout + end.stderr
    shell = subprocess.run(
        ['bash', '-c', plain], cwd=folder, text=True, check=False,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        env={**os.environ, 'COLUMNS': '80',
             'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}'},
    )
    return shell.returncode, shell.stdout


def stranger(command: str) -> str:
    """A command of the page on a stranger's network, shortened; '' if it downloads."""
    if DOWNLOADS.search(command):
        return ''
    for long, short in FEWER.items():
        command = re.sub(long, short, command)
    return command


def missing_line(shown: str, printed: str) -> str:
    """The first shown line that is not in the output after the one before; '' if all are."""
    rest = printed.splitlines()
    for line in filter(None, map(str.rstrip, shown.splitlines())):
        pattern = re.compile('.*'.join(map(re.escape, line.split('…'))))
        at = next((n for n, real in enumerate(rest) if pattern.fullmatch(real.rstrip())), None)
        if at is None:
            return line
        rest = rest[at + 1:]
    return ''


@pytest.mark.ros
@pytest.mark.parametrize('page', [
    pytest.param(page, id=page.stem, marks=[] if page.stem == 'start' else pytest.mark.nightly)
    for page in PAGES
])
def test_given_a_tutorial_when_followed_then_every_command_does_as_the_page_says(page, tmp_path):
    printed = ''
    if page.stem == STRANGER:
        (tmp_path / 'TinyTaxiNet.nnet').write_text(sample(TINY, plain=True).text())
    for language, block in BLOCK.findall(page.read_text(encoding='utf-8')):
        first, _, _ = block.partition('\n')
        if named := FILE.match(first):
            (tmp_path / named[1]).write_text(block, encoding='utf-8')
        elif language == 'sh':
            printed = ''
            for command in commands(block):
                if re.sub(r'\s+# .*$', '', command) in SET_UP:
                    continue
                command = stranger(command) if page.stem in SHORTENED else command
                if not command:
                    continue
                said = EXIT_CODE.search(command)
                code, output = done(command, tmp_path)
                allowed = {int(one) for one in said.groups() if one} if said else {0}
                assert code in allowed, f'{command}\n{output}'
                printed += output
        elif language == 'text':
            assert missing_line(block, printed) == '', printed


def test_given_the_pages_then_each_runs_something():
    assert len(PAGES) == 10
    for page in PAGES:
        blocks = BLOCK.findall(page.read_text(encoding='utf-8'))
        assert any(language == 'sh' and commands(block) for language, block in blocks), page


def test_given_output_that_lacks_a_shown_line_then_it_is_named():
    assert missing_line('a … c\nlast\n', 'first\na b c\nlast\n') == ''
    assert missing_line('last\na … c\n', 'first\na b c\nlast\n') == 'a … c'


def test_given_the_page_on_a_strangers_network_then_it_is_converted_measured_run_and_gated():
    page = (DOCS / 'tutorials' / f'{STRANGER}.md').read_text(encoding='utf-8')
    typed = [
        command for language, block in BLOCK.findall(page) if language == 'sh'
        for command in commands(block)
    ]
    assert [bool(stranger(command)) for command in typed[:3]] == [False, False, True]
    for word in ('from-nnet', 'see', 'evaluate', 'falsify', 'explain', 'gate'):
        assert sum(f' {word} ' in command for command in typed) == 1, word
    shortened = ' '.join(map(stranger, typed))
    assert not re.search(r'\b(60|100|200|1000)\b', shortened)
