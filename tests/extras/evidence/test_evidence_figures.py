"""Figures of evidence: rates with known intervals, claims, what is kept apart, what is refused."""

from __future__ import annotations

import hashlib
import shutil

import pytest
from planted_evidence import FAIL, INFRA, PASS, SHA, UNDECIDED, judged_monitor, planted

import taxinet_ros as tx
from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.evidence.argument import goals
from taxinet_ros.extras.evidence.evidence import collect, parse_claim
from taxinet_ros.extras.evidence.inputs import read_requirement


def collected(*folders, requirement=None, **options):
    words = None if requirement is None else read_requirement(requirement)
    return collect(
        folders, folders[0].parent / 'evidence', requirement=words, **options,
    ).content


def limits(content):
    return {one['id'] for one in content['limits']}


def the_goal(content, words):
    """The first goal whose text has these words."""
    return next(one for one in goals(content['argument']) if words in one['text'])


def formula(content, system=0, name='phi'):
    found = content['systems'][system]['figures']['formulas']
    return next(one for one in found if one['formula'] == name)


def test_given_18_of_20_drawn_runs_then_the_interval_is_the_known_one(tmp_path):
    rho = [0.1 * index for index in range(1, 19)] + [-1.0, -2.0]
    content = collected(planted(tmp_path / 'a', [PASS] * 18 + [FAIL] * 2, rho=rho))
    found = formula(content)
    assert found['satisfied']['rate'] == 0.9
    # Clopper-Pearson of 18 of 20, as in its tables: 68.3 to 98.8 %.
    assert found['satisfied']['low'] == pytest.approx(0.6830173, abs=1e-6)
    assert found['satisfied']['high'] == pytest.approx(0.9876515, abs=1e-6)
    assert found['violated']['drawn_hits'] == 2
    assert found['undecided']['hits'] == 0
    quantiles = {one['share']: one['rho'] for one in found['rho']['quantiles']}
    assert quantiles[0.0] == -2.0
    assert quantiles[0.5] == pytest.approx(0.85)
    assert quantiles[1.0] == pytest.approx(1.8)
    off = content['systems'][0]['figures']['off_runway']
    assert (off['hits'], off['drawn']) == (2, 20)


def test_given_infrastructure_errors_then_they_are_in_no_rate_and_have_their_own(tmp_path):
    content = collected(planted(tmp_path / 'a', [PASS, INFRA, FAIL, INFRA, PASS]))
    assert formula(content)['satisfied']['drawn'] == 3
    infra = content['systems'][0]['figures']['infra']
    assert (infra['hits'], infra['drawn'], infra['rate']) == (2, 5, 0.4)
    # 2 of 5: 5.27 to 85.34 %.
    assert (infra['low'], infra['high']) == pytest.approx((0.0527450, 0.8533672), abs=1e-6)
    assert infra['kinds'] == {'timeout': 2}
    assert 'infra' in limits(content)


@pytest.mark.one_in(2)
@pytest.mark.parametrize(('passed', 'failed', 'claim', 'verdict'), [
    (72, 0, 0.95, 'supported'), (71, 0, 0.95, 'undetermined'), (10, 10, 0.99, 'refuted'),
    (10, 0, 0.99, 'undetermined'),
])
def test_given_a_claim_then_the_whole_interval_decides(tmp_path, passed, failed, claim, verdict):
    content = collected(planted(tmp_path / 'a', [PASS] * passed + [FAIL] * failed), claim=claim)
    assert content['systems'][0]['claim']['verdict'] == verdict
    assert the_goal(content, 'in at least')['verdict'] == verdict
    assert verdict != 'refuted' or content['argument']['verdict'] == 'refuted'


def test_given_runs_stopped_undecided_then_there_are_bounds_and_no_rate(tmp_path):
    content = collected(
        planted(tmp_path / 'a', [PASS] * 8 + [UNDECIDED] * 2, stop_on='violated'), claim=0.5,
    )
    found = formula(content)
    assert found['satisfied']['rate'] is found['violated']['rate'] is None
    assert found['undecided']['drawn_hits'] == 2
    # 8 of 10 at worst, 10 of 10 at best: 44.4 to 100 %.
    assert found['satisfied_at_least'] == pytest.approx(0.4439045, abs=1e-6)
    assert found['satisfied_at_most'] == 1.0
    assert content['systems'][0]['claim']['verdict'] == 'undetermined'
    assert 'undecided' in limits(content)


