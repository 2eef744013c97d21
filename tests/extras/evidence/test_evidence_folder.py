"""The folder of evidence: same bytes, damage, moved and stale inputs, runs driven again."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from planted_evidence import FAIL, PASS, judged_monitor, planted

import taxinet_ros as tx
from taxinet_ros.cli.analysis.localize import run_localize
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.extras.evidence import verify as verifying
from taxinet_ros.extras.evidence.argument import goals, mermaid, parse_argument
from taxinet_ros.extras.evidence.evidence import manifest_text
from taxinet_ros.extras.evidence.verify import value_differences, verify
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.trials.loop_run import Loop
from taxinet_ros.trials.past_runs.localisation import make_localize_options
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
from taxinet_ros.trials.record.content import BEGUN, run_key

TAXINET = Path(sys.executable).with_name('taxinet')
NAMES = {'MANIFEST', 'argument.mmd', 'evidence.html', 'evidence.json'}
REQUIREMENT = 'REQ-7: The aircraft shall stay near the centreline.'
NEVER = re.compile(r'complian|certif|\bsafe\b|\bsafety\b|guarantee', re.IGNORECASE)


@pytest.fixture(scope='module')
def driven(tmp_path_factory) -> Path:
    """A real campaign of short runs with bags; some of them fail."""
    found = tmp_path_factory.mktemp('driven') / 'found'
    done = subprocess.run(
        [TAXINET, 'falsify', 's_falsif', '--runs', '3', '--seed', '2', '--perception', 'original',
         '--spec', 'near=always(abs(cte) <= 4)', '--set', 'duration=0.5', '--sampler', 'random',
         '--engine', 'loop', '--audit', '0', '--images', 'none', '--out', found, '--quiet'],
        capture_output=True, text=True, check=False,
    )
    assert done.returncode in (0, 1), done.stderr
    outcomes = {row.outcome for row in open_campaign(found).rows}
    assert outcomes == {PASS, FAIL}
    return found


@pytest.fixture(scope='module')
def proven(driven) -> Path:
    """Evidence of it, with a failed run driven again."""
    out, localized = driven.parent / 'evidence', driven.parent / 'localized'
    run_localize(
        make_localize_options(driven, runs=1, words=(), workers=1, out=localized, perception=None),
        as_json=False,
    )
    content = tx.evidence(driven, out, requirement=REQUIREMENT, claim=0.5, localize=localized)
    assert content['localisations'][0]['figures']['looked_into'] == 1
    return out


def verified(folder, **options):
    return verify(folder, **{'sample': 0, **options})


def made(tmp_path, *outcomes, out='evidence', **options):
    folder = tmp_path / 'found'
    if not folder.exists():
        planted(folder, outcomes or (PASS, FAIL, PASS))
    tx.evidence(folder, tmp_path / out, **options)
    return tmp_path / out


# Files -------------------------------------------------------------------------------------------


def test_given_the_same_inputs_then_the_same_bytes_and_sha256sum_agrees(tmp_path):
    one = made(tmp_path, requirement=REQUIREMENT, claim=0.9)
    other = made(tmp_path, out='again', requirement=REQUIREMENT, claim=0.9)
    files = {path.name: path.read_bytes() for path in one.iterdir()}
    assert set(files) == NAMES
    assert files == {path.name: path.read_bytes() for path in other.iterdir()}
    done = subprocess.run(['sha256sum', '-c', '--strict', 'MANIFEST'], cwd=one,
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stdout.count(': OK\n') == 3


class _Text(HTMLParser):
    """Visible text of a page, and all addresses in it."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words, self.addresses, self._hidden = [], [], 0
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self._hidden += tag in ('style', 'script')
        self.addresses += [value for name, value in attrs if name in ('src', 'href', 'action')]

    def handle_endtag(self, tag):
        self._hidden -= tag in ('style', 'script')

    def handle_data(self, data):
        self.words += [] if self._hidden else [data]


