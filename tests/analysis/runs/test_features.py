"""Every key of a scenario is a feature that failures may be explained by."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from taxinet_ros.analysis.runs.features import (
    ALL_FEATURES,
    BY_NAME,
    FAULT_FEATURES,
    PUSHING_FEATURES,
    SCENE_COLUMNS,
    feature_columns,
    scene_columns,
    varied,
)
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.scenario_fields import (
    DATAREFS,
    DURATION,
    FAULT_FIELDS,
    FAULT_SEED,
    GUST_SEED,
    PUSHING_FIELDS,
    SCENARIO_FIELDS,
    TRAFFIC,
)
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.trials.record.row import RunRow, scene_attributes
from taxinet_ros.trials.record.table import table

PUSHED = {
    'wind_speed_mps': 8.0, 'wind_direction_deg': 270.0, 'gust_mps': 2.0, 'gust_seed': 3.0,
    'runway_state': 'icy', 'slope_percent': -1.5, 'speed_mps': 3.0,
}


def runs(*scenes: dict[str, object]) -> pd.DataFrame:
    return table([
        RunRow(
            run_id=f'run-{index}', index=index, program='p', seed=0, perception='truth',
            outcome=Outcome.INFRA_ERROR, **scenario_from_human(scene).to_human(),
        ) for index, scene in enumerate(scenes)
    ])


FAILING = {
    'camera_dropout_percent': 10.0, 'camera_freeze_s': 2.0, 'lens_dirt_percent': 20.0,
    'lens_drops_percent': 10.0, 'glare_ghost_percent': 50.0, 'exposure_jump_ev': -2.0,
    'loop_delay_s': 0.2, 'loop_jitter_s': 0.3, 'steering_bias_deg': 3.0,
    'steering_rate_limit_degps': 8.0, 'fault_onset_s': 5.0, 'fault_seed': 3.0,
}


def test_given_the_rows_then_each_is_a_feature_but_length_seeds_traffic_and_datarefs():
    sources = {feature.source for feature in ALL_FEATURES}
    assert sources == {
        field.key for field in SCENARIO_FIELDS
        if field not in (DURATION, GUST_SEED, FAULT_SEED, TRAFFIC, DATAREFS)
    }


def test_given_runs_that_are_pushed_alike_then_no_feature_says_so():
    frame = feature_columns(runs(PUSHED, PUSHED))
    assert varied(frame) == ()
    assert frame['wind_direction_deg'].tolist() == [270.0, 270.0]
    assert frame['runway_state'].tolist() == ['icy', 'icy']


@pytest.mark.parametrize('feature', PUSHING_FEATURES, ids=lambda feature: feature.name)
def test_given_runs_that_one_thing_pushes_then_it_alone_is_left(feature):
    other = PUSHED | {feature.name: 'wet' if feature.name == 'runway_state' else 1.0}
    assert varied(feature_columns(runs(PUSHED, other))) == (feature,)


@pytest.mark.parametrize('feature', FAULT_FEATURES, ids=lambda feature: feature.name)
def test_given_runs_in_which_one_thing_fails_otherwise_then_it_alone_is_left(feature):
    other = FAILING | {feature.name: 1.0}
    assert varied(feature_columns(runs(FAILING, other))) == (feature,)


def test_given_a_table_of_before_when_read_then_nothing_pushed_or_failed():
    whole = runs({}, {})
    before = whole.drop(columns=[field.key for field in (*PUSHING_FIELDS, *FAULT_FIELDS)])
    frame = feature_columns(before)
    pd.testing.assert_frame_equal(frame, feature_columns(whole))
    for feature in (*PUSHING_FEATURES, *FAULT_FEATURES):
        if feature.numeric:
            assert frame[feature.name].dtype == np.float64, feature.name


def test_given_an_interval_then_it_reads_as_people_say_it():
    assert BY_NAME['wind_speed_mps'].interval_words(8.0, 12.5) == 'wind of 8.0 to 12.5 m/s'
    assert BY_NAME['slope_percent'].interval_words(None, -1.0) == (
        'slope below −1.0 %, uphill positive'
    )
    assert BY_NAME['gust_mps'].interval_words(2.0, None) == 'gusts above 2.0 m/s'
    assert BY_NAME['lens_dirt_percent'].interval_words(20.0, None) == (
        'dirt on the lens of 20 % or more'
    )


def test_given_control_points_that_all_runs_have_then_each_is_a_feature_and_tells_scenes_apart():
    scenes = [
        {'wind_speed@5': 3.0, 'runway_state@2': 'icy'},
        {'wind_speed@5': 9.0, 'runway_state@2': 'wet', 'wind_speed@form': 'cubic'},
    ]
    frame = table([
        RunRow(
            run_id=f'run-{index}', index=index, program='p', seed=0, perception='truth',
            outcome=Outcome.INFRA_ERROR, **scene_attributes(scenario_from_human(scene)),
        ) for index, scene in enumerate(scenes)
    ])
    features = feature_columns(frame)
    assert features['wind_speed_mps@5'].tolist() == [3.0, 9.0]
    assert [feature.name for feature in varied(features)] == ['wind_speed_mps@5', 'runway_state@2']
    wind, state = (BY_NAME[name] for name in ('wind_speed_mps@5', 'runway_state@2'))
    assert wind.interval_words(2.0, None) == 'wind above 2.0 m/s at 5 s'
    assert wind.axis == 'wind at 5 s [m/s]'
    assert state.kinds == BY_NAME['runway_state'].kinds
    # Nothing is said of what only some runs have; but their scenes differ.
    assert 'wind_speed_mps@form' not in features
    some = frame.assign(**{'wind_speed_mps@5': [3.0, np.nan], 'runway_state@2': ['icy', None]})
    assert not [name for name in feature_columns(some) if '@' in name]
    told = scene_columns(some)
    assert tuple(told.columns) == SCENE_COLUMNS
    assert told['signals'].nunique() == 2
    assert scene_columns(runs({}, {}))['signals'].tolist() == ['', '']
