"""A search on a graph that was there before it: names of attempts, and whose perception it is."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import falsify_samples as toy
import pytest

from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.search import Search


@pytest.fixture(autouse=True)
def _toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)


def standing(out: Path, **changes):
    return toy.options(out, perception='', **changes)


def answered(word: str, fingerprint: str = ''):
    """Results of a graph with a certain perception."""
    def judge(request: RunRequest) -> RunResult:
        return dataclasses.replace(toy.result(request), perception=word, fingerprint=fingerprint)

    return judge


def begin(search: Engine[Search]) -> RunRequest:
    request = search.next()
    assert request is not None
    return request


def test_given_a_standing_graph_then_the_runs_are_those_of_any_other_and_their_perception_is_its(
    tmp_path,
):
    out = tmp_path / 'c'
    toy.finish(toy.options(tmp_path / 'own', perception='truth'))
    toy.finish(standing(out), judge=answered('truth'))
    named = ['run_id', 'bag', 'perception', 'wall_s', 'real_time_factor']
    own, table = (read_table(folder).drop(columns=named) for folder in (tmp_path / 'own', out))
    assert len(table) == 20
    assert table.equals(own)
    judged = read_table(out).query('outcome != "REJECTED"')
    assert set(judged['perception']) == {'truth'}


def test_given_answers_then_what_was_asked_names_the_perception_from_the_first_one_on(tmp_path):
    with Engine(standing(tmp_path / 'c'), ('perception',)) as search:
        assert search.perception == ''
        assert read_facts(tmp_path / 'c')['perception'] == ''
        request = begin(search)
        search.take(request, answered('original', 'abc')(request))
        assert search.perception == 'original'
    assert read_facts(tmp_path / 'c')['perception'] == 'original'
    assert read_facts(tmp_path / 'c')['perception_sha256'] == 'abc'


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ('before', 'after', 'words'),
    [
        (('original', 'a' * 64), ('taxinet', 'b' * 64), 'original (sha256 aaaaaaaaaaaa…), but '
         'the graph has taxinet (sha256 bbbbbbbbbbbb…)'),
        (('truth', ''), ('taxinet', 'b' * 64), 'perception truth, but the graph has taxinet'),
        (('weights', 'a' * 64), ('truth', ''), 'but the graph has truth;'),
    ],
)
@pytest.mark.parametrize('resumed', [False, True])
def test_given_an_answer_of_another_perception_then_it_is_refused_and_not_kept(
    before, after, words, resumed, tmp_path
):
    out = tmp_path / 'c'
    with Engine(standing(out), ('perception',)) as search:
        first = begin(search)
        search.take(first, answered(*before)(first))
        if not resumed:
            second = begin(search)
            with pytest.raises(UsageError) as caught:
                search.take(second, answered(*after)(second))
    if resumed:
        with Engine(standing(out, resume=True), ('perception',)) as search:
            second = begin(search)
            with pytest.raises(UsageError) as caught:
                search.take(second, answered(*after)(second))
    assert words in str(caught.value)
    assert '\n' not in str(caught.value)
    assert (first.index, second.index) == (0, 1)
    assert list(read_table(out)['index']) == [0]
    assert read_facts(out)['perception'] == before[0]
    with Engine(standing(out, resume=True), ('perception',)) as search:
        third = begin(search)
        assert third.run_id == f'{second.run_id}.2'
        search.take(third, answered(*before)(third))
        assert [row.index for row in search.rows] == [0, 1]


def test_given_the_same_network_by_another_name_then_it_is_the_same(tmp_path):
    with Engine(standing(tmp_path / 'c'), ('perception',)) as search:
        for word in ('original', 'weights'):
            request = begin(search)
            search.take(request, answered(word, 'abc')(request))
        assert len(search.rows) == 2


def test_given_broken_and_interrupted_runs_then_every_attempt_has_a_name_of_its_own(tmp_path):
    out = tmp_path / 'c'
    names = []
    with Engine(standing(out), ('perception',)) as search:
        for outcome in (Outcome.INFRA_ERROR, Outcome.INTERRUPTED):
            request = begin(search)
            names.append(request.run_id)
            search.take(request, toy.result(request, outcome))
    with Engine(standing(out, resume=True), ('perception',)) as search:
        request = begin(search)
        names.append(request.run_id)
        search.take(request, answered('truth')(request))
    assert names == ['c-00000', 'c-00000.2', 'c-00000.3']
    assert list(read_table(out)['run_id']) == names[2:]
