"""The shipped Scenic programs: where they are found, and what they draw."""

from __future__ import annotations

import math
import shutil
from collections import Counter
from pathlib import Path

import pytest
from scipy.stats import kstest

import taxinet_ros
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import (
    find_program,
    known_programs,
    shipped_folder,
)
from taxinet_ros.scenes.source import program_digest, sample_scenarios

N = 600


def draw(program: str | Path, n: int = N) -> list[Scenario]:
    scenes = sample_scenarios(program, seed=20, n=n)
    assert len(scenes) == n
    return scenes


def assert_share(count: int, expected: float, n: int = N) -> None:
    """Within five standard deviations of the binomial."""
    assert abs(count / n - expected) < 5 * math.sqrt(expected * (1 - expected) / n)


def assert_uniform(values: list[float], low: float, high: float) -> None:
    assert low <= min(values)
    assert max(values) <= high
    assert kstest(values, 'uniform', (low, high - low)).pvalue > 1e-6


@pytest.fixture(scope='module')
def falsification() -> list[Scenario]:
    return draw('s_falsif')


def test_given_s_falsif_when_drawn_then_a_third_is_wet_and_only_rain_clouds_rain(
    falsification: list[Scenario],
) -> None:
    wet = [scene for scene in falsification if scene.rain_fraction > 0]
    assert_share(len(wet), 1 / 3)
    assert {scene.clouds for scene in wet} == set(RAIN_CLOUDS)
    assert_uniform([scene.rain_fraction for scene in wet], 0.25, 1.0)
    dry = Counter(scene.clouds for scene in falsification if scene.rain_fraction == 0)
    assert set(dry) == set(CLOUDS)
    for kind in CLOUDS:
        assert_share(dry[kind], 1 / 6, dry.total())


def test_given_s_falsif_when_drawn_then_start_and_time_are_uniform(
    falsification: list[Scenario],
) -> None:
    assert_uniform([scene.time_of_day_s / 3600 for scene in falsification], 6, 18)
    assert_uniform([scene.cross_track_m for scene in falsification], -8, 8)
    assert_uniform([scene.distance_m for scene in falsification], 0, 2000)
    assert_uniform([math.degrees(scene.heading_rad) for scene in falsification], -30, 30)


@pytest.mark.nightly
def test_given_runway_position_when_drawn_then_the_ranges_have_the_weights_of_figure_8() -> None:
    scenes = draw('runway_position')
    for low, high, weight in ((0, 400, 0.35), (400, 1200, 0.1), (1200, 1600, 0.5),
                              (1600, 2000, 0.05)):
        inside = [scene.distance_m for scene in scenes if low <= scene.distance_m < high]
        assert_share(len(inside), weight)
        assert_uniform(inside, low, high)
    assert_share(sum(scene.rain_fraction > 0 for scene in scenes), 1 / 3)


def test_given_nominal_when_drawn_then_it_starts_on_the_line_in_fine_weather() -> None:
    scenes = draw('nominal', 200)
    assert_uniform([scene.cross_track_m for scene in scenes], -0.5, 0.5)
    assert_uniform([math.degrees(scene.heading_rad) for scene in scenes], -3, 3)
    assert_uniform([scene.time_of_day_s / 3600 for scene in scenes], 9.5, 11.5)
    assert {scene.clouds for scene in scenes} == {'clear', 'cirrus', 'scattered'}
    assert {scene.rain_fraction for scene in scenes} == {0}
    driven_m = 30 * 5
    assert all(scene.distance_m > 900 for scene in scenes)
    assert all(not 1350 - driven_m < scene.distance_m < 1550 for scene in scenes)


@pytest.mark.nightly
def test_given_training_original_when_drawn_then_its_gaps_are_gaps() -> None:
    scenes = draw('training_original', 300)
    assert_uniform([scene.cross_track_m for scene in scenes], -9, 9)
    assert_uniform([math.degrees(scene.heading_rad) for scene in scenes], -32, 32)
    assert_uniform([scene.time_of_day_s / 3600 for scene in scenes], 8.5, 12)
    assert {scene.clouds for scene in scenes} == {'clear', 'cirrus', 'scattered', 'overcast'}
    assert {scene.rain_fraction for scene in scenes} == {0}
    before = [scene.distance_m for scene in scenes if scene.distance_m <= 1300]
    after = [scene.distance_m for scene in scenes if scene.distance_m > 1300]
    assert_share(len(before), 13 / 21, 300)
    assert_uniform(before, 0, 1300)
    assert_uniform(after, 1600, 2400)


def test_given_an_installed_copy_when_drawn_then_scenes_and_digest_are_the_checkouts(
    tmp_path: Path, falsification: list[Scenario],
) -> None:
    installed = tmp_path / 'share' / 'taxinet_ros' / 'scenarios'
    shutil.copytree(shipped_folder(), installed)
    copy = installed / 's_falsif.scenic'
    assert draw(copy, 5) == falsification[:5]
    assert program_digest(copy) == program_digest(find_program('s_falsif'))


def test_given_no_checkout_when_a_word_is_sought_then_the_installed_copies_are_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenarios = shipped_folder()
    package = tmp_path / 'a' / 'lib' / 'python3' / 'site-packages' / 'taxinet_ros'
    monkeypatch.setattr(taxinet_ros, '__file__', str(package / '__init__.py'))
    monkeypatch.setattr('sys.prefix', str(tmp_path / 'nowhere'))
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    with pytest.raises(UsageError, match='AMENT_PREFIX_PATH'):
        find_program('s_falsif')
    beside = tmp_path / 'a' / 'share' / 'taxinet_ros' / 'scenarios'
    shutil.copytree(scenarios, beside)
    assert find_program('s_falsif') == beside / 's_falsif.scenic'
    sourced = tmp_path / 'b' / 'share' / 'taxinet_ros' / 'scenarios'
    shutil.copytree(scenarios, sourced)
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/none:{tmp_path / "b"}')
    assert find_program('s_falsif') == sourced / 's_falsif.scenic'


@pytest.mark.parametrize('word', ['s_fallsif', 'runway_world', 'nowhere/s_falsif.scenic', '.'])
def test_given_an_unknown_word_when_sought_then_the_known_ones_are_listed(word: str) -> None:
    with pytest.raises(UsageError) as caught:
        find_program(word)
    assert 'known: anywhere, crossing, halton_time_of_day, hold_short, nominal' in str(caught.value)
    assert '\n' not in str(caught.value)


def test_given_a_file_of_another_kind_when_sought_then_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'x.py').write_text('')
    with pytest.raises(UsageError, match=r'not a \.scenic file'):
        find_program(tmp_path / 'x.py')


def test_given_the_shipped_folder_when_listed_then_every_program_is_known() -> None:
    assert known_programs() == (
        'anywhere', 'crossing', 'halton_time_of_day', 'hold_short', 'nominal', 'runway_position',
        's_falsif', 's_falsif_ce', 'training_crossing', 'training_full', 'training_original',
    )
