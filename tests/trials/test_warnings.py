"""What a campaign warns of: at its start, in its lines, in its record, when resumed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import falsify_samples as toy
import pytest

from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.verdict.run_statistics import ErrorStatistics, RunStatistics
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.overrides import doubtful_values
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.summary import (
    Summary,
    campaign_summary,
    circumstances,
    requirement_lines,
    row_line,
    scene_words,
)

VACUOUS = 'gentle=always(abs(steering) <= 0.3)'


@pytest.fixture(autouse=True)
def _toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)


def row(unusable: int, outcome: Outcome = Outcome.PASS, **changes: object) -> RunRow:
    request = RunRequest(
        run_id='run-3', index=3, program='nominal', seed=0, scenario=Scenario(**changes),  # type: ignore[arg-type]
        judging=Judging(specs=('phi_eventually',)), participants=(),
    )
    result = RunResult(
        outcome=outcome, last_seq=300, robustness=exact_intervals({'phi_eventually': 1.0}),
        wall_s=1.0,
        statistics=RunStatistics(
            max_cross_track_m=0.5, unusable_estimates=unusable,
            he_error=ErrorStatistics(mean=1e308, mean_abs=1e308, max_abs=1e308),
        ),
    )
    return RunRow.of_run(request, result, perception='truth', sim_s=30.0)


def test_people2_given_a_requirement_that_no_run_can_violate_then_it_is_told_and_on_record(
    tmp_path: Path,
) -> None:
    chosen = toy.options(tmp_path / 'a', runs=4, specs=('phi_eventually', VACUOUS))
    with toy.searching(chosen) as search:
        lines = [line.plain for line in requirement_lines(search.proposer.check)]
        quiet = [line.plain for line in requirement_lines(search.proposer.check, quiet=True)]
        facts = read_facts(tmp_path / 'a')
    assert lines[0].startswith('phi_eventually: within 1.5 m of the centreline from 10 s')
    assert lines[1].startswith('gentle: |steering| <= 0.3 rad (17.19 deg) all the time')
    assert quiet == lines[2:] == [f'warning: {text}' for text in facts['warnings']]
    assert 'eventually[0:10] ends at 10 s, after the run of 1 s' in quiet[0]
    assert quiet[1].startswith('warning: gentle: no run can violate it')


def test_t17_given_a_window_beyond_the_run_then_nothing_is_written(tmp_path: Path) -> None:
    chosen = toy.options(tmp_path / 'a', runs=4, specs=('far=always[35:40](cte < 1)',))
    with pytest.raises(UsageError, match='begins 35 s into the run, which lasts 1 s'):
        toy.finish(chosen)
    assert not (tmp_path / 'a').exists()


@pytest.mark.parametrize(
    ('overrides', 'warning'),
    [
        (
            {'rain_percent': '0.5'},
            'rain_percent=0.5 is 0.5 %, too little to see; for half write rain_percent=50',
        ),
        (
            {'time_of_day_h': '0.4'},
            'time_of_day_h=0.4 is 24 minutes past midnight; hours go to 24',
        ),
        (
            {'heading_deg': '0.17'},
            'heading_deg=0.17 is 0.17 degrees; 0.17 rad would be heading_deg=9.7',
        ),
        ({'heading_deg': '-1.5708'}, 'heading_deg=-1.5708 is -1.5708 degrees'),
    ],
)
def test_people2_given_a_value_that_looks_like_another_unit_when_fixed_then_it_warns(
    overrides: dict[str, str], warning: str
) -> None:
    (found,) = doubtful_values(overrides)
    assert found.startswith(warning)


def test_people2_given_values_as_people_set_them_then_nothing_is_warned_of() -> None:
    usual = {
        'rain_percent': ('0', '1', '50', '100'),
        'time_of_day_h': ('0', '1', '6.25', '9.5', '15', '24'),
        'heading_deg': ('0', '0.5', '-1', '1.5', '-20', '30', '0.0', '2.25'),
    }
    assert [doubtful_values({key: value}) for key in usual for value in usual[key]] == [
        [] for values in usual.values() for _ in values
    ]


def test_people2_given_rain_of_less_than_a_percent_when_told_then_it_is_not_zero() -> None:
    assert 'rain 0.5 %' in scene_words(row(0, clouds='broken', rain_fraction=0.005))
    assert 'rain 50 %' in scene_words(row(0, clouds='broken', rain_fraction=0.5))


def test_given_an_unusual_aircraft_when_told_then_the_line_names_it_and_the_camera() -> None:
    told = scene_words(row(0, aircraft='c172p', camera='strut'))
    assert told.endswith(', aircraft c172p, camera strut')
    assert 'caravan' not in scene_words(row(0))


def test_ros10_given_a_run_that_passed_blind_then_its_line_and_the_summary_say_so(
    tmp_path: Path,
) -> None:
    campaign = toy.options(tmp_path, runs=2).campaign
    blind, seeing = row(251), row(15)
    assert '251 of 301 estimates unusable' in row_line(blind).plain
    assert 'unusable' not in row_line(seeing).plain
    assert blind.passed_blind
    assert not seeing.passed_blind
    assert Summary([seeing]).blind_words() == []
    line = (
        'warning: 1 passed with more than 5% of their frames without a usable estimate (run 3); '
        'the formula usable fails them'
    )
    assert line in campaign_summary(Summary([blind, seeing]), campaign).splitlines()
    failed = dataclasses.replace(blind, outcome=Outcome.FAIL)
    assert not failed.passed_blind
    assert '251 of 301 estimates unusable' in row_line(failed).plain


def test_ros15_given_errors_that_overflow_in_degrees_then_the_row_is_finite() -> None:
    made = row(0)
    text = json.dumps(made.to_json(), allow_nan=False)
    assert RunRow.from_json(json.loads(text)) == made


def test_given_what_all_scenes_have_then_lines_of_runs_leave_it_out_and_fit_100_columns() -> None:
    made = row(0, clouds='stratus', rain_fraction=1.0, wind_speed_mps=8.0, camera='strut')
    shared = {'clouds': 'stratus', 'camera': 'strut'}
    assert circumstances(shared) == 'stratus, camera strut'
    line = row_line(made, shared).plain
    assert len(line) <= 100
    assert 'stratus' not in line
    assert 'rain 100 %' in line
    whole = row_line(dataclasses.replace(made, place='a_long_name@0123456789ab')).plain
    assert len(whole) == 100
    assert whole.endswith('…')
