"""Coverage of an ODD, on tables made by hand."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from planted_runs import planted_runs, planted_table

from taxinet_ros.analysis.odd.coverage import coverage_json, odd_coverage
from taxinet_ros.analysis.odd.picture import coverage_picture
from taxinet_ros.analysis.report import pictures
from taxinet_ros.analysis.runs.campaign import CampaignRuns
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.odd.odd_file import read_odd
from taxinet_ros.trials.rates import rate

ODD = """
name: small
source: made by hand
parameters:
  clouds: {values: [clear, broken]}
  rain: {values: [0], range: [50, 100], cells: 1}
  time_of_day: {range: ['6:00', '18:00'], cells: 3}
exclude:
  - {when: {clouds: clear, rain: [50, 100]}, why: no rain from a clear sky}
"""
SCENES = [  # clouds, rain, hour, outcome
    ('clear', 0, 7, 'PASS'),
    ('clear', 0, 11, 'FAIL'),
    ('broken', 0, 7, 'PASS'),
    ('broken', 60, 7, 'PASS'),
    ('broken', 100, 8, 'FAIL'),
    ('clear', 70, 7, 'PASS'),  # excluded
    ('stratus', 0, 19, 'PASS'),  # outside in two ways
    ('broken', 30, 12, 'PASS'),  # in the gap of rain
    ('broken', 60, 17, 'INFRA_ERROR'),
]


def small(folder: Path, text: str = ODD):
    path = folder / 'small.yaml'
    path.write_text(text)
    return read_odd(path)


def table(scenes=SCENES, **columns) -> pd.DataFrame:
    clouds, rain, hours, outcomes = (list(one) for one in zip(*scenes, strict=True))
    outcome = np.array(outcomes)
    frame = planted_table(
        len(scenes), 1, lambda t: np.zeros(len(t)), clouds=clouds,
        rain_percent=np.array(rain, float), time_of_day_h=np.array(hours, float),
        cross_track_m=0.0, distance_m=100.0, heading_deg=0.0,
    )
    rho = np.where(outcome == 'PASS', 1.0, np.where(outcome == 'FAIL', -1.0, math.nan))
    return frame.assign(outcome=outcome, rho=rho, rho_phi=rho, **columns)


def runs(folder: Path, frame: pd.DataFrame | None = None) -> CampaignRuns:
    folder.mkdir(exist_ok=True)
    return planted_runs(table() if frame is None else frame, folder)


def test_given_a_table_made_by_hand_then_every_number_is_the_one_counted_by_hand(tmp_path):
    found = odd_coverage(small(tmp_path), [runs(tmp_path / 'one')], limit=0.9)
    assert (found.judged, found.inside) == (8, 5)
    assert found.outside == {
        'excluded: clouds clear, rain 50 to 100 % (no rain from a clear sky)': 1,
        'clouds in none of its cells': 1, 'time of day in none of its cells': 1,
        'rain in none of its cells': 1,
    }
    assert found.unjudged == {'INFRA_ERROR': 1}
    cells = {(one.parameter, one.cell): one.rate for one in found.cells}
    assert [cells[at].runs for at in sorted(cells)] == [2, 3, 3, 2, 4, 1, 0]
    assert [cells[at].failures for at in sorted(cells)] == [1, 1, 1, 1, 1, 1, 0]
    assert cells[0, 1][2:5] == rate(1, 3)
    assert found.rate[:5] == (5, 2, *rate(2, 5))
    # Pairs: clouds x rain has 3 feasible, the two with hours 6 each; triples 3 x 3.
    one, two, three = found.strengths
    assert (one.t, one.feasible, one.covered, one.failing) == (1, 7, 6, 6)
    assert (two.t, two.feasible, two.covered, two.failing) == (2, 15, 3 + 3 + 3, 2 + 2 + 2)
    assert (three.feasible, three.covered, three.failing) == (9, 4, 2)
    assert found.pairs[0, 1].runs.tolist() == [[2, 0], [1, 2]]
    assert found.pairs[0, 1].feasible.tolist() == [[True, False], [True, True]]


def test_given_a_limit_then_combinations_count_whose_interval_is_below_it(tmp_path):
    """0 of 5 is below 60 % (52.2 %, Clopper-Pearson), 0 of 4 is not (60.2 %)."""
    scenes = [('clear', 0, 7, 'PASS')] * 5 + [('broken', 0, 11, 'PASS')] * 4
    found = odd_coverage(small(tmp_path), [runs(tmp_path / 'one', table(scenes))], limit=0.6)
    # clear; dry (0 of 9); 6 to 10 h; and of pairs all three of these
    assert [one.below for one in found.strengths] == [3, 3, 1]
    assert [one.below for one in odd_coverage(
        small(tmp_path), [runs(tmp_path / 'one', table(scenes))]).strengths] == [None] * 3


def test_given_gaps_then_the_largest_groups_come_first_and_excluded_pairs_are_none(tmp_path):
    found = odd_coverage(small(tmp_path), [runs(tmp_path / 'one')])
    words = [found.gap_words(gap) for gap in found.gaps]
    # No judged run from 14:00 on, with either sky or rain; the other two gaps are pairs.
    assert words[:2] == [
        'time of day 14:00 to 18:00 with clouds clear, broken',
        'time of day 14:00 to 18:00 with rain 0 %, 50 to 100 %',
    ]
    assert words[2:] == [
        'time of day 10:00 to 14:00 with clouds broken',
        'time of day 10:00 to 14:00 with rain 50 to 100 %',
    ]
    assert sum(len(gap.cells) for gap in found.gaps) == 15 - 9


def test_given_what_did_not_vary_or_is_not_in_the_odd_then_it_is_named(tmp_path):
    text = ODD.replace('  clouds', '  distance: {range: [0, 200], unit: m}\n  clouds')
    frame = table(heading_deg=np.arange(9.0), wind_speed_mps=np.arange(9.0))
    found = odd_coverage(small(tmp_path, text), [runs(tmp_path / 'one', frame)])
    assert found.fixed == ('distance_m',)
    assert found.unmentioned == ('heading_deg', 'wind_speed_mps')


def test_given_a_sampler_that_chose_all_runs_then_they_cover_but_give_no_rate(tmp_path):
    frame = table(sampler='halton', drawn=False)
    found = odd_coverage(small(tmp_path), [runs(tmp_path / 'one', frame)], limit=0.9)
    assert [one.covered for one in found.strengths] == [6, 9, 4]
    assert [one.below for one in found.strengths] == [0, 0, 0]
    assert all(math.isnan(one.rate.low) for one in found.cells if one.rate.runs)
    assert coverage_json(found)['inside']['low'] is None


def test_given_several_campaigns_then_they_are_added_up_unless_that_means_nothing(tmp_path):
    one = runs(tmp_path / 'one')
    later = table([('broken', 0, 15, 'FAIL'), ('clear', 0, 15, 'PASS')])
    other = runs(tmp_path / 'two', later)
    found = odd_coverage(small(tmp_path), [one, other])
    assert found.inside == 7
    # Who adds a campaign has seen the first, so the number of runs was open, as in evidence.
    assert found.rate[:5] == (7, 3, *rate(3, 7, anytime=True))
    assert any('at any number of runs' in line for line in found.cautions)
    assert found.strengths[0].covered == 7
    for wrong, message in (
        (dataclasses.replace(other, perception='another'), 'has perception another, but .* netw'),
        (dataclasses.replace(other, spec='psi'), 'has formula psi, but .* phi'),
        (dataclasses.replace(other, perception='a, b'), 'has perception a, b'),
        (one, 'has runs that are in .* too; name each once'),
    ):
        with pytest.raises(UsageError, match=message):
            odd_coverage(small(tmp_path), [one, wrong])
    limits = [
        dataclasses.replace(some, facts={**some.facts, 'specs': {'phi': f'always(cte <= {limit})'}})
        for some, limit in ((one, 1), (other, 2))
    ]
    with pytest.raises(UsageError, match=r'has formula phi always\(cte <= 2\), but .* <= 1'):
        odd_coverage(small(tmp_path), limits)


def test_given_a_table_without_a_key_then_its_runs_are_not_inside(tmp_path):
    text = ODD.replace('  clouds', '  date: {values: [2020-03-20]}\n  clouds', 1)
    assert odd_coverage(small(tmp_path, text), [runs(tmp_path / 'one')]).inside == 5
    frame = table().drop(columns='date')
    found = odd_coverage(small(tmp_path, text), [runs(tmp_path / 'one', frame)])
    assert found.inside == 0
    assert found.outside['date not recorded'] == 8


def test_given_no_run_inside_then_nothing_is_covered_and_the_picture_is_drawn_all_the_same(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(pictures, 'DOTS_PER_INCH', 30)
    frame = table([('stratus', 0, 7, 'PASS')])
    found = odd_coverage(small(tmp_path), [runs(tmp_path / 'one', frame)])
    assert found.inside == 0
    assert [one.covered for one in found.strengths] == [0, 0, 0]
    assert json.loads(json.dumps(coverage_json(found), allow_nan=False))['inside']['rate'] is None
    data = pictures.png_bytes(coverage_picture(found), pictures.LIGHT)
    assert data.startswith(b'\x89PNG')


def test_given_one_parameter_then_there_are_no_pairs(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, 'DOTS_PER_INCH', 30)
    text = 'name: one\nparameters:\n  time_of_day: {range: [6, 18], cells: 3}\n'
    found = odd_coverage(small(tmp_path, text), [runs(tmp_path / 'one')])
    assert [one.t for one in found.strengths] == [1]
    assert found.pairs == {}
    assert pictures.png_bytes(coverage_picture(found), pictures.LIGHT)
