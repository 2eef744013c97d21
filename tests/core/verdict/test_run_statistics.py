"""The figures of a run beside its robustness."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.verdict.run_statistics import RunStatistics, RunStatisticsCollector

PERIOD_NS = 100_000_000
HALF_WIDTH_M = default_runway().half_width_m


def statistics(samples: list[dict[str, float]]) -> RunStatistics:
    collector = RunStatisticsCollector()
    for seq, sample in enumerate(samples):
        collector.push(seq * PERIOD_NS, sample)
    return collector.statistics


def path(*deviations: float) -> list[dict[str, float]]:
    return [{'cte': cte, 'he': 0.0, 'cte_estimate': cte, 'he_estimate': 0.0} for cte in deviations]


@pytest.mark.parametrize(('deviations', 'settled'), [
    ((0.0, 1.5, -1.5), 0.0),
    ((8.0, 2.0, 1.4, 0.1), 0.2),
    ((8.0, 1.0, -1.6, 1.5), 0.3),
    ((8.0, 1.0, 1.51), math.nan),
])
def test_given_a_path_then_the_settle_time_is_that_from_which_it_stays_on_the_centreline(
    deviations: tuple[float, ...], settled: float,
) -> None:
    assert statistics(path(*deviations)).settle_time_s == pytest.approx(settled, nan_ok=True)


def test_given_a_path_beyond_the_edge_then_the_runway_was_left() -> None:
    assert statistics(path(0, -HALF_WIDTH_M, 0)).left_runway is False
    beyond = statistics(path(0, -HALF_WIDTH_M - 0.01, 0))
    assert beyond.left_runway is True
    assert beyond.max_cross_track_m == HALF_WIDTH_M + 0.01


number = st.floats(-50, 50)


@given(st.lists(st.tuples(number, number, number, number), min_size=1, max_size=30))
def test_given_estimates_then_their_errors_are_those_of_numpy(
    rows: list[tuple[float, float, float, float]],
) -> None:
    names = ('cte', 'he', 'cte_estimate', 'he_estimate')
    found = statistics([dict(zip(names, row, strict=True)) for row in rows])
    values = np.array(rows)
    for errors, column in ((found.cte_error, 0), (found.he_error, 1)):
        difference = values[:, column + 2] - values[:, column]
        assert errors.mean == pytest.approx(difference.mean(), abs=1e-12)
        assert errors.mean_abs == pytest.approx(np.abs(difference).mean(), abs=1e-12)
        assert errors.max_abs == np.abs(difference).max()
    assert found.unusable_estimates == 0


def test_given_frames_without_an_estimate_then_they_are_counted_and_left_out() -> None:
    blind = {'cte': 3.0, 'he': 0.0, 'cte_estimate': math.nan, 'he_estimate': math.nan}
    seen = {'cte': 1.0, 'he': 0.1, 'cte_estimate': 3.0, 'he_estimate': 0.0}
    found = statistics([blind, seen, blind])
    assert found.unusable_estimates == 2
    assert (found.cte_error.mean, found.he_error.max_abs) == (2.0, 0.1)
    nothing = statistics([blind])
    assert math.isnan(nothing.cte_error.mean)
    assert math.isnan(nothing.he_error.max_abs)
