"""``taxinet gate --baseline`` and ``check``: the same scenes, what got worse, what is refused."""

from __future__ import annotations

import json
import os
from pathlib import Path
from xml.etree import ElementTree

import pandas as pd
import pytest
from campaign_records import write_campaign

from taxinet_ros.analysis import network_check
from taxinet_ros.analysis.network_check import NetworkCheck, fixed_scenes, scenes_digest
from taxinet_ros.analysis.runs.campaign import read_runs
from taxinet_ros.core.mtl import RobustnessInterval, exact_intervals
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.errors import ExitCode
from taxinet_ros.files.record import RECORD_NAME, read_record
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.scenes.source import program_text
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.past_runs.trials import Trial
from taxinet_ros.trials.record.book import finished_row, run_request
from taxinet_ros.trials.record.facts import campaign_facts

BAGS = Path(__file__).resolve().parents[3] / 'bags'


def campaign(
    folder: Path, violated: set[int], *, runs: int = 80, seed: int = 7, settings=(),
    specs=('phi_always',),
):
    """A recorded campaign of simple draws, some of which are violated."""
    options = make_options(
        program='nominal', runs=runs, seed=seed, perception='truth', settings=settings,
        specs=specs, out=folder, processes=False, images='none',
    )
    facts = campaign_facts(
        options, find_program(options.program), program_text(options.program)
    )
    rows = [
        finished_row(options, run_request(options, index, scenario_from_human({
            'cross_track_m': index / 10, 'distance_m': 10.0 * index, **options.overrides,
        }), ()), RunResult(
            outcome=Outcome.FAIL if index in violated else Outcome.PASS, last_seq=300,
            robustness=exact_intervals(dict.fromkeys(
                options.judging.names, -1.0 if index in violated else 0.5)),
        )) for index in range(runs)
    ]
    return write_campaign(folder, rows, facts)


@pytest.fixture
def before(tmp_path):
    return campaign(tmp_path / 'before', {70})


def test_given_a_baseline_then_worse_scenes_fail_it_and_are_named_with_runs_and_next_command(
    before, tmp_path, taxinet
):
    campaign(tmp_path / 'after', {1, 2, 3, 4, 5, 6, 7})
    code, said, err = taxinet('gate', 'after', '--baseline', 'before', '--junit', 'gate.xml')
    assert (code, err) == (1, '')
    lines = said.splitlines()
    assert lines[0] == 'FAIL: after (73 PASS, 7 FAIL)'
    # Nine of the 256 ways that eight scenes can change have seven or more that got worse.
    assert 'in 73 of 80 scenes, by the baseline in 79: 7 got worse, 1 better' in said
    assert 'the loss is +7.5 points' in said
    assert 'p = 0.035 (McNemar, one side)' in said
    assert [line for line in lines if line.startswith('  worse: ')] == [
        f'  worse: nominal-s7-0000{n}: rho -1.000, baseline +0.500' for n in range(1, 8)]
    assert lines[-1] == '  next: taxinet compare before after'
    (suite,) = ElementTree.parse(tmp_path / 'gate.xml').getroot()
    assert [case.get('name') for case in suite.findall('testcase')] == [
        'no worse than the baseline, margin 0.05', 'runs broken by the bench: at most 0']
    worse, _ = suite.findall('testcase')
    assert [one.get('name') for one in worse.iter('property')] == [
        f'run nominal-s7-0000{n}' for n in range(1, 8)]
    text = worse.find('failure').text
    assert 'the loss is +7.5 points, with 95 % confidence each at least' in text
    assert text.endswith('next: taxinet compare before after')
    assert read_runs(tmp_path / 'gate-runs.parquet').failed.sum() == 7


def test_given_a_junit_file_then_it_replaces_its_own_and_neither_a_record_nor_a_pipe(
    before, tmp_path, taxinet
):
    words = ('gate', 'before', '--min-satisfaction', '0.3', '--junit')
    for _ in range(2):
        assert taxinet(*words, 'gate.xml')[0] == 0
    assert len(read_runs(tmp_path / 'gate-runs.parquet').failed) == 80
    record = (before / RECORD_NAME).read_bytes()
    for name in (RECORD_NAME, 'runs.csv'):
        code, said, err = taxinet(*words, f'before/{name}')
        assert (code, said) == (2, '')
        assert f'error: --junit before/{name}: is the name of a record in before' in err
    assert (before / RECORD_NAME).read_bytes() == record
    table = bytearray((tmp_path / 'gate-runs.parquet').read_bytes())
    table[100] ^= 1  # in the first page of data
    (tmp_path / 'gate-runs.parquet').write_bytes(table)
    code, _, err = taxinet('analyze', 'gate-runs.parquet', '--out', 'a')
    assert (code, 'gate-runs.parquet: ' in err) == (2, True), err
    (tmp_path / 'gate-runs.parquet').unlink()
    os.mkfifo(tmp_path / 'gate-runs.parquet')
    (tmp_path / 'gate.xml').unlink()
    code, _, err = taxinet(*words, 'gate.xml')
    assert (code, 'gate-runs.parquet: is not a regular file' in err) == (2, True), err
    assert not (tmp_path / 'gate.xml').exists()
    assert (tmp_path / 'gate-runs.parquet').is_fifo()


