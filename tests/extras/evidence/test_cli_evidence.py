"""``taxinet evidence``: exit codes, refusals in one line."""

from __future__ import annotations

import json

import pytest
from planted_evidence import FAIL, PASS, planted


@pytest.mark.one_in(2)
@pytest.mark.parametrize(('outcomes', 'claim', 'code'), [
    ([PASS] * 10 + [FAIL] * 10, '99%', 1), ([PASS] * 10, '0.99', 3), ([PASS] * 10, '50 %', 0),
    ([PASS] * 10 + [FAIL] * 10, None, 0),
])
def test_given_a_claim_then_the_code_says_what_became_of_it(
    taxinet, tmp_path, outcomes, claim, code
):
    planted(tmp_path / 'found', outcomes)
    words = () if claim is None else ('--claim', claim)
    found, out, _ = taxinet('evidence', 'write', 'found', *words, '--out', 'evidence')
    assert found == code
    assert 'known limits' in out
    assert 'next: taxinet evidence verify evidence' in out
    assert '\n' not in out.strip().splitlines()[-1]


@pytest.mark.nightly
def test_given_other_names_and_options_first_then_it_is_the_same(taxinet, tmp_path):
    planted(tmp_path / 'found', [PASS, FAIL])
    assert taxinet('evidence', 'write', 'found', '--out', 'one')[0] == 0
    assert taxinet('evidence', 'write', '--out', 'two', 'found')[0] == 0
    assert (tmp_path / 'one' / 'MANIFEST').read_bytes() == (
        tmp_path / 'two' / 'MANIFEST').read_bytes()
    code, out, _ = taxinet('evidence', 'write', 'found', '--out', 'three', '--json')
    assert code == 0
    assert json.loads(out)['schema'] == 'taxinet-evidence-3'


def test_given_evidence_then_verify_says_what_holds_and_what_does_not(taxinet, tmp_path):
    planted(tmp_path / 'found', [PASS, FAIL])
    taxinet('evidence', 'write', 'found', '--out', 'evidence')
    code, out, err = taxinet('evidence', 'verify', 'evidence', '--sample', '0')
    assert (code, err) == (0, '')
    assert 'note    no run was driven again, as asked by sample 0' in out
    assert out.rstrip().endswith('all holds')
    code, out, _ = taxinet('evidence', 'verify', 'evidence', '--json')
    assert code == 3  # without bags no run can be driven again
    assert json.loads(out)['holds'] is False
    path = tmp_path / 'evidence' / 'argument.mmd'
    path.write_bytes(path.read_bytes() + b' ')
    code, out, err = taxinet('evidence', 'verify', 'evidence', '--sample', '0')
    assert code == 2
    assert 'BAD     evidence/argument.mmd: is not the file that MANIFEST lists' in out
    assert err.startswith('taxinet: error: evidence: evidence does not hold: ')
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(('words', 'complaint'), [
    (['write', 'found', '--out', 'found'], 'out found: already exists'),
    (['write', 'found', '--out', 'e', '--claim', 'all'], 'claim all: expected a share'),
    (['write', 'found', '--out', 'e', '--claim', '100%'], 'no number of runs shows 100 %'),
])
def test_given_wrong_words_then_one_line_and_code_2(taxinet, tmp_path, words, complaint):
    planted(tmp_path / 'found', [PASS])
    code, out, err = taxinet('evidence', *words)
    assert (code, out) == (2, '')
    assert complaint in err
    assert len(err.splitlines()) == 1
