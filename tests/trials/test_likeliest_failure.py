"""Adaptive stress testing as a search: refusals, the result, workers and resuming."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import falsify_samples as toy
import numpy as np
import pytest

from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.verdict.run_statistics import RunStatistics
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.space import Dimension, Point, Space
from taxinet_ros.samplers.stress import deviations
from taxinet_ros.scenes.search_space import Choice, Law, SearchSpace
from taxinet_ros.scenes.source import SceneSource
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.search_summary import search_summary
from taxinet_ros.trials.stress import check_likelihood, likeliest_failure

HEAD = 'model runway_world\nego = new Plane at (0, 400)\n'
BIASED = HEAD + """
first = Normal(0, 2)
param 'steering_bias_deg@2' = first
param 'steering_bias_deg@4' = 0.8 * first + Normal(0, 1.2)
param 'loop_delay_s@4' = abs(Normal(0, 0.1))
"""


def normal(name: str) -> Choice:
    return Choice(
        dimension=Dimension(name=name), feeds=frozenset({name}),
        law=Law(kind='Normal', mean=0.0, stddev=1.0),
    )


SPACE = SearchSpace(choices=(normal('x'), normal('y')))


class Normals(toy.ToySource):
    """A program with two normal choices, of which every scene is one."""

    def search_space(self) -> SearchSpace:
        return SPACE

    def space(self) -> Space:
        return SPACE.dimensions

    def scene(self, index: int, point: Point | None = None, attempt: int = 0) -> Scenario:
        x, y = deviations(point or (0.5, 0.5))
        return Scenario(cross_track_m=x, distance_m=1000 + 100 * y, duration_s=1.0)


def judged(request: RunRequest) -> RunResult:
    """Fails beyond 3 sigma, in the direction (0.6, 0.8)."""
    scenario = request.scenario
    rho = 3 - 0.6 * scenario.cross_track_m - 0.8 * (scenario.distance_m - 1000) / 100
    return RunResult(
        outcome=Outcome.PASS if rho > 0 else Outcome.FAIL, last_seq=10, wall_s=1.0,
        statistics=RunStatistics(max_cross_track_m=0.0),
        robustness=exact_intervals({'phi_eventually': rho}),
    )


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / 'mine.scenic'
        path.write_text(text)
        return path

    return write


@pytest.fixture
def _normals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', Normals)


@pytest.mark.usefixtures('_normals')
def test_given_a_known_likeliest_failure_then_the_summary_says_it(tmp_path: Path) -> None:
    search = toy.finish(toy.options(tmp_path / 'out', sampler='stress', runs=120), 1, judge=judged)
    found = likeliest_failure('stress', search.rows)
    assert found is not None
    assert found.row.outcome is Outcome.FAIL
    assert 3 <= found.sigma < 3.03
    assert found.log_likelihood == pytest.approx(-found.sigma**2 / 2)
    np.testing.assert_allclose(
        [found.deviations[name] for name in ('x', 'y')], [1.8, 2.4], atol=0.3)
    lines = search_summary(search, found)
    (at,) = (
        number for number, line in enumerate(lines)
        if line.startswith('likeliest failure found: ')
    )
    assert f'run {found.row.index}, 3.0' in lines[at]
    assert 'log-likelihood -4.5' in lines[at]
    assert '(-2.2' in lines[at]
    assert lines[at + 1].startswith('  in sigma: y +2.')
    assert json.loads(json.dumps(found.to_json()))['run_id'] == found.row.run_id


@pytest.mark.usefixtures('_normals')
def test_given_no_failure_or_another_sampler_then_there_is_none(tmp_path: Path) -> None:
    for name, runs in (('stress', 3), ('random', 60)):
        search = toy.finish(
            toy.options(tmp_path / name, sampler=name, runs=runs), 1, judge=judged)
        assert likeliest_failure(name, search.rows) is None


@pytest.mark.nightly
@pytest.mark.usefixtures('_normals')
def test_given_more_workers_or_an_interruption_then_the_search_is_the_same(tmp_path: Path) -> None:
    toy.finish(toy.options(tmp_path / 'one', sampler='stress', runs=60), 1, judge=judged)
    toy.finish(
        toy.options(tmp_path / 'many', sampler='stress', runs=60, workers=8), 8, toy.last, judged)
    toy.same_table(tmp_path / 'one', tmp_path / 'many')
    with toy.searching(toy.options(tmp_path / 'killed', sampler='stress', runs=60)) as search:
        for number, _ in enumerate(toy.answers(search, 3, toy.last, judged)):
            if number == 30:
                break
    toy.finish(
        toy.options(tmp_path / 'killed', sampler='stress', runs=60, resume=True), 1, judge=judged)
    toy.same_table(tmp_path / 'one', tmp_path / 'killed')


def test_given_a_choice_without_a_likelihood_when_searched_then_it_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)
    with pytest.raises(UsageError, match=r'stress: x is no Normal\(mean, stddev\)'):
        toy.finish(toy.options(tmp_path / 'out', sampler='stress'))


def test_given_disturbances_that_depend_on_normals_then_each_normal_is_one(write) -> None:
    with SceneSource(write(BIASED), seed=1) as source:
        space = source.search_space()
        check_likelihood('stress', space)
        assert len(space.searched) == 3
        point = source.space().point([0.5, 0.5, 0.5])
        assert all(value == 0 for value in source.scene(0, point).points.values())


@pytest.mark.parametrize(('text', 'said'), [
    ("param 'wind_speed@3' = Range(0, 9)", r'wind_speed@3 is no Normal.*set it$'),
    ("param 'steering_bias_deg@3' = TruncatedNormal(0, 2, -3, 3)", 'steering_bias_deg@3 is no'),
    ("param 'runway_state@3' = Uniform('icy', 'wet')", 'runway_state@3 is no Normal'),
    ('mutate ego', r'ego \(mutated\) is drawn, but not searched'),
])
def test_given_what_has_no_likelihood_then_it_is_refused_by_name(write, text, said) -> None:
    with SceneSource(write(BIASED + text), seed=1) as source:
        with pytest.raises(UsageError, match=said) as error:
            check_likelihood('stress', source.search_space())
        assert '\n' not in str(error.value)


def test_given_set_then_what_it_fixes_needs_no_likelihood(write) -> None:
    text = BIASED + "param 'wind_speed@3' = Range(0, 9)"
    with SceneSource(write(text), seed=1, overrides={'wind_speed@3': '4'}) as source:
        check_likelihood('stress', source.search_space())
    with (
        SceneSource(write(BIASED), seed=1, overrides={
            'steering_bias_deg@2': '1', 'steering_bias_deg@4': '1', 'loop_delay_s@4': '0',
        }) as source,
        pytest.raises(UsageError, match='the program draws no disturbance'),
    ):
        check_likelihood('stress', source.search_space())