def test_given_too_few_changes_then_it_is_unclear_and_none_of_80_pass(before, tmp_path, taxinet):
    campaign(tmp_path / 'after', {1, 2})
    code, said, _ = taxinet('gate', 'after', '--baseline', 'before', '--json')
    told = json.loads(said)
    assert (code, told['verdict']) == (3, 'INCONCLUSIVE')
    assert told['baseline'] | {'worse': [], 'better': []} == {
        'margin': 0.05, 'tested': True, 'scenes': 80, 'unknown': 0, 'satisfied': 78,
        'satisfied_before': 79, 'loss': 1 / 80, 'mcnemar_p_one_sided': 0.5, 'worse': [],
        'better': [],
    }
    assert [one['run_id'] for one in told['baseline']['worse']] == [
        'nominal-s7-00001', 'nominal-s7-00002']
    assert told['criteria'][0]['loss'] == 1 / 80
    assert taxinet('gate', 'before', '--baseline', 'before')[0] == 0
    code, said, _ = taxinet('gate', 'before', '--baseline', 'before', '--min-satisfaction', '0.95')
    assert code == 3, 'one criterion that is open keeps it open'
    assert 'PASS         no worse than the baseline' in said


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('changes', 'words'), [
    ({'seed': 8}, 'baseline before: its seed is 7, here 8'),
    ({'settings': ('place=bikf_10',)}, 'its setting place is not set, here bikf_10'),
    ({'settings': ('cross_track=3',)}, 'its setting cross_track_m is not set, here 3'),
])
def test_given_other_scenes_than_the_baselines_then_it_is_refused_by_name(
    before, tmp_path, taxinet, changes, words
):
    campaign(tmp_path / 'after', set(), **changes)
    code, out, err = taxinet('gate', 'after', '--baseline', 'before')
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert words in err


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('words', 'reason'), [
    ('gate before', 'give a threshold: min_satisfaction, max_off_runway or baseline'),
    ('gate before --margin 0.1 --min-satisfaction 0.5', '--margin: only with --baseline'),
    ('gate before --baseline before --sequential', 'baseline: not with sequential'),
    ('gate before --baseline before --out o', '--out: only where a network is driven'),
    ('gate before --min-satisfaction 0.5 --workers 1', '--workers: only where a network'),
    ('gate nobody --baseline before', "'nobody' is unknown"),
    ('gate truth --baseline nowhere', 'nowhere: neither the folder of a campaign'),
    ('gate truth --baseline late.parquet', 'late.parquet: runs with timing'),
])
def test_given_a_gate_that_cannot_be_then_one_line_says_why(before, taxinet, words, reason):
    frame = pd.read_parquet(BAGS / 's_falsif_truth_400.parquet').iloc[:2]
    frame.assign(timing='perception=0.2').to_parquet('late.parquet')
    code, out, err = taxinet(*words.split())
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert reason in err


def test_given_a_network_then_it_is_driven_through_the_baselines_scenes_and_kept(
    tmp_path, taxinet
):
    frame = pd.read_parquet(BAGS / 's_falsif_truth_400.parquet').iloc[:3]
    frame.assign(duration_s=2.0).to_parquet(tmp_path / 'small.parquet')
    asked = ('gate', 'truth', '--baseline', 'small.parquet', '--out', 'driven', '--workers', '1')
    code, said, _ = taxinet(*asked)
    assert code == 3, 'three scenes show nothing'
    assert 'INCONCLUSIVE: driven' in said
    assert 'in 1 of 3 scenes, by the baseline in 3: 2 got worse' in said, 'two seconds are short'
    assert '3 of 3 scenes are from the table alone' in said
    made = pd.read_parquet(tmp_path / 'driven' / 'runs.parquet')
    assert made['distance_m'].tolist() == frame['distance_m'].tolist()
    record = tmp_path / 'driven' / RECORD_NAME
    made = record.read_bytes()
    assert len(read_record(record)['trial']) == 3
    assert taxinet(*asked)[1] == said
    assert record.read_bytes() == made, 'what is done is kept'
    assert len(read_runs(tmp_path / 'driven' / 'runs.parquet').frame) == 3