def test_given_a_sampler_that_chose_all_scenes_then_there_is_no_rate_and_it_is_said(tmp_path):
    content = collected(planted(tmp_path / 'a', [PASS] * 90 + [FAIL], drawn=False), claim=0.5)
    found = formula(content)
    assert found['satisfied']['rate'] is None
    assert found['satisfied']['runs'] == 91
    assert found['rho']['quantiles'] == []
    assert content['systems'][0]['claim']['verdict'] == 'undetermined'
    assert 'no-rate' in limits(content)
    goal = the_goal(content, 'How often')
    assert goal['undeveloped']
    assert 'sampler random' in goal['why']


def test_given_a_sampler_that_chose_some_then_only_the_drawn_ones_are_in_the_rate(tmp_path):
    drawn = [index % 2 == 0 for index in range(20)]
    outcomes = [PASS if own else FAIL for own in drawn]
    content = collected(planted(tmp_path / 'a', outcomes, drawn=drawn))
    found = formula(content)['satisfied']
    assert (found['hits'], found['runs'], found['drawn_hits'], found['drawn']) == (10, 20, 10, 10)
    assert found['rate'] == 1.0
    assert 'chosen-scenes' in limits(content)


def test_given_campaigns_of_one_system_then_each_has_figures_and_their_sum_an_open_interval(
    tmp_path
):
    one = planted(tmp_path / 'a', [PASS] * 30, seed=1)
    other = planted(tmp_path / 'b', [PASS] * 28 + [FAIL] * 2, seed=2)
    content = collected(one, other)
    (system,) = content['systems']
    assert system['campaigns'] == ['campaign-1', 'campaign-2']
    each = [one['figures']['formulas'][0]['satisfied'] for one in content['campaigns']]
    assert [(one['drawn_hits'], one['any_time']) for one in each] == [(30, False), (28, False)]
    both = formula(content)['satisfied']
    assert (both['drawn_hits'], both['drawn'], both['any_time']) == (58, 60, True)
    # Wider than the interval of a number fixed beforehand: 88.5 to 99.6 %.
    assert both['low'] < 0.8847
    assert both['high'] > 0.9959
    assert 'pooled' in limits(content)
    assert 'several-stacks' not in limits(content)


def test_given_campaigns_of_two_versions_that_are_added_up_then_a_limit_says_which(tmp_path):
    newer = {'87654321': {'python': '3.11.7', 'taxinet_ros': '0.2.0', 'commit': 'f' * 40}}
    content = collected(
        planted(tmp_path / 'a', [PASS] * 3, seed=1),
        planted(tmp_path / 'b', [PASS] * 3, seed=2, stacks=newer),
    )
    said = next(one['words'] for one in content['limits'] if one['id'] == 'several-stacks')
    assert said == 'The runs were made on several machines or versions: taxinet_ros 0.1.0 | 0.2.0.'


@pytest.mark.nightly
@pytest.mark.parametrize('other', [
    {'perception': 'taxinet'}, {'program_sha256': None}, {'gains': {'heading_gain': 1.0}},
    {'overrides': {'rain_percent': 0}}, {'timing': 'latency 0.1'}, {'stop_on': 'violated'},
])
def test_given_campaigns_that_differ_then_they_are_kept_apart(tmp_path, other):
    if 'program_sha256' in other:
        text = '# --- other.scenic ---\nmodel runway_world\n'
        other = {'program_text': text,
                 'program_sha256': hashlib.sha256(text.encode()).hexdigest()}
    one = planted(tmp_path / 'a', [PASS] * 3, seed=1)
    two = planted(tmp_path / 'b', [FAIL] * 4, seed=2, **other)
    content = collected(one, two)
    assert [formula(content, at)['satisfied']['drawn'] for at in (0, 1)] == [3, 4]
    assert [formula(content, at)['satisfied']['drawn_hits'] for at in (0, 1)] == [3, 0]
    assert 'several-systems' in limits(content)
    assert sum('satisfies phi in' in one['text'] for one in goals(content['argument'])) == 2