@pytest.mark.nightly
def test_given_the_page_then_it_refers_to_nothing_outside_and_claims_no_more_than_evidence(proven):
    found = _Text((proven / 'evidence.html').read_text(encoding='utf-8'))
    assert found.addresses == ['#limits']
    text = ' '.join(' '.join(found.words).split())
    content = json.loads((proven / 'evidence.json').read_text(encoding='utf-8'))
    for system in content['systems']:
        del system['program']['text']  # words of a program are its author's
    for words in (text, json.dumps(content)):
        assert not NEVER.search(words), NEVER.search(words)
    for expected in (
        'Evidence toward REQ-7', 'The claim of at least 50 % is undetermined', 'Clopper-Pearson',
        'taxinet evidence verify .', *(one['words'] for one in content['limits']),
        *(one['text'] for one in goals(content['argument'])),
        *(one['sha256'] or one['why_unknown'] for one in content['items'].values()),
    ):
        assert ' '.join(expected.split()) in text


def test_given_markup_in_a_requirement_then_page_and_drawing_show_it_as_text(tmp_path):
    out = made(tmp_path, requirement='REQ-1: <script>x</script> "quoted" ]')
    assert '<script>' not in (out / 'evidence.html').read_text(encoding='utf-8')
    drawn = (out / 'argument.mmd').read_text(encoding='utf-8')
    assert '#60;script#62;x#60;/script#62; #34;quoted#34; #93;' in drawn


def test_given_a_folder_that_is_there_or_refused_inputs_then_nothing_is_written(tmp_path):
    made(tmp_path)
    with pytest.raises(UsageError, match='already exists'):
        made(tmp_path)
    with pytest.raises(UsageError, match='not judged'):
        made(tmp_path, out='other', spec='psi')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['evidence', 'found']


# Verification ------------------------------------------------------------------------------------


def test_given_evidence_of_real_runs_when_verified_then_all_holds_and_runs_repeat(
    proven, monkeypatch
):
    found = tx.verify_evidence(proven, sample=2, seed=1)
    assert found.holds, (found.damaged, found.different, found.unchecked)
    assert found.checked['files'] == 4
    assert found.checked['hashes of inputs'] == 4
    assert found.checked['runs driven again, equal to the bit'] == 2
    assert found.checked['values computed again'] > 200
    assert found.notes == []
    monkeypatch.setattr(verifying, 'Loop', lambda system, *given: Loop(
        dataclasses.replace(system, gains={'heading_gain': 1.0}), *given))
    other = verified(proven, sample=2, seed=1)
    assert other.code == ExitCode.INFRA
    assert 'driven again: ' in other.different[0]


@pytest.mark.nightly
@pytest.mark.parametrize('name', sorted(NAMES))
def test_given_a_damaged_or_missing_file_then_verification_names_it_with_code_2(tmp_path, name):
    out = made(tmp_path)
    path = out / name
    data = path.read_bytes()
    path.write_bytes(data[:-20] + b'x' + data[-19:])
    found = verified(out)
    assert found.code == ExitCode.USAGE
    assert any(name in line for line in found.damaged)
    path.unlink()
    assert any(name in line for line in verified(out).damaged)
    (out / 'more.txt').write_text('x', encoding='utf-8')
    if name != 'MANIFEST':
        assert any('more.txt: is not listed' in line for line in verified(out).damaged)