def test_given_a_network_and_several_requirements_then_a_run_has_to_satisfy_all(
    tmp_path, taxinet
):
    campaign(tmp_path / 'before', set(), runs=3, settings=('duration_s=1',), specs=(
        'a=always(abs(cte) <= 9)', 'b=always(abs(cte) <= 0.15)'))  # they begin 0, 0.1, 0.2 m off
    asked = ('gate', 'truth', '--baseline', 'before', '--workers', '1', '--out', 'driven',
             '--min-satisfaction', '0.9')
    code, said, _ = taxinet(*asked)
    assert (code, said.splitlines()[0]) == (3, 'INCONCLUSIVE: driven (2 PASS, 1 FAIL)')
    assert 'a is satisfied in 3 of 3 scenes' in said, 'pairs are about the headline'
    assert [line for line in said.splitlines() if 'next: ' in line] == [
        '  next: taxinet compare before driven/runs.parquet'], 'plan and why take no table'
    frame = pd.read_parquet(BAGS / 's_falsif_truth_400.parquet').iloc[:2]
    frame.assign(rho_mine=1.0).to_parquet('mine.parquet')
    code, out, err = taxinet(*asked[:3], 'mine.parquet', *asked[6:])
    assert (code, out) == (2, '')
    assert 'mine.parquet: a table has no text of its formula mine' in err


# check -------------------------------------------------------------------------------------------


def trial(passed: bool | None, rho: float = 0.0) -> Trial:
    return Trial(
        run_id='r', word='', passed=passed, detail='' if passed is not None else 'no image',
        robustness=None if passed is None else RobustnessInterval(rho, rho))


@pytest.mark.parametrize(('passed', 'allowed', 'code'), [
    ((True, True), 0, ExitCode.OK), ((True, False), 0, ExitCode.VIOLATED),
    ((True, False), 1, ExitCode.OK), ((True, None), 0, ExitCode.INCOMPLETE),
    ((False, None), 1, ExitCode.INCOMPLETE), ((False, False, None), 1, ExitCode.VIOLATED),
    ((True, None), 1, ExitCode.OK),
])
def test_given_results_of_a_check_then_the_code_is_what_they_prove(passed, allowed, code):
    found = NetworkCheck(
        network='n', fingerprint='', scenes=(None,) * len(passed),
        trials=tuple(map(trial, passed)))
    assert found.code(allowed) is code


@pytest.fixture(scope='module')
def scenes():
    return fixed_scenes(2)


def test_given_the_fixed_scenes_then_they_are_the_same_for_everybody(scenes):
    assert network_check.SCENES == 50
    assert [scene.row.run_id for scene in scenes] == [f's_falsif-s50-0000{n}' for n in range(2)]
    assert scenes_digest(scenes[:1]) != scenes_digest(scenes[1:2])
    assert round(scenes[0].scenario.distance_m, 3) == 1385.191


def test_given_a_check_then_json_has_all_and_quiet_only_what_is_wrong(
    scenes, monkeypatch, taxinet
):
    def results(networks, scenes, **_):
        for network in networks:
            yield NetworkCheck(
                network=network, fingerprint='f', scenes=scenes,
                trials=(trial(True, 1.0), trial(network == 'truth', -1.0)))

    monkeypatch.setattr(network_check, 'fixed_scenes', lambda number: scenes)
    monkeypatch.setattr(network_check, 'check_networks', results)
    code, said, _ = taxinet('check', 'truth', 'original', '--json')
    good, bad = json.loads(said)
    assert (code, good['exit_code'], bad['exit_code']) == (1, 0, 1)
    assert (bad['satisfied'], bad['violated'], bad['seed']) == (1, 1, 50)
    assert bad['worst'] == [{'run_id': 's_falsif-s50-00001', 'rho': -1.0, 'detail': ''}]
    assert good['scenes_sha256'] == bad['scenes_sha256'] == scenes_digest(scenes)
    code, said, err = taxinet('check', 'truth', 'original', '--quiet')
    assert (code, err, said.count('\n')) == (1, '', 1)
    assert said.startswith('original: 1 satisfied, 1 violated')
    assert taxinet('check', 'original', '--quiet', '--allow', '1') == (0, '', '')
    code, said, _ = taxinet('check', 'truth', 'original')
    lines = said.splitlines()
    assert lines[0] == (
        'truth: 2 satisfied, 0 violated, 0 unclear of 2 scenes of s_falsif, seed 50 '
        '(phi_eventually; 0 violated allowed)')
    assert lines[3].startswith('  s_falsif-s50-00001: rho -1.00 (')
    assert lines[4] == (
        'next: taxinet run s_falsif --seed 50 --runs 2 --engine loop --perception original --out '
        'bags/check; taxinet why bags/check')
