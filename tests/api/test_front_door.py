"""``import taxinet_ros``: quick, without ROS, and as its page says."""

from __future__ import annotations

import ast
import inspect
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import taxinet_ros as tx

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / 'docs' / 'python.md'
GOLDEN = ROOT / 'bags' / 'golden'
EXAMPLES = {
    'one_run.py': 'PASS',
    'perception_function.py': 'bright_paint: FAIL',
    'controller_function.py': 'own: PASS',
    'random_search.py': 'worst: Scenario(',
    'wind_table.py': '| dry | 100 % ',
    'camera_table.py': '| wing | caravan | 100 % ',
    'place_table.py': '| kmwh_04 | 100 % ',
    'fault_table.py': '| dirt on the lens 20 % | 100% ',
    'fault_sheet.py': 'sheet: ',
    'traffic_table.py': '| a van that crosses | 100 % ',
    'read_bag.py': 'gentle: SATISFIED',
    'read_campaign.py': 'run-1: FAIL again, <Run FAIL, 21 steps, phi_always: rho -5.5',
}
IN_SHORT = ('one_run.py', 'read_bag.py', 'read_campaign.py')
WITHOUT_ROS = """
import sys
for name in ('rclpy', 'taxinet_msgs', 'sensor_msgs', 'std_msgs', 'builtin_interfaces'):
    sys.modules[name] = None  # importing it raises ImportError
"""


def python(code: str, cwd: Path = ROOT) -> str:
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, cwd=cwd, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_given_the_import_alone_then_nothing_else_is_loaded():
    before = python('import sys, importlib, typing; print(*sorted(sys.modules))').split()
    after = python(
        'import sys, importlib, typing, taxinet_ros; print(*sorted(sys.modules))'
    ).split()
    # The restriction of libraries to the class of processor has to be ahead of their import.
    assert set(after) - set(before) == {'taxinet_ros', 'taxinet_ros.instructions'}


@pytest.mark.nightly
def test_given_ros_cannot_be_imported_then_every_name_is_there_and_a_run_is_made():
    out = python(WITHOUT_ROS + """
import taxinet_ros as tx
for name in tx.__all__:
    getattr(tx, name)
run = tx.run(tx.Scenario(duration_s=1.0), perception='taxinet', specs='phi_always')
print(run.outcome, run.trace.shape[0], run.frame(10).shape)
""")
    assert out.split('\n')[0] == 'PASS 11 (200, 360, 3)'


def test_given_the_page_then_its_table_has_the_names_of_the_package():
    cells = re.findall(r'^\| (`tx\..*?) \|', PAGE.read_text(), re.MULTILINE)
    documented = re.findall(r'tx\.(\w+)', ' '.join(cells))
    assert sorted(documented) == sorted(tx.__all__)


def test_given_each_name_then_it_says_what_it_is_and_is_annotated():
    assert sorted(tx.__all__) == tx.__all__
    assert [name for name in dir(tx) if not name.startswith('__')] == tx.__all__
    for name in tx.__all__:
        thing = getattr(tx, name)
        assert inspect.getdoc(thing), name
        if inspect.isfunction(thing):
            assert 'Raises:' in inspect.getdoc(thing), name
            assert 'return' in inspect.get_annotations(thing), name


def test_given_a_name_that_is_not_there_then_it_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'taxinet_ros' has no attribute 'fly'"):
        _ = tx.fly


def test_given_the_page_then_every_example_on_it_runs(campaign_folder, monkeypatch, tmp_path):
    blocks = re.findall(r'^```python\n(.*?)^```', PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert len(blocks) == 8
    (tmp_path / 'bags').mkdir()
    campaign_folder.rename(tmp_path / 'bags' / 'light')
    (tmp_path / 'bags' / 'golden').symlink_to(GOLDEN)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), 'exec'), names)
    assert names['run'].outcome == 'PASS'
    assert names['there'].shape == (200, 360, 3)


@pytest.mark.nightly
def test_given_the_notebook_then_its_cells_run_one_after_the_other(monkeypatch, tmp_path):
    """As plain Python: no notebook server is needed, and the last line of each is evaluated."""
    cells = json.loads((ROOT / 'examples' / 'first_look.ipynb').read_text())['cells']
    assert all(cell['outputs'] == [] for cell in cells if cell['cell_type'] == 'code')
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for cell in cells:
        if cell['cell_type'] == 'code':
            lines = ast.parse(cell['source']).body
            exec(compile(ast.Module(lines[:-1], []), 'cell', 'exec'), names)
            last = ast.Interactive(lines[-1:])
            exec(compile(last, 'cell', 'single'), names)
    assert names['run'].outcome == 'FAIL'
    assert names['campaign'].report().is_file()
    assert names['worst'].headline.lower < 0


@pytest.mark.parametrize('name', [
    pytest.param(name, marks=[] if name in IN_SHORT else pytest.mark.nightly) for name in EXAMPLES
])
def test_given_an_example_then_it_is_short_and_runs_without_ros(name, campaign_folder, tmp_path):
    file = ROOT / 'examples' / name
    assert len(file.read_text().splitlines()) <= 30
    arguments = {
        'read_bag.py': GOLDEN / 'taxinet-midday', 'fault_sheet.py': tmp_path / 'sheet.jpg',
    }
    argument = arguments.get(name, campaign_folder)
    out = python(WITHOUT_ROS + f"""
import runpy
sys.argv = [{str(file)!r}, {str(argument)!r}]
runpy.run_path(sys.argv[0], run_name='__main__')
""")
    assert EXAMPLES[name] in out
