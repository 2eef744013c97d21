"""The folder of evidence: same bytes, tampering, moved and stale inputs, runs driven again."""

from __future__ import annotations

import json
import random
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
from planted_evidence import FAIL, PASS, planted

import taxinet_ros as tx
from taxinet_ros.analysis.report import pictures as picture_files
from taxinet_ros.analysis.report.pictures import DARK
from taxinet_ros.campaign.record.ledger import Ledger, read_ledger
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.sealed_json import sealed_text
from taxinet_ros.study.evidence.argument import (
    IN_CONTEXT_OF,
    SUPPORTED_BY,
    Argument,
    Edge,
    Kind,
    Node,
    Part,
    SystemArgument,
    argument_faults,
    argument_of,
    build_argument,
)
from taxinet_ros.study.evidence.drawing import _Layout, argument_svg
from taxinet_ros.study.evidence.folder import manifest_text, read_evidence
from taxinet_ros.study.evidence.verify import VerifyOptions, value_differences, verify

TAXINET = Path(sys.executable).with_name('taxinet')
NAMES = {'MANIFEST', 'argument.svg', 'evidence.html', 'evidence.json'}
REQUIREMENT = 'REQ-7: The aircraft shall stay near the centreline.'
NEVER = re.compile(r'complian|certif|\bsafe\b|\bsafety\b|guarantee', re.IGNORECASE)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Drawing takes by far the longest; here only that it is done matters."""
    monkeypatch.setattr(picture_files, 'DOTS_PER_INCH', 30)


def falsified(out, *words) -> Path:
    """A campaign with bags, by the command."""
    done = subprocess.run(
        [TAXINET, 'falsify', *words, '--sampler', 'random', '--engine', 'loop', '--audit', '0',
         '--images', 'none', '--out', out, '--quiet'], capture_output=True, text=True, check=False,
    )
    assert done.returncode in (0, 1), done.stderr
    return out


@pytest.fixture(scope='module')
def driven(tmp_path_factory) -> Path:
    """A real campaign of short runs with bags; some of them fail."""
    found = falsified(
        tmp_path_factory.mktemp('driven') / 'found', 's_falsif', '--runs', '3', '--seed', '2',
        '--perception', 'original', '--spec', 'near=always(abs(cte) <= 4)', '--set', 'duration=0.5',
    )
    outcomes = {row.outcome for row in read_ledger(found / 'ledger.jsonl').rows}
    assert outcomes == {PASS, FAIL}
    return found


@pytest.fixture(scope='module')
def proven(driven, tmp_path_factory) -> Path:
    """Evidence of it, with failed runs driven again."""
    out = tmp_path_factory.mktemp('proven') / 'evidence'
    content = tx.evidence(driven, out, requirement=REQUIREMENT, claim=0.5, localize_runs=1)
    assert content['localisations'][0]['path'] == 'localized/campaign-1'
    return out


def verified(folder, **options):
    return verify(VerifyOptions(folder=folder, **{'sample': 0, **options}))


def made(tmp_path, *outcomes, out='evidence', **options):
    folder = tmp_path / 'found'
    if not folder.exists():
        planted(folder, outcomes or (PASS, FAIL, PASS))
    tx.evidence(folder, tmp_path / out, **options)
    return tmp_path / out


def anew(folder):
    """Let the manifest agree with the files."""
    (folder / 'MANIFEST').write_text(manifest_text(folder), encoding='utf-8')


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


def test_given_the_page_then_it_refers_to_nothing_outside_and_claims_no_more_than_evidence(proven):
    page = (proven / 'evidence.html').read_text(encoding='utf-8')
    found = _Text(page)
    assert found.addresses
    assert all(re.match(r'#|data:', one) for one in found.addresses)
    text = ' '.join(found.words)
    assert 'Evidence toward REQ-7' in text
    content = json.loads((proven / 'evidence.json').read_text(encoding='utf-8'))
    for system in content['systems']:
        del system['program']['text']  # words of a program are its author's
    svg = (proven / 'argument.svg').read_text(encoding='utf-8')
    for words in (text, json.dumps(content), svg):
        assert not NEVER.search(words), NEVER.search(words)
    for limit in content['limits']:
        assert limit['words'].split('.')[0] in ' '.join(text.split())
    for item in content['items'].values():
        assert item['sha256'] is None or item['sha256'] in text


def test_given_a_folder_that_is_there_or_refused_inputs_then_nothing_is_written(tmp_path):
    made(tmp_path)
    with pytest.raises(UsageError, match='already exists'):
        made(tmp_path)
    with pytest.raises(UsageError, match='not judged'):
        made(tmp_path, out='other', spec='psi')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['evidence', 'found']


# Verification ------------------------------------------------------------------------------------


def test_given_evidence_of_real_runs_when_verified_then_all_holds_and_runs_repeat(proven):
    found = tx.verify_evidence(proven, sample=2, seed=1)
    assert found.holds, (found.damaged, found.different, found.unchecked)
    assert found.checked['files'] == 6  # with the trials and their summary
    assert found.checked['runs driven again, equal to the bit'] == 2
    assert found.checked['values computed again'] > 200
    assert found.notes == []


def test_given_any_byte_flipped_then_the_file_is_named(proven, tmp_path):
    chance = random.Random(5)
    for name in ('evidence.json', 'MANIFEST'):
        data = (proven / name).read_bytes()
        copy = tmp_path / 'copy'
        shutil.copytree(proven, copy)
        every = chance.sample(range(len(data)), 80)
        for at in every:
            flipped = bytearray(data)
            flipped[at] ^= 1 << chance.randrange(8)
            (copy / name).write_bytes(flipped)
            troubles = read_evidence(copy).troubles
            assert troubles, (name, at)
            assert any('MANIFEST' in line or name in line for line in troubles)
        shutil.rmtree(copy)


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


def test_given_a_file_added_then_it_is_named(tmp_path):
    out = made(tmp_path)
    (out / 'more.txt').write_text('x', encoding='utf-8')
    assert any('more.txt: is not listed' in line for line in verified(out).damaged)


def edited(folder, change):
    """Edit the values, with new checksums everywhere."""
    path = folder / 'evidence.json'
    values = json.loads(path.read_text(encoding='utf-8'))
    for key in ('seal', 'checksum'):
        del values[key]
    change(values)
    path.write_text(sealed_text(values), encoding='utf-8')
    anew(folder)


@pytest.mark.parametrize(('change', 'words'), [
    (lambda v: v['systems'][0]['figures']['formulas'][0]['satisfied'].update(rate=0.99),
     r'figures\.formulas\[phi\]\.satisfied\.rate: is 0\.99, of these inputs it is 0\.66'),
    (lambda v: v['limits'].pop(0), r'limits: has \d+ entries, of these inputs there are \d+'),
    (lambda v: v['systems'][0]['claim'].update(verdict='supported'), r'claim\.verdict: is '),
    (lambda v: v['argument']['nodes'][0].update(text='All is well'), r'nodes\[G1\]\.text: is '),
    (lambda v: v['items']['system-1/network'].update(sha256='0' * 64), r'network\.sha256: is '),
    (lambda v: v['campaigns'][0]['scenes'].update(sha256='0' * 64), r'scenes\.sha256: is '),
    (lambda v: v.update(extra=1), 'extra: is not of these inputs'),
    (lambda v: v['systems'][0].pop('odd'), r'systems\[system-1\]\.odd: is missing'),
    (lambda v: v.pop('campaigns'), 'a value is missing or of another form'),
    (lambda v: v.update(schema='taxinet-evidence-9'), 'is of schema'),
    (lambda v: v['requirement'].update(given='x'), 'expected an identifier'),
])
def test_given_an_edit_with_new_checksums_then_the_value_is_named(tmp_path, change, words):
    out = made(tmp_path, requirement=REQUIREMENT, claim=0.999)
    edited(out, change)
    found = verified(out)
    assert found.code == ExitCode.USAGE
    assert any(re.search(words, line) for line in found.damaged), found.damaged


@pytest.mark.parametrize('name', ['argument.svg', 'evidence.html'])
def test_given_an_edited_page_or_drawing_with_a_new_manifest_then_it_is_named(tmp_path, name):
    out = made(tmp_path)
    path = out / name
    text = path.read_text(encoding='utf-8')
    path.write_text(text.replace('Evidence toward', 'Proof of', 1), encoding='utf-8')
    anew(out)
    found = verified(out)
    assert found.code == ExitCode.USAGE
    assert any(f'{name}: is not the' in line for line in found.damaged)


def replaced(path, old, new):
    text = path.read_text(encoding='utf-8')
    assert old in text
    path.write_text(text.replace(old, new), encoding='utf-8')


@pytest.mark.parametrize('excuse', ['another version', 'another machine'])
def test_given_an_edited_page_with_an_excuse_then_it_is_unclear_and_never_holds(tmp_path, excuse):
    out = made(tmp_path)
    if excuse == 'another version':
        edited(out, lambda values: values['computed_by'].update(taxinet_ros='9.9'))
    else:
        replaced(out / 'evidence.html', 'This page was made on ', 'This page was made on a moon, ')
    replaced(out / 'evidence.html', 'Evidence toward', 'Proof of')
    anew(out)
    found = verified(out)
    assert any(excuse in line for line in found.unchecked), found
    assert not found.holds


def test_given_the_page_of_another_machine_then_it_is_compared_all_the_same(tmp_path):
    out = made(tmp_path)
    replaced(out / 'evidence.html', 'This page was made on ', 'This page was made on a moon, ')
    anew(out)
    found = verified(out)
    assert not found.damaged
    assert not any('evidence.html' in line for line in found.unchecked)


def test_given_a_campaign_of_run_then_the_hash_of_its_network_is_that_of_its_runs(tmp_path):
    done = subprocess.run(
        [TAXINET, 'run', 's_falsif', '--runs', '1', '--engine', 'loop', '--images', 'none',
         '--perception', 'original', '--set', 'duration=0.5', '--out', tmp_path / 'run', '--quiet'],
        capture_output=True, text=True, check=False,
    )
    assert done.returncode in (0, 1), done.stderr
    content = tx.evidence(tmp_path / 'run', tmp_path / 'evidence')
    sha256 = content['systems'][0]['network']['sha256']
    assert sha256 == read_ledger(tmp_path / 'run' / 'ledger.jsonl').rows[0].fingerprint
    assert len(sha256) == 64
    assert verified(tmp_path / 'evidence', sample=1).holds


@pytest.mark.parametrize('word', ['W' * 3900, 'a\x1bb', 'ill\ufffe'])
def test_given_any_text_then_the_drawing_is_xml(word):
    system = SystemArgument(text='a', contexts=(), parts=(Part(text='b', undeveloped='c'),))
    svg = argument_svg(build_argument(f'long {word}', [], [system], ('limits', 'limits')))
    texts = [one.text for one in ElementTree.fromstring(svg).iter() if one.tag.endswith('text')]
    assert any(text.startswith('long') for text in texts)


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


def test_given_everything_moved_together_then_all_is_found(tmp_path):
    (tmp_path / 'here').mkdir()
    made(tmp_path / 'here')
    (tmp_path / 'here').rename(tmp_path / 'there')
    assert not verified(tmp_path / 'there' / 'evidence').damaged


def test_given_a_campaign_that_went_on_since_then_it_is_named_as_changed(tmp_path):
    out = made(tmp_path)
    with Ledger(tmp_path / 'found' / 'ledger.jsonl') as ledger:
        ledger.intent(3, 'planted-s0-00003')
    found = verified(out)
    assert found.code == ExitCode.USAGE
    assert any('ledger.jsonl: has changed since the evidence was written' in line
               for line in found.damaged)


def test_given_no_bags_then_runs_are_unclear_and_not_said_to_repeat(tmp_path):
    found = verified(made(tmp_path), sample=3)
    assert found.code == ExitCode.INCOMPLETE
    assert any('no run has its bag here' in line for line in found.unchecked)


def test_given_a_perception_that_answers_by_chance_then_the_run_differs_with_code_4(tmp_path):
    eyes = tmp_path / 'eyes.py'
    eyes.write_text(
        'import os\n\n\ndef look(image):\n    return os.urandom(1)[0] / 255, 0.0\n',
        encoding='utf-8')
    found = falsified(
        tmp_path / 'found', 'nominal', '--runs', '1', '--perception', f'{eyes}:look',
        '--spec', 'near=always(abs(cte) <= 5)', '--set', 'duration=1',
    )
    tx.evidence(found, tmp_path / 'evidence')
    again = verified(tmp_path / 'evidence', sample=1)
    assert again.code == ExitCode.INFRA, (again.damaged, again.unchecked)
    assert 'driven again: ' in again.different[0]
    eyes.write_text(eyes.read_text(encoding='utf-8') + '# edited\n', encoding='utf-8')
    again = verified(tmp_path / 'evidence', sample=1)
    assert again.code == ExitCode.INCOMPLETE
    assert 'another SHA-256 than the network of the runs' in again.unchecked[0]


def test_given_a_folder_of_something_else_then_it_is_refused(tmp_path):
    for folder, words in ((tmp_path / 'nowhere', 'no such folder'), (tmp_path, 'no evidence')):
        with pytest.raises(UsageError, match=words):
            verified(folder)


def test_given_values_that_differ_then_each_place_is_named_once():
    told = {'a': [{'id': 'x', 'n': 1}, 2], 'b': True, 'c': 1}
    now = {'a': [{'id': 'x', 'n': 1.0}, 3], 'b': 1, 'd': None}
    assert list(value_differences(told, now)) == [
        'a[x].n: is 1, of these inputs it is 1.0', 'a[1]: is 2, of these inputs it is 3',
        'b: is True, of these inputs it is 1', 'c: is not of these inputs', 'd: is missing',
    ]
    assert list(value_differences(told, told)) == []


# Argument ----------------------------------------------------------------------------------------


def argument(proven) -> tuple[Argument, dict[str, str | None]]:
    content = read_evidence(proven).content
    found = argument_of(content['argument'])
    assert found.plain() == content['argument']
    return found, {name: one['sha256'] for name, one in content['items'].items()}


def test_given_the_argument_then_it_is_sound_and_its_solutions_have_hashes(proven):
    found, hashes = argument(proven)
    assert argument_faults(found, hashes) == []
    assert {one.kind for one in found.nodes} == set(Kind)
    solutions = [one for one in found.nodes if one.kind is Kind.SOLUTION]
    assert len(solutions) >= 4
    assert any(one.undeveloped for one in found.nodes)


def without(found, **change):
    return Argument(nodes=change.get('nodes', found.nodes), edges=change.get('edges', found.edges))


def test_given_an_unsound_argument_then_the_fault_is_named(proven):
    found, hashes = argument(proven)
    solution = next(one for one in found.nodes if one.kind is Kind.SOLUTION)
    above = next(edge.source for edge in found.edges if edge.target == solution.name)
    left = tuple(edge for edge in found.edges if edge.target != solution.name)
    loose = Node(name='G99', kind=Kind.GOAL, text='loose')
    for wrong, more, words in (
        (without(found, edges=left), hashes, f'{above}: is not supported and not undeveloped'),
        (without(found, edges=left), hashes, f'{solution.name}: is not below G1'),
        (found, {**hashes, solution.item: None}, f'{solution.name}: points at no item with a hash'),
        (without(found, nodes=(*found.nodes, loose)), hashes, 'G99: is not below G1'),
        (without(found, edges=(*found.edges, Edge(source='G2', target='G1', kind=SUPPORTED_BY))),
         hashes, 'an element supports itself'),
        (without(found, edges=(*found.edges, Edge(source='G1', target='G2', kind=IN_CONTEXT_OF))),
         hashes, 'G2: a goal cannot be InContextOf a goal'),
        (without(found, edges=(*found.edges, Edge(source='S1', target=solution.name,
                                                  kind=SUPPORTED_BY))),
         hashes, 'a solution cannot be SupportedBy a strategy'),
        (without(found, nodes=found.nodes[1:]), hashes, 'there is no top goal'),
    ):
        faults = argument_faults(wrong, more)
        assert any(words in line for line in faults), (words, faults)


def test_given_several_systems_then_no_two_elements_of_the_drawing_overlap(tmp_path):
    one = planted(tmp_path / 'a', [PASS, FAIL], seed=1)
    two = planted(tmp_path / 'b', [PASS] * 4, seed=2, perception='taxinet')
    three = planted(tmp_path / 'c', [PASS] * 4, seed=3, perception='taxinet')
    content = tx.evidence([one, two, three], tmp_path / 'evidence', requirement='R1: ' + 'x' * 300)
    found = argument_of(content['argument'])
    layout = _Layout(found)
    assert len(layout.boxes) == len(found.nodes)
    for number, box in enumerate(layout.boxes):
        assert box.x >= 0
        assert box.bottom <= layout.height
        for other in layout.boxes[number + 1:]:
            apart = (box.x + box.width <= other.x or other.x + other.width <= box.x
                     or box.bottom <= other.y or other.bottom <= box.y)
            assert apart, (box.node.name, other.node.name)
    light, dark = argument_svg(found), argument_svg(found, DARK)
    assert light != dark
    assert light.count('<circle') == sum(one.kind is Kind.SOLUTION for one in found.nodes)
    assert not re.search(r'href|url\(|<script', light)


def test_people9_given_a_requirement_without_an_identifier_then_no_bag_is_read_before_it_is_refused(
    tmp_path,
):
    with pytest.raises(UsageError, match='requirement stay on the line: expected an identifier'):
        tx.evidence(
            tmp_path / 'absent', requirement='stay on the line', out=tmp_path / 'evidence'
        )
