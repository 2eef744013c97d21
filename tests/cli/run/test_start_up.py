"""What a run does without before its first step: nothing here is timed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

_LATER = {
    'pandas', 'pyarrow', 'scipy', 'matplotlib', 'torch', 'onnxruntime', 'asyncio',
    'taxinet_ros.bag.check.compare', 'taxinet_ros.bag.rewrite.frames',
    'taxinet_ros.samplers.registry', 'taxinet_ros.trials.audit', 'taxinet_ros.trials.search',
}
"""Libraries and modules that take long to import, and that a run on the graph does not need."""


def _printed(code: str, *words: str) -> list[str]:
    done = subprocess.run([sys.executable, '-c', code, *words], capture_output=True, text=True,
                          check=False)
    assert not done.stderr
    return done.stdout.splitlines()


@pytest.mark.ros
def test_given_a_run_when_it_is_made_then_neither_it_nor_its_summary_imports_what_takes_long(
    tmp_path: Path,
) -> None:
    code = (
        'import sys; from taxinet_ros.trials.record.book import CampaignBook; '
        'from taxinet_ros.cli.main import app\n'
        f'later, keep = {_LATER!r}, CampaignBook.keep\n'
        'def told(book, row):\n'
        '    print("made with", sorted(later & {*sys.modules}))\n'
        '    keep(book, row)\n'
        'CampaignBook.keep = told\n'
        'print("ended with", app(sys.argv[1:]), "scipy" in sys.modules)'
    )
    lines = _printed(code, 'run', 'nominal', '--perception', 'taxinet', '--images', 'none',
                     '--set', 'duration_s=1', '--out', str(tmp_path / 'out'))
    assert 'made with []' in lines
    assert lines[-1].startswith('ended with ')
    assert lines[-1].endswith(' False')


@pytest.mark.parametrize(('words', 'early'), [
    ('run s_falsif', True), ('falsify s_falsif --runs 3', True), ('estimate s_falsif', True),
    ('run --from bag', False), ('run -h', False), ('falsify --help-all', False),
    ('check my.onnx', False), ('', False),
])
def test_given_a_command_when_started_then_scenic_starts_before_the_words_are_read_if_it_draws(
    words: str, early: bool,
) -> None:
    code = (
        'import sys, types, taxinet_ros.scenes.scenic_server as server\n'
        'server.start_early = lambda: print("Scenic")\n'
        'main = sys.modules["taxinet_ros.cli.main"] = types.ModuleType("main")\n'
        'main.main = lambda: print("words")\n'
        'from taxinet_ros.cli.start import main; main()'
    )
    assert _printed(code, *words.split()) == (['Scenic', 'words'] if early else ['words'])
