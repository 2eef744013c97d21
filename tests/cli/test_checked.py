"""Every command: no output replaces a record, an input or a special file; numbers are finite."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

from taxinet_ros.analysis import fault_localisation
from taxinet_ros.analysis.campaign import folder as analysis_folder
from taxinet_ros.bag import layout
from taxinet_ros.bag.check import compare
from taxinet_ros.cli.checked import outputs
from taxinet_ros.cli.main import _exit_code, app
from taxinet_ros.cli.study import improve
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.assurance import judge
from taxinet_ros.extras.evidence import evidence
from taxinet_ros.files.outputs import RECORD_NAMES, check_output
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.files.sealed_json import write_sealed
from taxinet_ros.training.data import dataset_folder, image_folder, unfinished
from taxinet_ros.trials import experiment, learned_result
from taxinet_ros.trials.record import table

BAGS = Path(__file__).resolve().parents[2] / 'bags'
BAG = str(BAGS / 'golden' / 'truth-nominal')
OUTPUT_FILES = {
    'aircraft --out', 'assure calibrate --out', 'bag export --out',
    'camera --out', 'camera --yaml',
    'forecast calibrate --out', 'forecast show --plot', 'frame --out', 'gate --junit',
    'monitor --plot', 'network from-nnet --out', 'network see --out', 'odd --plot',
    'odd --out', 'place --out', 'place --yaml', 'train --out',
}
OUTPUT_FOLDERS = {
    'analyze --out', 'assure judge --out', 'bag recover --out', 'bag render --out',
    'bag replay --out', 'bag split --out', 'bisect --out', 'case-study --out', 'compare --out',
    'dataset --out', 'demo --out', 'estimate --out', 'evidence write --out', 'experiment --out',
    'explain --out', 'falsify --out', 'fork --out', 'gate --out', 'improve --out',
    'localize --out', 'run --out', 'score --out', 'shrink --out', 'tune --out', 'up --out',
    'why --out',
}


def commands(command: Any, name: str = '') -> Iterator[tuple[str, Any]]:
    """All commands of the program, by name."""
    for word, one in getattr(command, 'commands', {}).items():
        yield from commands(one, f'{name} {word}'.strip())
    if not hasattr(command, 'commands'):
        yield name, command


COMMANDS = dict(commands(typer.main.get_command(app)))


def end(*words: str) -> int:
    return _exit_code(lambda: app(list(words), standalone_mode=False))


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob('*') if path.is_file()
    }


@pytest.fixture
def campaign(tmp_path, monkeypatch):
    """A recorded campaign, with a bag's description and an index."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(BAGS / 'learn-ce-2', 'c')
    run = tmp_path / 'c' / 'run'
    shutil.copytree(BAG, run)
    with Record(tmp_path / 'c' / 'record-of-may') as record:
        record.put('facts', '', {})
    write_sealed(tmp_path / 'c' / 'forecast', {'a': 1})
    return tmp_path / 'c'


def test_given_all_commands_then_the_options_that_write_a_file_are_known_and_checked():
    paths = {
        f'{name} {max(param.opts, key=len)}' for name, command in COMMANDS.items()
        for param in command.params if max(param.opts, key=len) in (
            '--out', '--plot', '--junit', '--yaml') and 'path' in str(
            param.type_descriptor.annotation).lower()
    }
    checked = {
        f'{name} {max(param.opts, key=len)}' for name, command in COMMANDS.items()
        for param, _ in outputs(command, {param.name: Path('x') for param in command.params})
    }
    assert checked == OUTPUT_FILES
    assert paths == OUTPUT_FILES | OUTPUT_FOLDERS, 'is a new option a file to write, or a folder?'


def test_given_the_names_of_records_then_all_are_known():
    names = {
        RECORD_NAME, unfinished.NAME, table.CSV_NAME, table.PARQUET_NAME,
        layout.METADATA_FILE, compare.STACK_FILE, learned_result.LEARNED_NAME,
        experiment.PAIRS_NAME, experiment.JSON_NAME, analysis_folder.JSON_NAME,
        fault_localisation.CSV_NAME, fault_localisation.PARQUET_NAME,
        fault_localisation.JSON_NAME, judge.TRIALS_NAME, judge.ALARMS_NAME,
        judge.RESULT_NAME,
        improve.ROUNDS_NAME,
        evidence.JSON_NAME, evidence.MANIFEST_NAME, dataset_folder.LABELS, dataset_folder.FACTS,
        image_folder.FOREIGN_LABELS,
    }
    assert names == RECORD_NAMES


GATE = ('gate', 'c', '--min-satisfaction', '0.3', '--junit')
MONITOR = ('monitor', BAG, '--plot')
FORECAST = ('forecast', 'calibrate', 'c', '--out')
EXPORT = ('odd', 's_falsif', '--out')


@pytest.mark.ros
@pytest.mark.parametrize('words', [GATE, MONITOR, FORECAST, EXPORT])
@pytest.mark.parametrize('name', [
    'campaign.db', 'runs.csv', 'runs.parquet', 'learned.json', 'record-of-may',
    'forecast', 'run/metadata.yaml', 'run/truth-nominal.mcap', 'run/new.mcap',
    '../link-to-the-record',
])
def test_given_a_record_in_the_place_of_an_output_then_it_is_refused_and_nothing_changes(
    campaign, words, name, capsys
):
    (campaign.parent / 'link-to-the-record').symlink_to('c/record-of-may')
    mcap = next((campaign / 'run').glob('*.mcap'))
    name = name.replace('truth-nominal.mcap', mcap.name)
    before = digests(campaign.parent)
    assert end(*words, f'c/{name}') == 2
    out, err = capsys.readouterr()
    assert (out, err.count('\n')) == ('', 1)
    assert err.startswith(f'taxinet: error: {words[-1]} c/{name}: ')
    assert 'choose another name' in err
    assert digests(campaign.parent) == before


