"""A search that covers an ODD: what it records, says and refuses, with answers in any order."""

from __future__ import annotations

from pathlib import Path

import falsify_samples as toy
import pytest

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.odd.odd_file import Odd, read_odd
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.search import make_search
from taxinet_ros.trials.search_summary import search_summary

TEXT = """
name: toy
parameters:
  cross_track: {range: [-5, 5], unit: m, cells: 4}
  distance: {range: [0, 2], unit: km, cells: 4}
"""


@pytest.fixture(autouse=True)
def _toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)


@pytest.fixture
def odd(tmp_path) -> Odd:
    """16 pairs of cells, of which the toy program reaches 15: it refuses both quantiles high."""
    path = tmp_path / 'odd.yaml'
    path.write_text(TEXT)
    return read_odd(path)


def options(out: Path, odd: Odd, **changes):
    return toy.options(out, sampler='coverage', odd=odd, **{'runs': 15, **changes})


def test_given_an_odd_then_every_pair_in_reach_has_a_run_and_the_others_are_named(tmp_path, odd):
    search = toy.finish(options(tmp_path / 'out', odd))
    table = read_table(tmp_path / 'out')
    assert set(table['outcome']) == {'PASS', 'FAIL'}  # none is refused or rejected
    assert table['refused'].sum() == 0
    places = {odd.inside(scene) for scene in table.to_dict('records')}
    assert len(places) == 15
    assert None not in places
    said = '\n'.join(search_summary(search))
    assert 'ODD toy: 15 of 16 pairs of cells in a judged run' in said
    assert 'not reached by the program in ' in said
    assert 'looked at: 1 (cross track +2.5 to +5.0 m with distance 1500 to 2000 m)' in said


def test_given_broken_runs_then_their_pairs_are_run_again_and_count_only_when_judged(
    tmp_path, odd
):
    def judge(request):
        broken = request.index in (2, 5)
        return toy.result(request, Outcome.INFRA_ERROR if broken else None)

    search = toy.finish(options(tmp_path / 'out', odd, runs=20), judge=judge)
    lines = search_summary(search)
    places = [
        odd.inside(row.scene) for row in search.rows if row.outcome.judged
    ]
    assert len(places) == 18
    assert any(f'{len(set(places))} of 16 pairs of cells in a judged run' in one for one in lines)
    broken = [odd.inside(row.scene) for row in search.rows if not row.outcome.judged]
    assert set(broken) <= set(places), 'they have to be run again'


def test_given_workers_and_an_interruption_then_the_scenes_are_the_same(tmp_path, odd):
    toy.finish(options(tmp_path / 'whole', odd))
    with toy.searching(options(tmp_path / 'two', odd)) as search:
        for number, _ in enumerate(toy.answers(search, 3, toy.last)):
            if number == 6:
                break
    toy.finish(options(tmp_path / 'two', odd, resume=True), 2)
    toy.same_table(tmp_path / 'whole', tmp_path / 'two')
    assert read_facts(tmp_path / 'two')['odd']['name'] == 'toy'
    for other in (None, read_odd(write(tmp_path, TEXT.replace('cells: 4', 'cells: 3')))):
        with pytest.raises(UsageError, match=r'was begun with odd .*, not'):
            toy.finish(options(tmp_path / 'two', other, resume=True))


def write(folder: Path, text: str) -> Path:
    path = folder / 'other.yaml'
    path.write_text(text)
    return path


def test_given_options_without_effect_then_they_are_refused_by_name(tmp_path, odd):
    campaign = CampaignOptions(program='nominal', runs=3, seed=0, perception='truth',
                               out=tmp_path / 'out')
    def make(sampler, *sampler_options):
        return make_search(
            campaign, sampler=sampler, sampler_options=sampler_options, odd='s_falsif'
        )

    assert make('coverage', 'strength=3').odd.name == 's_falsif'
    for sampler in (None, 'random'):
        with pytest.raises(UsageError, match='odd s_falsif: has an effect on sampler coverage'):
            make(sampler)
    with pytest.raises(UsageError, match='cells: the cells are those of the ODD'):
        make('coverage', 'cells=3')
    with pytest.raises(UsageError, match='strength=3: the ODD toy has only 2 parameters'):
        toy.finish(options(tmp_path / 'out', odd, sampler_options={'strength': '3'}))
