"""Forecasts of recorded runs: what they know, of whom they hold, and that live is as recorded."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
import sys

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.analysis.report import pictures as picture_files
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.cli.main import main
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.forecast.forecast import (
    FEATURES,
    Progress,
    Sample,
    bounds_at_moments,
    calibrate,
    coverage,
    outside_of_run,
    read_forecast,
    read_forecast_runs,
    samples_of,
    write_forecast,
)
from taxinet_ros.files.sealed_json import write_sealed
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign

# Starts at 1 to 2.4 m, three of four of which come back soon enough; truth, so that it is quick.
PROGRAM = """model runway_world
param clouds = 'clear'
param rain_percent = 0
ego = new Plane at (Range(-2.4, 2.4), Range(400, 900)), facing Range(-10, 10) deg
"""
WORDS = (
    '--sampler', 'random', '--perception', 'truth', '--set', 'duration_s=3', '--set',
    'shadows=off', '--spec', 'near=always[2:3](abs(cte) <= 1)', '--engine', 'loop', '--audit', '0',
    '--images', 'none', '--quiet',
)


@pytest.fixture(scope='module')
def program(tmp_path_factory):
    path = tmp_path_factory.mktemp('program') / 'starts.scenic'
    path.write_text(PROGRAM)
    return path


@pytest.fixture(scope='module')
def folders(program, tmp_path_factory):
    """A campaign to calibrate on, and one with another seed."""
    root = tmp_path_factory.mktemp('campaigns')
    for name, seed, runs in (('cal', 1, 40), ('other', 2, 20)):
        words = ('taxinet', 'falsify', program, *WORDS, '--runs', runs, '--seed', seed, '--out',
                 root / name)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, 'argv', [*map(str, words)])
            with pytest.raises(SystemExit) as end:
                main()
        assert end.value.code == 1  # some start too far out
    return root


@pytest.fixture(scope='module')
def forecast(folders):
    return calibrate(open_campaign(folders / 'cal'), every_s=0.5)


@pytest.fixture(scope='module')
def others(folders, forecast):
    return read_forecast_runs(open_campaign(folders / 'other'), 'near', forecast.every_steps)


def sample(**changes) -> Sample:
    return Sample(**{
        'cte_m': 1.0, 'he_rad': 0.1, 'distance_m': 500.0, 'est_cte_m': 1.2, 'rho_lower': -math.inf,
        'rho_upper': 0.5, **changes,
    })


@pytest.mark.nightly
def test_given_a_campaign_then_both_outcomes_are_in_it(forecast, others):
    assert forecast.model.calibration_runs == 20
    assert forecast.model.moments == 7
    assert 0.1 < np.mean(others.outcomes > 0) < 0.9
    assert others.features.shape == (20, 7, len(FEATURES))


def test_given_new_runs_then_bounds_hold_about_as_often_as_promised_and_never_fall(
    forecast, others
):
    found = coverage(forecast, others, 0.9)
    # 20 runs and one calibration of 20: below 70 % is rare.
    assert found.held.rate >= 0.7
    bounds = bounds_at_moments(forecast, others, 0.9)
    assert (bounds <= others.certain[..., 1]).all()
    # It knows something: at the last moment all, before it more than the monitor.
    assert (bounds[:, -1] == others.outcomes).all()
    assert np.median(bounds[:, -2] - others.certain[:, -2, 0]) > 0.1
    falls = np.diff(np.minimum(bounds, others.certain[..., 1].min(axis=1)[:, None]), axis=1)
    assert (falls >= 0).all()


def test_given_runs_that_violate_another_requirement_then_they_count_as_satisfied(
    forecast, others
):
    failed = tuple(dataclasses.replace(row, outcome=tx.Outcome.FAIL) for row in others.rows)
    again = dataclasses.replace(others, rows=failed)
    assert coverage(forecast, again, 0.9) == coverage(forecast, others, 0.9)


def test_given_a_run_watched_live_then_its_bounds_are_those_of_its_bag(folders, forecast, others):
    row = others.rows[3]
    recording = open_recording(folders / 'other' / row.run_id)
    live = forecast.watch(confidence=0.9)
    watched = [live.update(**one._asdict()) for one in samples_of(recording, 'near')]
    assert watched == forecast.bounds_of(recording, confidence=0.9)
    assert len(watched) == 31
    all_at_once = bounds_at_moments(forecast, others, 0.9)[3]
    assert [one.lower for one in watched[::5]] == all_at_once.tolist()
    half = forecast.bounds_of(recording, confidence=0.9, until_s=1.5)
    assert half == watched[:16]
    with pytest.raises(UsageError, match='after the end of the runs calibrated on, 3 s'):
        live.update(**sample()._asdict())


def test_given_a_file_then_it_is_the_same_forecast_and_damage_is_named(
    folders, forecast, others, tmp_path
):
    path = tmp_path / 'near.json'
    write_forecast(path, forecast)
    again = tx.load_forecast(path)
    assert again.population == forecast.population
    assert (
        bounds_at_moments(again, others, 0.9)
        == bounds_at_moments(forecast, others, 0.9)
    ).all()
    path.write_bytes(path.read_bytes().replace(b'"near"', b'"nEar"', 1))
    with pytest.raises(UsageError, match='damaged or edited'):
        read_forecast(path)
    other = tmp_path / 'other.json'
    write_sealed(other, {'of': 'something else'})
    with pytest.raises(UsageError, match='not a forecast of this version'):
        read_forecast(other)


def test_given_runs_of_others_then_they_are_outside_the_guarantee_by_name(
    folders, forecast, others, tmp_path
):
    campaign = open_campaign(folders / 'other')
    bag = folders / 'other' / others.rows[0].run_id
    assert outside_of_run(forecast, open_recording(bag), campaign) == []
    own = folders / 'cal' / sorted(forecast.runs)[0]
    (why,) = outside_of_run(forecast, open_recording(own), open_campaign(folders / 'cal'))
    assert why == 'this run was used for the calibration'
    alone = tmp_path / bag.name
    shutil.copytree(bag, alone)
    (why,) = outside_of_run(forecast, open_recording(alone), None)
    assert why.startswith('no campaign beside it')
    other = dataclasses.replace(campaign, content=dataclasses.replace(
        campaign.content, facts={**campaign.facts, 'perception_sha256': 'a' * 64}))
    (why,) = outside_of_run(forecast, open_recording(bag), other)
    assert why.startswith('perception sha256 aaaaaaaaaaaaaaaa, calibrated on truth')
    changed = {'program': 'x', 'settings': 'rain_percent=80', 'perception': 'y'}
    listed = forecast.outside({**forecast.population, **changed})
    assert [one.split()[0] for one in listed] == list(changed)


def test_given_another_sampler_then_its_runs_are_outside(folders, forecast, others):
    campaign = open_campaign(folders / 'other')
    rows = [dataclasses.replace(row, sampler='ce', drawn=False) for row in campaign.rows]
    searched = dataclasses.replace(campaign, content=dataclasses.replace(
        campaign.content, rows=tuple(rows),
        facts={**campaign.facts, 'sampler': 'ce'},
    ))
    bag = open_recording(folders / 'other' / rows[0].run_id)
    assert outside_of_run(forecast, bag, searched) == [
        'chosen by the sampler ce, not drawn by the program itself'
    ]
    with pytest.raises(UsageError, match='drew none of its 20 judged runs'):
        calibrate(searched)


@pytest.mark.parametrize(('changes', 'words'), [
    ({'every_s': 0.25}, 'every 0.25: needs to be a multiple of 0.1 s'),
    ({'spec': 'far'}, 'no final robustness of far'),
])
def test_given_what_cannot_be_calibrated_then_it_is_refused_by_name(folders, changes, words):
    with pytest.raises(UsageError) as refused:
        calibrate(open_campaign(folders / 'other'), **changes)
    assert words in str(refused.value)


def test_given_a_campaign_that_its_results_ended_then_it_cannot_calibrate(folders):
    campaign = open_campaign(folders / 'other')
    stopped = dataclasses.replace(campaign, content=dataclasses.replace(
        campaign.content, rows=campaign.rows[:10],
        facts={**campaign.facts, 'until': ['failures=3']},
    ))
    with pytest.raises(UsageError, match='may have ended by the rule failures=3'):
        calibrate(stopped)


def test_given_no_estimate_then_the_features_are_finite_and_it_counts():
    progress = Progress()
    for _ in range(4):
        progress.add(sample(est_cte_m=math.nan))
    found = dict(zip(FEATURES, progress.features(), strict=True))
    assert np.isfinite(list(found.values())).all()
    assert found['unusable_share'] == 1
    progress.add(sample(cte_m=2.0))
    found = dict(zip(FEATURES, progress.features(), strict=True))
    assert found['drift_mps'] == pytest.approx(1.0 / 0.4)
    assert found['error_m'] == pytest.approx(-0.8)
    with pytest.raises(UsageError, match='step 5: no true state'):
        progress.add(sample(cte_m=math.nan))
    with pytest.raises(UsageError, match='no interval of robustness'):
        progress.add(sample(rho_lower=1.0))


def test_given_the_commands_then_they_say_what_holds_and_draw_it(
    folders, tmp_path, taxinet, monkeypatch
):
    monkeypatch.setattr(picture_files, 'DOTS_PER_INCH', 30)
    made = tmp_path / 'near.json'
    code, said, _ = taxinet('forecast', 'calibrate', folders / 'cal', '--out', made)
    assert code == 0
    assert 'learned from 20 runs and calibrated on 20' in said
    code, said, _ = taxinet('forecast', 'check', made, folders / 'other')
    assert code == 0
    assert '20 runs, ' in said
    assert '90 %' in said
    assert '95 %' in said
    code, said, _ = taxinet('forecast', 'check', made, folders / 'cal', '--json')
    assert code == 3
    assert json.loads(said)['outside'][0].startswith('40 of these runs were calibrated on')
    bags = sorted((folders / 'other').glob('starts-*'))[:2]
    plot = tmp_path / 'band.png'
    code, said, _ = taxinet('forecast', 'show', made, *bags, '--at', 2.2, '--plot', plot)
    assert code == 0
    assert said.count('near will be at least') == 2
    assert '(90 %, at all moments of the run)' in said
    assert plot.stat().st_size > 1000
    code, _, complaint = taxinet('forecast', 'show', made, bags[0], '--at', 31)
    assert (code, complaint) == (2, 'taxinet: error: --at 31: needs to be within 0..3 s\n')
    code, _, complaint = taxinet('forecast', 'show', made, bags[0], '--confidence', 0.99)
    assert code == 2
    assert 'needs at least 99 calibration runs, not 20' in complaint