def test_given_everything_then_each_item_has_a_hash_or_the_reason_why_not(tmp_path):
    content = collected(planted(tmp_path / 'a', [PASS, FAIL]), claim=0.9999999)
    items = content['items']
    kinds = {one['kind'] for one in items.values()}
    assert kinds >= {
        'requirement', 'formula', 'program', 'network', 'training data', 'tool versions',
        'record', 'recordings', 'model card',
    }
    for one in items.values():
        assert (one['sha256'] is None) == bool(one['why_unknown'])
        assert one['sha256'] is None or len(one['sha256']) == 64
    assert items['system-1/network']['sha256'] == SHA['original']
    assert items['system-1/data-1']['name'] == 'program training_original'
    assert items['requirement']['sha256'] is None
    assert {'no-requirement', 'no-odd', 'no-localisation', 'no-bags', 'renderer', 'network-origin',
            'not-audited', 'distribution'} <= limits(content)
    assert 'no-claim' not in limits(content)
    assert the_goal(content, 'at least 99.99999 %'), 'it is not rounded to 100 %'
    records = the_goal(content, 'Every figure rests on')
    assert (records['verdict'], 'bags of 0 of 2 judged runs' in records['why']) == (
        'undetermined', True)


@pytest.mark.parametrize(('perception', 'sha256', 'why'), [
    ('gone.safetensors', 'a' * 64, 'not there any more'),
    ('mine.onnx', 'b' * 64, 'no model card names its data'),
    ('my_file.py:look', 'c' * 64, 'no model card names its data'),
])
def test_given_a_network_of_unknown_training_then_that_is_a_limit_and_a_goal_left_open(
    tmp_path, perception, sha256, why
):
    folder = planted(tmp_path / 'a', [PASS], perception=perception, perception_sha256=sha256)
    content = collected(folder)
    assert 'data-unknown' in limits(content)
    item = content['items']['system-1/data']
    assert item['sha256'] is None
    assert why in item['why_unknown']
    assert the_goal(content, 'training data')['undeveloped']


@pytest.mark.nightly
def test_given_an_odd_then_its_cells_are_counted_and_gaps_are_limits(tmp_path):
    odd = tmp_path / 'odd.yaml'
    odd.write_text(
        'name: two\nsource: planted\nparameters:\n'
        '  cross_track: {range: [0, 8], cells: 2, source: x}\n'
        '  clouds: {values: [clear, stratus], source: y}\n', encoding='utf-8')
    content = collected(planted(tmp_path / 'a', [PASS] * 8), odd=str(odd))
    (pairs,) = [one for one in content['systems'][0]['odd']['combinations'] if one['t'] == 2]
    assert (pairs['covered'], pairs['feasible']) == (2, 4)
    assert {'odd-cells', 'odd-pairs'} <= limits(content)
    assert 'no-odd' not in limits(content)
    # What happens in a gap is not known.
    assert the_goal(content, 'every feasible pair')['verdict'] == 'undetermined'


# Monitors ----------------------------------------------------------------------------------------


def test_given_a_judged_monitor_then_its_figures_are_stated_cited_and_limited(tmp_path):
    folder = judged_monitor(tmp_path / 'monitor')
    campaign = planted(tmp_path / 'a', [PASS])
    content = collected(campaign, monitors=(folder,))
    (monitor,) = content['monitors']
    figures = monitor['figures']
    assert (figures['failed'], figures['in_time'], figures['late'], figures['missed']) == (
        2, 1, 1, 0)
    assert figures['with_fallback']['stop']['fixed'] == 1
    assert monitor['campaigns'] == ['campaign-1']
    names = ['alarms.csv', 'assurance.json', 'campaign.db', 'trials.csv']
    for name in names:
        item = content['items'][f'monitor-1/{name}']
        assert item['sha256'] == hashlib.sha256((folder / name).read_bytes()).hexdigest()
    goal = the_goal(content, 'run-time monitor')
    assert (goal['verdict'], goal['undeveloped']) == ('supported', False)
    assert goal['why'] == (
        'of 2 failed runs 1 with an alarm in time, of 1 satisfied ones 0 with an alarm')
    assert [one['item'] for one in goal['solutions']] == ['monitor-1/assurance.json']
    limit = next(one['words'] for one in content['limits'] if one['id'] == 'monitor-program-1')
    assert 's_falsif only, not by a hash, which is not that of these campaigns (planted)' in limit
    assert 'no-monitor' not in limits(content)
    without = collected(campaign)
    assert the_goal(without, 'run-time monitor')['why'] == 'no monitor was judged'
    assert 'no-monitor' in limits(without)
    with pytest.raises(UsageError, match='two are the same judgement'):
        collected(campaign, monitors=(folder, folder))