@pytest.mark.nightly
@pytest.mark.parametrize(('change', 'words'), [
    (lambda v: v['systems'][0]['figures']['formulas'][0]['satisfied'].update(rate=0.99),
     r'figures\.formulas\[0\]\.satisfied\.rate: is 0\.99, of these inputs it is 0\.66'),
    (lambda v: v['systems'][0]['claim'].update(verdict='supported'), r'claim\.verdict: is '),
    (lambda v: v['items']['system-1/network'].update(sha256='0' * 64), r'network\.sha256: is '),
    (lambda v: v.update(extra=1), 'extra: is not of these inputs'),
    (lambda v: v['systems'][0].pop('odd'), r'systems\[0\]\.odd: is missing'),
    (lambda v: v.pop('campaigns'), 'a value is missing or of another form'),
    (lambda v: v.update(schema='taxinet-evidence-9'), 'is of schema'),
])
def test_given_a_claim_that_does_not_follow_from_the_runs_then_the_value_is_named(
    tmp_path, change, words
):
    out = made(tmp_path, requirement=REQUIREMENT, claim=0.999)
    path = out / 'evidence.json'
    values = json.loads(path.read_text(encoding='utf-8'))
    change(values)
    path.write_text(json.dumps(values), encoding='utf-8')
    (out / 'MANIFEST').write_text(manifest_text(out), encoding='utf-8')
    found = verified(out)
    assert found.code == ExitCode.USAGE
    assert any(re.search(words, line) for line in found.damaged), found.damaged


@pytest.mark.nightly
def test_given_a_moved_campaign_then_it_is_asked_for_and_found_by_its_hashes(tmp_path):
    out = made(tmp_path)
    (tmp_path / 'found').rename(tmp_path / 'elsewhere')
    found = verified(out)
    assert found.code == ExitCode.USAGE
    assert any('campaign found is not there; if it has moved' in line for line in found.damaged)
    found = verified(out, moved=(tmp_path / 'elsewhere',))
    assert not found.damaged
    planted(tmp_path / 'another', [PASS])
    found = verified(out, moved=(tmp_path / 'elsewhere', tmp_path / 'another'))
    assert any('another: is none of the inputs' in line for line in found.damaged)
    with pytest.raises(UsageError, match='nowhere: no such folder'):
        verified(out, moved=(tmp_path / 'nowhere',))


@pytest.mark.nightly
def test_given_an_odd_that_moved_then_it_is_asked_for_and_found_too(tmp_path):
    odd = tmp_path / 'odds' / 'two.yaml'
    odd.parent.mkdir()
    odd.write_text(
        'name: two\nsource: planted\nparameters:\n'
        '  cross_track: {range: [0, 8], cells: 2, source: x}\n', encoding='utf-8')
    out = made(tmp_path, odd=odd)
    assert verified(out).holds
    moved = odd.parent.rename(tmp_path / 'moved')
    assert any('ODD two is not there; if it has moved' in line for line in verified(out).damaged)
    assert verified(out, moved=(moved,)).holds
    (moved / 'two.yaml').write_text('name: three\n', encoding='utf-8')
    assert not verified(out, moved=(moved,)).holds


@pytest.mark.nightly
def test_given_a_judged_monitor_then_the_page_shows_it_and_verify_finds_a_change(tmp_path):
    judged = judged_monitor(tmp_path / 'judged')
    out = made(tmp_path, monitor_table=judged)
    page = ' '.join(_Text((out / 'evidence.html').read_text(encoding='utf-8')).words)
    assert 'Run-time monitor, in the same scenes without a fallback and with each' in page
    assert '33.3 % (0.84–90.58 %)' in page
    assert verified(out).holds
    moved = judged.rename(tmp_path / 'moved')
    assert any('judgement monitor-1 is not there' in line for line in verified(out).damaged)
    assert verified(out, moved=(moved,)).holds
    moved.rename(judged)
    path = judged / 'alarms.csv'
    path.write_bytes(path.read_bytes().replace(b'11.0', b'11.1', 1))
    found = verified(out)
    assert found.code == ExitCode.USAGE
    assert any('alarms.csv: has changed since the evidence' in line for line in found.damaged)
    path.unlink()
    assert any('alarms.csv: is missing' in line for line in verified(out).damaged)


