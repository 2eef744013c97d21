"""Every value lies in exactly one bin, also a value of another campaign."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.analysis.runs.bins import bins
from taxinet_ros.analysis.runs.features import BY_NAME, HEADING, RAIN


def test_given_dry_and_wet_runs_then_no_wet_bin_holds_a_dry_one():
    rain = np.concatenate([np.zeros(200), np.linspace(0.001, 100, 100)])
    dry, *wet = bins(RAIN, pd.DataFrame({'rain_percent': rain}))
    assert (dry.label, int(dry.mask.sum())) == ('0', 200)
    assert wet[0].low == 0
    assert sum(int(one.mask.sum()) for one in wet) == 100
    assert not any(one.holds(np.zeros(1)).any() for one in wet)
    assert dry.holds(np.array([0.0, 1e-9])).tolist() == [True, False]


def test_given_values_of_another_campaign_at_edges_then_each_is_in_one_bin():
    cut = bins(HEADING, pd.DataFrame({'heading_deg': np.linspace(-30, 30, 400)}))
    edges = np.array([one.low for one in cut] + [cut[-1].high])
    for others in (edges, edges[:-1], edges[1:-1], edges[3:4]):
        assert sum(one.holds(others).astype(int) for one in cut).tolist() == [1] * len(others)
    assert not any(one.holds(np.array([-40.0, 40.0])).any() for one in cut)


@given(st.sampled_from(['heading_deg', 'rain_percent', 'cross_track_m', 'time_of_day_h']),
       st.lists(st.integers(0, 24), min_size=1, max_size=60), st.sampled_from([0.1, 0.5, 3.0]))
def test_given_values_a_last_bit_beside_round_ones_then_none_is_lost(name, numbers, step):
    values = np.array([number * step for number in numbers])
    for beside in (values, np.nextafter(values, math.inf), np.nextafter(values, -math.inf)):
        cut = bins(BY_NAME[name], pd.DataFrame({name: beside}))
        assert sum(one.mask.astype(int) for one in cut).tolist() == [1] * len(values)
        for one in cut:
            assert one.mask.tolist() == one.holds(beside).tolist()


@pytest.mark.parametrize('runs', [4, 12, 400])
def test_given_runs_by_day_then_bins_end_where_they_do_and_not_at_midnight(runs):
    cut = bins(BY_NAME['time_of_day_h'], pd.DataFrame({'time_of_day_h': np.linspace(6, 18, runs)}))
    assert (cut[0].low, cut[-1].high) == (6, 18)
    assert cut[0].label.startswith('06:00 to ')
    assert cut[-1].label.endswith(' to 18:00')


def test_given_words_then_a_bin_holds_its_own():
    frame = pd.DataFrame({'clouds': ['clear', 'stratus', 'clear']})
    clear, stratus = bins(BY_NAME['clouds'], frame)
    assert clear.holds(np.array(['stratus', 'clear'])).tolist() == [False, True]
    assert stratus.mask.tolist() == [False, True, False]
    assert clear.middle != pytest.approx(clear.middle), 'a word has no ends'
