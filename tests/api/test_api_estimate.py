"""``tx.estimate``: the estimate of the command line."""

from __future__ import annotations

import json

import pytest

import taxinet_ros as tx

SETTINGS = {'duration': 0.5}
SPECS = 'near=always(cte <= 7.5)'


@pytest.mark.nightly
def test_given_a_program_when_estimated_then_the_folder_tells_the_same_and_resumes_to_it(tmp_path):
    out = tmp_path / 'c'
    asked = {
        'perception': 'truth', 'settings': SETTINGS, 'specs': SPECS, 'runs': 160, 'islands': 4,
        'down_to': 0.1, 'out': out,
    }
    found = tx.estimate('s_falsif', **asked)
    told = json.loads((out / 'estimate.json').read_text())
    assert told['runs'] == found.runs == len(tx.open_campaign(out).rows) > 0
    assert (told['state'], told['low'], told['high']) == (found.state, found.low, found.high)
    assert 0 <= found.low <= found.high <= 1
    again = tx.estimate('s_falsif', **asked, resume=True)
    assert (again.low, again.high, again.runs) == (found.low, found.high, found.runs)


def test_an_estimate_that_ends_amid_its_draws_raises_and_claims_nothing(tmp_path, monkeypatch):
    # As after three broken runs in a row: none of the draws has ended.
    monkeypatch.setattr('taxinet_ros.api.search._execute', lambda search, led: None)
    with pytest.raises(tx.UsageError) as raised:
        tx.estimate('s_falsif', perception='truth', out=tmp_path / 'c')
    assert str(raised.value) == (
        '0 of 2,000 planned draws have ended: no interval before all have; resume it'
    )
    assert not (tmp_path / 'c' / 'estimate.json').exists()


@pytest.mark.parametrize(('asked', 'words'), [
    ({'down_to': 0.7}, 'down_to 0.7: needs to be within'),
    ({'runs': 10}, 'runs 10: too few to look for'),
    ({'perception': 'external'}, 'is a node of a graph, but this command'),
    ({'resume': True}, 'nothing to resume'),
])
def test_given_what_cannot_be_then_one_line_says_so_and_nothing_is_written(asked, words, tmp_path):
    with pytest.raises(tx.UsageError, match=words):
        tx.estimate('s_falsif', out=tmp_path / 'out', **asked)
    assert not (tmp_path / 'out').exists()
