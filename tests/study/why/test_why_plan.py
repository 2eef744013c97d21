"""What the stages are asked to do: the budget, and experiments that change what is suspected."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.analysis.causes.region import Interval, Kinds, Region
from taxinet_ros.core.pacing.timing import parse_latency
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import KMWH
from taxinet_ros.scenes.source import SceneSource
from taxinet_ros.study.why.plan import (
    LEAST_BUDGET,
    Budget,
    Change,
    arms_of,
    blamed_change,
    experiment_text,
    near_program,
    region_change,
    trained_change,
    why_no_experiment,
)
from taxinet_ros.trials.experiment import read_experiment
from taxinet_ros.trials.run_command import RunSettings


@given(st.integers(LEAST_BUDGET, 5000), st.integers(1, 9))
def test_all_stages_together_make_about_as_many_runs_as_asked(runs, arms):
    budget = Budget(runs=runs)
    made = 4 * budget.localized + budget.shrunk + arms * budget.scenes(arms)
    # The least numbers that say anything are not gone below.
    assert made <= max(runs, 8 + budget.shrunk + 2 * arms)
    assert budget.localized >= 2
    assert budget.scenes(arms) >= 2


def test_too_small_a_budget_is_refused():
    with pytest.raises(UsageError, match=f'budget 5: needs to be {LEAST_BUDGET} or more'):
        Budget(runs=5)


def test_given_what_an_explanation_blames_then_the_experiment_changes_just_that():
    wet = Scenario(clouds='stratus', rain_fraction=0.9)
    assert blamed_change(wet, 'crossing') == Change(
        words='without the crossing', values={'crossing': False})
    assert blamed_change(wet, 'rain').values == {'rain_percent': 0.0}
    # A clear sky cannot rain, also where this scene is dry and another of the cause is not.
    assert blamed_change(Scenario(clouds='stratus'), 'clear').values == {
        'clouds': 'clear', 'rain_percent': 0.0}
    assert blamed_change(Scenario(crossing=False), 'crossing') is None
    # Scenes keep their control points: each takes the value at the start.
    gusty = Scenario(wind_speed_mps=2.0, **{'wind_speed_mps@5': 9.0, 'runway_state@3': 'icy'})
    assert blamed_change(gusty, 'wind').values == {'wind_speed_mps': 0.0, 'wind_speed_mps@5': 0.0}
    assert blamed_change(gusty, 'wind_speed_mps@').values == {'wind_speed_mps@5': 2.0}
    assert blamed_change(gusty, 'friction').values == {'runway_state@3': 'dry'}


def test_given_a_region_then_the_change_takes_scenes_out_of_it():
    wet = Interval(feature='rain_percent', low=37.0, high=None)
    early = Interval(feature='time_of_day_h', low=None, high=6.25)
    assert region_change(Region(parts=(wet, early))) == Change(
        words='dry, at 10:00', values={'rain_percent': 0.0, 'time_of_day_h': 10.0})
    dark = Kinds(feature='clouds', kinds=('overcast', 'stratus'))
    assert region_change(Region(parts=(dark,))).values == {'clouds': 'clear', 'rain_percent': 0.0}
    place = Interval(feature='distance_m', low=1180.0, high=1460.0)
    assert region_change(Region(parts=(place,))) is None
    gust = Interval(feature='wind_speed_mps@5', low=9.0, high=None)
    assert region_change(Region(parts=(gust,))) == Change(
        words='without wind at 5 s', values={'wind_speed_mps@5': 0.0})
    late = Interval(feature='gnss_dropout_start_s', low=6.0, high=9.0)
    left = Interval(feature='gnss_bias_m', low=None, high=0.5)
    silent = Interval(feature='gnss_dropout_s', low=8.8, high=14.5)
    assert region_change(Region(parts=(late, left, silent))) == Change(
        words='without GNSS drop-out, without GNSS offset to the left',
        values={'gnss_dropout_s': 0.0, 'gnss_bias_m': 0.0})


def test_given_scenes_outside_a_networks_training_then_the_change_takes_them_into_it():
    domain = {'clouds': ('cirrus', 'clear'), 'rain_percent': (0.0, 0.0)}
    dry, wet = Scenario(clouds='stratus'), Scenario(clouds='stratus', rain_fraction=0.9)
    change = trained_change(domain, [dry.to_human(), wet.to_human()])
    assert change.values == {'clouds': 'clear', 'rain_percent': 0.0}
    # The usual hour is outside of it, so the middle is taken.
    early = {'time_of_day_h': (7.0, 9.0)}
    assert trained_change(early, [dry.to_human()]) == Change(
        words='in weather and light of its training (time of day 08:00)',
        values={'time_of_day_h': 8.0})
    assert trained_change(early, [Scenario(time_of_day_s=8 * 3600.0).to_human()]) is None
    assert trained_change(None, [wet.to_human()]) is None
    rainy = {'clouds': ('stratus', 'clear'), 'rain_percent': (50.0, 90.0)}
    assert trained_change(rainy, [dry.to_human()]) is None


def test_the_experiments_file_is_one_that_taxinet_experiment_reads(tmp_path):
    path = tmp_path / 'confirm-1.yaml'
    change = Change(words='without the crossing', values={'crossing': False})
    settings = RunSettings(
        perception='original', gains={'heading_gain': 1.2}, values={'clouds': 'clear'})
    path.write_text(experiment_text(
        settings, program='s_falsif', seed=7, change=change, runs=12))
    read = read_experiment(path)
    assert (read.runs, read.seed, read.compare_to) == (12, 7, 'recorded')
    recorded, changed, truth = read.arms
    assert (recorded.name, recorded.perception, recorded.gains) == (
        'recorded', 'original', {'heading_gain': 1.2})
    assert (changed.name, changed.laid_over) == ('without_the_crossing', {'crossing': 'off'})
    assert (truth.perception, truth.laid_over) == ('truth', {})
    assert arms_of(change, 'original') == 3
    assert arms_of(None, 'truth') == 1


def test_settings_that_an_experiment_lacks_are_named_not_dropped():
    assert why_no_experiment(RunSettings(perception='original'), KMWH) == ''
    late = RunSettings(perception='original', timing=parse_latency(['perception=0.2']))
    assert 'latencies' in why_no_experiment(late, KMWH)
    assert 'world other' in why_no_experiment(RunSettings(perception='o', world='other'), KMWH)


def test_scenes_near_a_run_start_near_it_and_are_alike_otherwise(tmp_path):
    run = Scenario(
        cross_track_m=2.25, distance_m=1425.0, heading_rad=-0.1, clouds='scattered',
        time_of_day_s=17.66 * 3600)
    path = tmp_path / 'near.scenic'
    path.write_text(near_program(run, 'r53'))
    with SceneSource(str(path), seed=3) as source:
        scenes = [source.scene(index) for index in range(6)]
    assert len({scene.distance_m for scene in scenes}) == 6
    for scene in scenes:
        assert abs(scene.cross_track_m - run.cross_track_m) <= 0.5
        assert abs(scene.distance_m - run.distance_m) <= 20
        assert abs(scene.heading_rad - run.heading_rad) <= 0.035
        assert scene.clouds == run.clouds
        assert scene.time_of_day_s == pytest.approx(run.time_of_day_s)
