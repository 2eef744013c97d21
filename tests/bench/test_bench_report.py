"""Reports of ``taxinet bench``: compared with older ones, and ratios of figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from taxinet_ros.bench.measure import LOAD, Figure, machine_facts
from taxinet_ros.bench.report import (
    RATIOS,
    compare_reports,
    find_ratios,
    load_report,
    make_report,
    ratio_violations,
)
from taxinet_ros.errors import UsageError


def report(medians: dict[str, float], **machine: Any) -> dict[str, Any]:
    figures = {
        name: Figure(median_s=s, q1_s=s, q3_s=s, min_s=s, cpu_s=s, repeats=1)
        for name, s in medians.items()
    }
    return make_report(machine, figures)


def test_given_two_reports_when_compared_then_shared_figures_have_new_over_old() -> None:
    old = report({'a': 2.0, 'b': 1.0, 'gone': 1.0})
    new = report({'a': 1.0, 'b': 3.0, 'added': 1.0})
    assert compare_reports(new, old)['ratios'] == {'a': 0.5, 'b': 3.0}


def test_given_other_machines_when_compared_then_what_differs_is_named_but_not_the_load() -> None:
    old = report({'a': 1.0}, processor='old', cores=2, gone=1, **{LOAD: [0.1]})
    new = report({'a': 1.0}, processor='new', cores=2, added=1, **{LOAD: [9.0]})
    assert compare_reports(new, old)['differences'] == {
        'processor': ['old', 'new'],
        'gone': [1, None],
        'added': [None, 1],
    }


@pytest.mark.parametrize(
    'text',
    ['', 'no JSON', '[]', '{"machine": {}}', '{"machine": {}, "figures": {"a": 1}}',
     '{"machine": {}, "figures": {"a": {"median_s": 0}}}',
     '{"machine": {}, "figures": {"a": {"median_s": NaN}}}',
     '{"machine": {}, "figures": {"a": {"median_s": "1"}}}',
     '{"machine": {}, "figures": {"a": {"median_s": true}}}'],
)  # fmt: skip
def test_given_something_else_when_loaded_then_it_is_refused_in_one_line(
    tmp_path: Path, text: str
) -> None:
    path = tmp_path / 'old.json'
    path.write_text(text, encoding='utf-8')
    with pytest.raises(UsageError, match=r'old\.json is no report') as caught:
        load_report(path)
    assert '\n' not in str(caught.value)


def test_given_no_file_when_loaded_then_the_refusal_names_it(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r'cannot read .*old\.json'):
        load_report(tmp_path / 'old.json')


def test_given_this_machine_when_asked_then_processor_cores_and_versions_are_known() -> None:
    facts = machine_facts()
    assert facts['processor']
    assert facts['cores'] >= facts['cores_allowed'] >= 1
    assert {'numpy', 'opencv-python-headless', 'torch', 'jsbsim'} < set(facts)
    assert len(facts[LOAD]) == 3


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


def test_given_every_guarded_ratio_beyond_its_bound_when_asked_then_each_has_one_line() -> None:
    guarded = [ratio for ratio in RATIOS if ratio.most is not None]
    assert len(guarded) >= 3
    for ratio in guarded:
        found = find_ratios({ratio.over: figure(1.1 * ratio.most), ratio.under: figure(1.0)})
        (line,) = ratio_violations(found)
        assert line == (
            f'bench: {ratio.name} is {1.1 * ratio.most:.2f}, guarded at {ratio.most:g} or less')
        assert not ratio_violations(
            find_ratios({ratio.over: figure(0.9 * ratio.most), ratio.under: figure(1.0)}))
