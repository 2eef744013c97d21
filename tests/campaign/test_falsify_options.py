"""What a person may ask of a search."""

from __future__ import annotations

from pathlib import Path

import pytest

from taxinet_ros.campaign.options import make_options
from taxinet_ros.campaign.search_options import SearchOptions, make_search_options
from taxinet_ros.campaign.stop_rule import StopRule
from taxinet_ros.core.errors import UsageError


def ask(folder: Path, **changes) -> SearchOptions:
    names = ('out', 'images', 'resume')
    campaign = {
        'program': 'nominal', 'runs': 5, 'seed': 1, 'perception': 'truth', 'settings': (),
        'specs': (), 'out': folder / 'c', 'processes': False,
        **{name: changes[name] for name in names if name in changes},
    }
    own = {
        'sampler': 'ce', 'sampler_options': (), 'workers': 1, 'resume': False, 'until': None,
        'budget_min': None,
        **{name: value for name, value in changes.items() if name not in ('out', 'images')},
    }
    return make_search_options(make_options(**campaign), **own)


def test_given_wishes_then_they_are_in_the_options(tmp_path):
    asked = ask(
        tmp_path, sampler_options=['floor=0.2', 'every=5'], workers=8, until='half-width=0.02',
        budget_min=2.5, images='none',
    )
    assert asked.sampler_options == {'floor': '0.2', 'every': '5'}
    assert asked.workers == 8
    assert asked.stop == StopRule(kind='half-width', value=0.02)
    assert asked.budget_s == 150
    assert asked.campaign.images == 'none'


BAD = {
    'no value': ({'sampler_options': ['every']}, 'expected key=value'),
    'no worker': ({'workers': 0}, '--workers 0: needs to be within 1..8'),
    'too many workers': ({'workers': 9}, '--workers 9: needs to be within 1..8'),
    'no budget': ({'budget_min': 0.0}, '--budget 0: needs to be above 0'),
    'budget that is none': ({'budget_min': float('nan')}, '--budget nan'),
    'unknown rule': ({'until': 'bored'}, '--until bored: expected failures=K'),
    'unknown images': ({'images': 'some'}, '--images some: unknown; known: all, failures, none'),
    'resume of nowhere': ({'resume': True, 'out': None}, '--resume: say with --out'),
}


@pytest.mark.parametrize('case', BAD)
def test_given_a_mistake_then_one_line_says_what(case, tmp_path):
    changes, expected = BAD[case]
    with pytest.raises(UsageError) as caught:
        ask(tmp_path, **changes)
    assert expected in str(caught.value)
    assert '\n' not in str(caught.value)