@pytest.mark.nightly
@pytest.mark.parametrize(('name', 'old', 'new', 'words'), [
    ('trials.csv', b'0,without,True', b'0,without,False', 'is not the file recorded in assurance'),
    ('alarms.csv', b'11.0', b'11.1', 'is not the file recorded in assurance'),
    ('assurance.json', b'"in_time": 1', b'"in_time": 2', 'its checksum differs'),
    ('campaign.db', b'"run_id":"000001', b'"run_id":"000003', 'damaged'),
    ('trials.csv', None, None, 'is missing, but listed in assurance.json'),
    ('assurance.json', None, None, 'no results of taxinet assure judge: assurance.json is not'),
])
def test_given_a_judgement_that_was_touched_then_it_is_refused_by_name(
    tmp_path, name, old, new, words
):
    folder = judged_monitor(tmp_path / 'monitor')
    if old is None:
        (folder / name).unlink()
    else:
        damage(folder / name, old, new)
    with pytest.raises(UsageError, match=words) as caught:
        collected(planted(tmp_path / 'a', [PASS]), monitors=(folder,))
    assert str(folder) in str(caught.value)
    assert '\n' not in str(caught.value)


@pytest.mark.nightly
def test_given_a_judgement_of_another_network_or_monitor_then_it_is_refused(tmp_path):
    folder = judged_monitor(tmp_path / 'monitor')
    with pytest.raises(UsageError, match=r'monitor: is about network original .* no campaign'):
        collected(planted(tmp_path / 'a', [PASS], perception='taxinet'), monitors=(folder,))
    for number, (word, fits) in enumerate((
        ('steering+original+stop', True), ('steering+taxinet+stop', False),
        ('steering+original+slow', False),
    )):
        campaign = planted(
            tmp_path / f'with-{number}', [PASS], controller=word,
            controller_sha256=check_controller(word),
        )
        if fits:
            assert collected(campaign, monitors=(folder,))['monitors']
        else:
            with pytest.raises(UsageError, match='monitor original with stop; no campaign'):
                collected(campaign, monitors=(folder,))


@pytest.mark.nightly
def test_given_campaigns_of_two_networks_then_the_monitor_is_that_of_one(tmp_path):
    content = collected(
        planted(tmp_path / 'a', [PASS], seed=1), planted(
            tmp_path / 'b', [PASS], seed=2, perception='taxinet'),
        monitors=(judged_monitor(tmp_path / 'monitor', 'taxinet'),),
    )
    assert content['monitors'][0]['campaigns'] == ['campaign-2']
    assert [one['about'] for one in content['limits'] if one['id'] == 'no-monitor'] == ['system-1']


# Refused -----------------------------------------------------------------------------------------


def damage(path, old, new):
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))


@pytest.mark.parametrize(('spoil', 'words'), [
    (lambda f: damage(f / 'campaign.db', b'"PASS"', b'"FAIL"'), r'campaign\.db: damaged'),
    (lambda f: damage(f / 'campaign.db', b'"seed":0', b'"seed":7'), r'campaign\.db: damaged'),
    (lambda f: (f / 'campaign.db').unlink(), r'not a campaign: no campaign\.db'),
])
@pytest.mark.filterwarnings('ignore')
def test_given_a_damaged_campaign_then_it_is_refused_by_name(tmp_path, spoil, words):
    folder = planted(tmp_path / 'a', [PASS, FAIL])
    spoil(folder)
    with pytest.raises(UsageError, match=words):
        collected(folder)


@pytest.mark.filterwarnings('ignore')
def test_given_damaged_tables_then_evidence_rests_on_those_of_the_record(tmp_path):
    folder = planted(tmp_path / 'a', [PASS, FAIL])
    before = {name: (folder / name).read_bytes() for name in ('runs.csv', 'runs.parquet')}
    damage(folder / 'runs.csv', b'PASS', b'FAIL')
    (folder / 'runs.parquet').unlink()
    collected(folder)
    assert {name: (folder / name).read_bytes() for name in before} == before