@pytest.mark.ros
@pytest.mark.parametrize('words', [GATE, FORECAST, EXPORT, MONITOR])
def test_given_a_pipe_in_the_place_of_an_output_then_it_is_refused_and_stays(
    campaign, words, capsys
):
    pipe = campaign.parent / 'pipe'
    os.mkfifo(pipe)
    before = digests(campaign.parent)
    assert end(*words, 'pipe') == 2
    assert 'pipe: is not a regular file' in capsys.readouterr().err
    assert pipe.is_fifo()
    assert digests(campaign.parent) == before


@pytest.mark.ros
def test_given_a_folder_or_an_input_in_the_place_of_an_output_then_it_is_refused(
    campaign, capsys
):
    assert end(*GATE, 'c') == 2
    assert "'c' is a directory" in capsys.readouterr().err
    Path('mine.txt').write_text('phi_eventually')
    os.link('mine.txt', 'same.xml')
    for target in ('mine.txt', 'same.xml'):
        assert end('gate', 'mine.txt', '--baseline', 'c', '--junit', target) == 2
        assert f'--junit {target}: is read by this command' in capsys.readouterr().err
    shutil.copy('c/runs.parquet', 'gate-runs.parquet')
    assert end('gate', 'c', '--baseline', 'gate-runs.parquet', '--junit', 'gate.xml') == 2
    assert 'gate-runs.parquet: is read by this command' in capsys.readouterr().err
    assert Path('mine.txt').read_text() == 'phi_eventually'
    assert not Path('gate.xml').exists()


@pytest.mark.parametrize('words', [
    'FILE.py:steer', 'FILE.py', 'place=FILE.py', 'near=FILE.py', 'FILE.py=40', 'place=FILE.py:A/04',
])
def test_given_a_file_that_a_word_names_then_it_is_an_input(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path('steer').write_text('x')
    code = end('network', 'see', 'n.onnx', '--set', words.replace('FILE.py', 'steer'),
               '--out', 'steer')
    assert code == 2
    assert '--out steer: is read by this command' in capsys.readouterr().err


def test_given_an_earlier_output_of_the_same_kind_then_it_may_be_replaced(tmp_path):
    for name in ('gate.xml', 'plot.png', 'runs.csv', 'metadata.yaml'):
        path = tmp_path / name
        if name not in RECORD_NAMES:
            path.write_text('')
        check_output(f'--out {name}', path, own=['.xml', '.png'])
    (tmp_path / 'weights.safetensors').write_bytes(b'1')
    check_output('--out', tmp_path / 'weights.safetensors', own=['.safetensors'])
    with pytest.raises(UsageError, match=r'exists, and is no \.xml file'):
        check_output('--out', tmp_path / 'weights.safetensors', own=['.xml'])
    check_output('--plot', tmp_path, folder=True)


@pytest.mark.ros
def test_given_weights_whose_other_files_would_be_records_then_they_are_refused(campaign, capsys):
    before = digests(campaign)
    words = ('train', 's_falsif', '--overwrite', '--out', 'c/runs.safetensors')
    assert end(*words) == 2
    assert 'c/runs.csv: is the name of a record in c' in capsys.readouterr().err
    assert digests(campaign) == before


NUMBERS = sorted(
    (name, max(param.opts, key=len)) for name, command in COMMANDS.items()
    for param in command.params if 'float' in str(param.type_descriptor.annotation)
)
ARGUMENTS = {
    'forecast calibrate': ('c', '--out', 'f.json'), 'forecast check': ('f', 'c'),
    'odd': ('s_falsif', 'c'), 'assure calibrate': (
        's_falsif', '--perception', 'original', '--out', 'x.npz'),
    'gate': ('c',), 'fork': (BAG,), 'train': ('s_falsif', '--out', 'n.safetensors'),
    'analyze': ('c',), 'forecast show': ('f', BAG), 'bag replay': (BAG,),
    'bag compare': (BAG, BAG), 'estimate': ('s_falsif',), 'falsify': ('s_falsif',),
    'score': (BAG,), 'spec': ('phi_always',), 'mine': ('always(cte <= A)', 'c'),
    'check-node': ('true',),
}


def test_given_all_commands_then_there_are_numbers_to_be_checked():
    assert len(NUMBERS) >= 30


@pytest.mark.ros
@pytest.mark.parametrize(('command', 'option'), NUMBERS)
def test_given_what_is_no_finite_number_then_it_is_refused_by_name(
    command, option, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    limited = f"taxinet: error: Invalid value for '{option}': Input should be "
    for number in ('nan', 'inf', '-inf', '1e999'):
        assert end(*command.split(), *ARGUMENTS.get(command, ()), f'{option}={number}') == 2
        out, err = capsys.readouterr()
        assert (out, err.count('\n')) == ('', 1)
        told = f'taxinet: error: {option} {float(number)}: expected a finite number'
        assert err.startswith((told, limited)), err
    assert list(tmp_path.iterdir()) == []
