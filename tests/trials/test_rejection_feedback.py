"""What a search tells its sampler of points that the requirements reject, where a program asks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import falsify_samples as toy
import pytest

from taxinet_ros.core.scenario import Scenario
from taxinet_ros.samplers.registry import SAMPLERS, make_sampler
from taxinet_ros.samplers.space import Dimension, Point
from taxinet_ros.scenes.source import Refused, SceneSource
from taxinet_ros.trials import search as search_module

SPACE = (Dimension(name='x'), Dimension(name='y'))
RHO_OF_REJECTED = {
    # Those that learn from results hear of a rejection as of a run with this robustness.
    'ce': 1.0, 'mab': 1.0, 'bo': 1.0, 'tpe': 1.0, 'cmaes': 1.0, 'active': 1.0,
}
PASSIVE = ('random', 'halton', 'sobol', 'grid', 'coverage', 'splitting', 'stress')


class Choosy(toy.ToySource):
    """A program that refuses half of its points."""

    def scene(self, index: int, point: Point | None = None, attempt: int = 0) -> Scenario:
        if point is not None and (point[0] or 0.0) < 0.5:
            raise Refused('choosy', 1)
        return super().scene(index, point, attempt)


@pytest.fixture
def _choosy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', Choosy)


def points(
    name: str, feedback: float | None, runs: int = 30, options: Mapping[str, str] | None = None
) -> list[object]:
    """Points of a sampler whose left half the requirements reject, and whose right half passes."""
    small = {'ce': {'every': '5'}, 'splitting': {'particles': '10', 'islands': '2'}}
    sampler = make_sampler(name, SPACE, 3, runs, **(options or small.get(name, {})))
    sampler.set_lag(1)
    found: list[object] = []
    for _ in range(runs):
        index, point = sampler.next()
        for _ in range(20):
            x = point[0]
            assert x is not None
            if x > 0.5:
                break
            point = sampler.again(feedback)
        found.append(point)
        sampler.tell(index, x - 0.2)
    return found


@pytest.mark.one_in(3)
@pytest.mark.parametrize('name', [
    pytest.param(name, marks=[pytest.mark.nightly] if name == 'bo' else [])  # half a minute
    for name in RHO_OF_REJECTED
])
def test_a_sampler_that_learns_hears_of_rejected_points(name: str) -> None:
    feedback = RHO_OF_REJECTED[name]
    told = points(name, feedback)
    assert told == points(name, feedback)
    assert told != points(name, None)


@pytest.mark.parametrize('name', PASSIVE)
def test_a_sampler_that_does_not_learn_from_rejections_chooses_as_without_them(name: str) -> None:
    assert points(name, 1.0) == points(name, None)
    assert not make_sampler(name, SPACE, 3, 30).hears_refusals


def test_the_two_lists_name_every_shipped_sampler() -> None:
    assert {*RHO_OF_REJECTED, *PASSIVE} == set(SAMPLERS)


def test_verifais_rule_does_not_learn_from_rejections_that_are_no_failures() -> None:
    """As in VerifAI, whose default feedback of 1 is 'positive so cross-entropy won't update'."""
    rule = {'rule': 'verifai'}
    assert points('ce', 1.0, options=rule) == points('ce', None, options=rule)
    assert points('ce', -1.0, options=rule) != points('ce', None, options=rule)


def test_a_rejected_point_is_a_pull_of_a_bandit() -> None:
    sampler = make_sampler('mab', SPACE, 3, 30)
    sampler.next()
    sampler.again(1.0)
    assert [pulls.sum() for pulls in sampler.sampler._pulls] == [2, 2]
    sampler.again()
    assert [pulls.sum() for pulls in sampler.sampler._pulls] == [2, 2]


@pytest.mark.nightly
@pytest.mark.usefixtures('_choosy')
@pytest.mark.parametrize('name', ['ce', 'active'])
def test_workers_and_resumptions_make_no_difference_with_feedback(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    toy.finish(toy.options(tmp_path / 'untold', sampler=name, runs=16))
    monkeypatch.setattr(Choosy, 'feedback', 1.0)
    one = toy.finish(toy.options(tmp_path / 'one', sampler=name, runs=16))
    assert sum(row.refused for row in one.rows) > 3
    toy.finish(toy.options(tmp_path / 'many', sampler=name, runs=16, workers=8), 8, toy.last)
    toy.same_table(tmp_path / 'one', tmp_path / 'many')
    with toy.searching(toy.options(tmp_path / 'killed', sampler=name, runs=16)) as search:
        for number, _ in enumerate(toy.answers(search, 3, toy.last)):
            if number == 8:
                break
    toy.finish(toy.options(tmp_path / 'killed', sampler=name, runs=16, resume=True))
    toy.same_table(tmp_path / 'one', tmp_path / 'killed')
    with pytest.raises(AssertionError):
        toy.same_table(tmp_path / 'one', tmp_path / 'untold')


@pytest.mark.usefixtures('_choosy')
def test_a_sampler_that_ignores_the_feedback_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Choosy, 'feedback', 1.0)
    for name, heard in (('halton', False), ('ce', True)):
        with toy.searching(toy.options(tmp_path / name, sampler=name)) as search:
            assert search.proposer.notes == (() if heard else (
                'externalSamplerRejectionFeedback has no effect on halton, which does not learn '
                'from refused points',
            ))


def test_the_feedback_of_a_program_is_read(tmp_path: Path) -> None:
    path = tmp_path / 'mine.scenic'
    path.write_text(
        'model runway_world\nparam externalSamplerRejectionFeedback = True\n'
        'ego = new Plane at (Range(0, 3), 400)\nrequire ego.cross_track_m < -1\n'
    )
    with SceneSource(path, seed=1) as source:
        assert source.feedback == 1.0