def test_given_everything_moved_together_then_all_is_found(tmp_path):
    (tmp_path / 'here').mkdir()
    made(tmp_path / 'here')
    (tmp_path / 'here').rename(tmp_path / 'there')
    assert not verified(tmp_path / 'there' / 'evidence').damaged


@pytest.mark.nightly
def test_given_a_campaign_that_went_on_since_then_it_is_named_as_changed(tmp_path):
    out = made(tmp_path)
    assert verified(out, sample=3).code == ExitCode.INCOMPLETE
    assert any('no run has its bag here' in line for line in verified(out, sample=3).unchecked)
    with Record(tmp_path / 'found' / RECORD_NAME) as record:
        record.put(BEGUN, run_key(3), 1)
    found = verified(out)
    assert found.code == ExitCode.USAGE
    assert any('campaign.db: has changed since the evidence was written' in line
               for line in found.damaged)


def test_given_a_folder_of_something_else_then_it_is_refused(tmp_path):
    for folder, words in ((tmp_path / 'nowhere', 'no such folder'), (tmp_path, 'no evidence')):
        with pytest.raises(UsageError, match=words):
            verified(folder)


def test_given_values_that_differ_then_each_place_is_named_once():
    written = {'a': [{'id': 'x', 'n': 1}, 2], 'b': True, 'c': 1, 'e': [1]}
    now = {'a': [{'id': 'x', 'n': 1.0}, 3], 'b': 1, 'd': None, 'e': []}
    assert list(value_differences(written, now)) == [
        'a[0].n: is 1, of these inputs it is 1.0', 'a[1]: is 2, of these inputs it is 3',
        'b: is True, of these inputs it is 1', 'c: is not of these inputs', 'd: is missing',
        'e: is missing', 'e[0]: is not of these inputs',
    ]
    assert list(value_differences(written, written)) == []


# Argument ----------------------------------------------------------------------------------------


def test_given_the_argument_then_its_solutions_have_hashes_and_open_goals_none(proven):
    content = json.loads((proven / 'evidence.json').read_text(encoding='utf-8'))
    found = list(goals(content['argument']))
    solutions = [one for goal in found for one in goal['solutions']]
    assert len(solutions) >= 4
    assert all(content['items'][one['item']]['sha256'] for one in solutions)
    assert any(one['undeveloped'] for one in found)
    for one in found:
        assert bool(one['solutions'] or one['parts']) is not one['undeveloped']


def test_given_an_argument_then_mermaid_draws_each_element_once_and_joins_it():
    values = parse_argument(
        'goal: top\n  context: beside\n  strategy: argue over both\n'
        '  undetermined: left\n    why: no runs\n  undetermined: right\n    why: no runs\n'
    )
    assert [one['why'] for one in goals(values)] == [
        'of its parts: 2 undetermined', 'no runs', 'no runs',
    ]
    assert mermaid(values).splitlines() == [
        'flowchart TD', '  G1["G1: top<br/>undetermined"]', '  C1("C1: beside")', '  G1 -.-> C1',
        '  S1[/"S1: argue over both"/]', '  G1 --> S1',
        '  S1 --> G2', '  G2["G2: left<br/>undeveloped #9671;"]',
        '  S1 --> G3', '  G3["G3: right<br/>undeveloped #9671;"]',
    ]


@pytest.mark.parametrize(('parts', 'verdict'), [
    (('supported', 'refuted', 'undetermined'), 'refuted'), (('supported',) * 2, 'supported'),
    (('supported', 'undetermined'), 'undetermined'),
])
def test_given_parts_then_one_refutes_the_whole_and_all_support_it(parts, verdict):
    lines = [f'    {part}: part\n      solution: runs -> item' for part in parts]
    values = parse_argument('\n'.join(['goal: top', '  goal: middle', *lines]))
    assert values['verdict'] == values['parts'][0]['verdict'] == verdict
    assert values['parts'][0]['parts'][0]['solutions'] == [
        {'id': 'Sn1', 'text': 'runs', 'item': 'item'}]