@pytest.mark.parametrize(('facts', 'words'), [
    ({'finished': False}, 'has not ended in order'),
    ({'program_text': None}, 'its record lacks program_text'),
    ({'perception_sha256': 'a' * 64}, 'several networks'),
])
def test_given_a_campaign_that_cannot_be_bound_then_it_is_refused_by_name(tmp_path, facts, words):
    with pytest.raises(UsageError, match=f'a: .*{words}'):
        collected(planted(tmp_path / 'a', [PASS], **facts))


def test_given_a_table_alone_or_results_of_others_then_they_are_refused_by_name(tmp_path):
    folder = planted(tmp_path / 'a', [FAIL], perception='taxinet')
    with pytest.raises(UsageError, match=r'runs\.parquet: not a campaign'):
        collected(folder / 'runs.parquet')
    with pytest.raises(UsageError, match='a: no results of taxinet localize'):
        collected(folder, localisations=(folder,))


def test_given_a_campaign_twice_or_its_copy_then_it_is_refused(tmp_path):
    folder = planted(tmp_path / 'a', [PASS])
    shutil.copytree(folder, tmp_path / 'copy')
    for other in (folder, tmp_path / 'copy'):
        with pytest.raises(UsageError, match=r'has runs that are in .*a too'):
            collected(folder, other)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('options', 'words'), [
    ({'claim': 1.0}, 'expected a share between 0 and 1'), ({'claim': 0.0}, 'expected a share'),
    ({'spec': 'psi'}, 'not judged in .*known: phi'), ({'odd': 'nowhere'}, 'no such file'),
    ({'requirement': 'no identifier'}, 'expected an identifier'),
    ({'requirement': 'REQ-1: '}, 'expected an identifier'),
])
def test_given_a_wrong_option_then_it_is_refused_by_name(tmp_path, options, words):
    with pytest.raises(UsageError, match=words):
        collected(planted(tmp_path / 'a', [PASS]), **options)


def test_given_no_judged_run_then_nothing_is_said_to_be_supported_by_runs(tmp_path):
    content = collected(planted(tmp_path / 'a', [INFRA, INFRA]))
    for words in ('There is no failed run', 'Every figure rests on recorded runs'):
        assert the_goal(content, words)['verdict'] == 'undetermined'
    assert 'no-claim' in limits(content)


def test_given_shares_as_people_write_them_then_they_are_read():
    assert [parse_claim(text) for text in ('0.99', '99%', '99 %', ' 99.5% ')] == pytest.approx(
        [0.99, 0.99, 0.99, 0.995])
    for text in ('much', '99 percent', '99% or so', ''):
        with pytest.raises(UsageError, match='claim '):
            parse_claim(text)


def test_given_a_requirement_in_a_file_then_its_hash_is_that_of_the_file(tmp_path):
    path = tmp_path / 'req.txt'
    path.write_bytes(b'REQ-7:  The aircraft shall\r\nstay.\n')
    found = read_requirement(str(path))
    assert (found['id'], found['text']) == ('REQ-7', 'The aircraft shall stay.')
    assert found['sha256'] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_given_interrupted_runs_then_the_interval_is_the_open_one(tmp_path):
    outcomes = [PASS] * 9 + [Outcome.INTERRUPTED]
    content = collected(planted(tmp_path / 'a', outcomes, planned=20))
    found = formula(content)['satisfied']
    assert (found['drawn'], found['any_time']) == (9, True)
    assert 'interrupted' in limits(content)


def test_given_a_campaign_of_run_then_the_hash_of_its_network_is_that_of_its_runs(tmp_path):
    content = collected(planted(tmp_path / 'a', [PASS], perception_sha256=None))
    assert content['systems'][0]['network']['sha256'] == SHA['original']


def test_people9_given_a_requirement_without_an_identifier_then_no_campaign_is_read_before(
    tmp_path
):
    with pytest.raises(UsageError, match='requirement stay on the line: expected an identifier'):
        tx.evidence(tmp_path / 'absent', tmp_path / 'out', requirement='stay on the line')
