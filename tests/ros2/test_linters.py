"""Our linters for ``colcon test``, where they are installed.

mypy is left to ``make lint``: it judges by the types of numpy 2, and a stock Jazzy has 1.26.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly
ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(('module', 'words'), [
    ('ruff', ['ruff', 'check', '--no-cache', '.']),
    ('importlinter', ['lint-imports', '--no-cache']),
])
def test_given_the_sources_then_the_linter_has_nothing_to_say(module, words):
    if importlib.util.find_spec(module) is None:
        pytest.skip(f'{module} is not installed: pip install -c constraints.txt .[dev]')
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])
    done = subprocess.run([shutil.which(words[0], path=path), *words[1:]], cwd=ROOT,
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
