"""``taxinet improve`` on the real graph, with a real training, as small as they get."""

import json

import pytest
from taxinet_process import taxinet_apart

from taxinet_ros.core.perception.weights import SHIPPED, load_model
from taxinet_ros.files.record import RECORD_NAME, read_record
from taxinet_ros.trials.record.table import read_table

WET = """
model runway_world
param time_of_day = 8
param clouds = 'stratus'
param rain = 90
param duration = 11
ego = new Plane at (-5, Range(600, 650)), facing Range(18, 20) deg
"""
WORDS = (
    'improve', 'wet.scenic', '--start', 'original', '--rounds', '1', '--budget', '6', '--images',
    '8', '--validation', '4', '--counterexamples', '8', '--epochs', '1', '--sampler', 'random',
    '--workers', '1',
)

pytestmark = [pytest.mark.nightly, pytest.mark.ros]


def test_given_a_network_that_fails_then_one_command_learns_from_it_and_judges(tmp_path):
    (tmp_path / 'wet.scenic').write_text(WET)
    ended = taxinet_apart(*WORDS, '--out', 'loop', cwd=tmp_path)
    assert (ended.returncode, ended.stderr) == (0, '')
    out = tmp_path / 'loop'
    (line,) = json.loads((out / 'rounds.json').read_text())
    assert read_record(out / RECORD_NAME)['round'] == {'1': line}
    tables = [
        read_table(out / f'round-1-{name}') for name in ('falsify', 'incumbent', 'candidate')
    ]
    assert [len(table) for table in tables] == [2, 2, 2]
    assert (line['searched'], line['failed']) == (2, int((tables[0].outcome == 'FAIL').sum()))
    assert line['failed'] == 2
    made = line['decision']
    assert made['pairs'] == 2
    assert made['failed_now'] == int((tables[2].outcome == 'FAIL').sum())
    card = load_model(out / 'round-1-train' / 'candidate.safetensors').card
    original = load_model(SHIPPED['original']).fingerprint
    assert card.start_sha256 == line['incumbent'] == original
    assert [data.kind for data in card.training_data] == ['program', 'runs']
    best = load_model(out / 'best.safetensors').fingerprint
    assert best == (card.weights_sha256 if made['accepted'] else original)
    assert ('ACCEPTED' if made['accepted'] else 'REJECTED') in ended.stdout


@pytest.mark.parametrize(('words', 'reason'), [
    (('nowhere',), 'known: '),
    (('--start', 'none.safetensors'), 'weights: none.safetensors: no such file'),
    (('--budget', '12', '--rounds', '9'), 'improve: budget 12 leaves 0 runs'),
    (('--add', 'crossing'), "add 'crossing': not PROGRAM=COUNT"),
    (('--resume',), '--resume: name the folder to continue with --out'),
    (('--resume', '--out', 'none'), 'resume: none: no study of taxinet improve'),
    (('--out', 'here'), 'out here: already exists'),
])
def test_given_bad_input_then_one_line_and_exit_code_2(words, reason, taxinet, tmp_path):
    (tmp_path / 'here').mkdir()
    (tmp_path / 'here' / 'mine.txt').write_text('')
    code, out, err = taxinet('improve', *words)
    assert (code, out) == (2, '')
    assert reason in err
    assert err.count('\n') == 1
    assert [path.name for path in tmp_path.iterdir()] == ['here']
