from __future__ import annotations

import pytest

from taxinet_ros.bench.measure import Figure
from taxinet_ros.bench.ratios import RATIOS, bounds, broken, find_ratios


def figure(cpu: float | None, wall: float = 9.0) -> Figure:
    """A figure with quartiles a tenth beside its median."""
    times = (None, None, None) if cpu is None else (0.9 * cpu, cpu, 1.1 * cpu)
    return Figure(
        median_s=wall, q1_s=0.9 * wall, q3_s=1.1 * wall, min_s=wall, repeats=3,
        cpu_q1_s=times[0], cpu_s=times[1], cpu_q3_s=times[2],
    )


def test_given_figures_when_compared_then_processor_time_counts_and_spreads_are_opposed() -> None:
    figures = {'graph/composed, network': figure(2.0), 'loop/network': figure(1.0, wall=1.0)}
    ((name, ratio),) = find_ratios(figures).items()
    assert name == 'composed graph / loop without ROS, network'
    assert ratio['value'] == pytest.approx(2.0)
    assert (ratio['low'], ratio['high']) == pytest.approx((1.8 / 1.1, 2.2 / 0.9))
    assert (ratio['clock'], ratio['kept']) == ('processor', True)


def test_given_campaigns_when_compared_then_it_is_by_the_clock_on_the_wall() -> None:
    figures = {
        'campaign/1 worker': figure(None, wall=4.0), 'campaign/2 workers': figure(None, wall=2.5),
    }  # fmt: skip
    ((_, ratio),) = find_ratios(figures).items()
    assert (ratio['value'], ratio['clock']) == (pytest.approx(1.6), 'wall')
    assert bounds(ratio) == ''


def test_given_every_guarded_ratio_beyond_its_bound_when_asked_then_each_has_one_line() -> None:
    guarded = [ratio for ratio in RATIOS if ratio.least is not None or ratio.most is not None]
    assert len(guarded) >= 4
    for ratio in guarded:
        value = 0.9 * ratio.least if ratio.least is not None else 1.1 * (ratio.most or 0.0)
        found = find_ratios({ratio.over: figure(value), ratio.under: figure(1.0)})
        (line,) = broken(found)
        assert line.startswith(f'bench: {ratio.name} is {value:.2f}, guarded at ')
        assert not found[ratio.name]['kept']
        assert bounds(found[ratio.name])[:2] in {'>=', '<='}
