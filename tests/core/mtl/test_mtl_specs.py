"""Requirements as users write them.

Bounds and rates as users write them.
"""

from __future__ import annotations

import math
import re

import pytest

from taxinet_ros.core.mtl import (
    SHIPPED,
    SIGNALS,
    Assumptions,
    Monitor,
    parse_assumptions,
    parse_bounds,
    parse_formula,
    parse_rates,
    parse_spec,
    signal_names,
)
from taxinet_ros.errors import UsageError


def test_given_the_shipped_names_when_asked_then_they_are_the_papers_formulas() -> None:
    assert {name: spec.text for name, spec in SHIPPED.items()} == {
        'phi_always': 'always(abs(cte) <= 1.5)',
        'phi_eventually': 'eventually[0:10](always(abs(cte) <= 1.5))',
        'on_runway': 'always(abs(cte) <= 15.24)',
        'usable': 'always((estimate_gap <= 0.5) and (unusable_share <= 0.05))',
        'no_collision': 'always(clearance > 0)',
        'keep_clear': 'always(clearance >= 3)',
        'hold_short': 'always(hold_distance >= 0)',
    }
    for name, spec in SHIPPED.items():
        assert parse_spec(f' {name} ') is spec
        assert parse_formula(spec.text) == spec.formula


def test_given_a_named_formula_when_read_then_name_and_text_are_kept() -> None:
    spec = parse_spec('slow= G speed<=6')
    assert (spec.name, spec.text) == ('slow', 'always(speed <= 6)')


def test_given_bare_formulas_when_read_then_the_name_depends_on_meaning_only() -> None:
    one, same, other = (parse_spec(t) for t in ('G speed<=6', 'always( speed <= 6.0 )', 'G he<=6'))
    assert re.fullmatch('spec_[0-9a-f]{8}', one.name)
    assert one == same
    assert one.name != other.name
    assert one.name == 'spec_fcb10bc7'


def test_given_a_predicate_name_when_read_then_it_is_the_formula() -> None:
    assert parse_spec('near', {'near': 'abs(cte) <= 1.5'}).text == 'abs(cte) <= 1.5'


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('phi_alway', 'known: phi_always, phi_eventually, on_runway, usable, no_coll'),
        ('Slow=G speed<6', 'snake_case'),
        ('cte=1', "'cte' is a signal, no name; a comparison is one of <=, <, >=, >"),
        ('until = cte<1', 'no operator'),
        ('slow = G spee<6', "spec slow: column 10: expected a signal, got unknown 'spee'"),
        ('phi_always = G abs(cte) <= 2', 'choose another name'),
    ],
)
def test_given_a_bad_requirement_when_read_then_one_line_says_why(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)) as caught:
        parse_spec(text)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('name', 'unit'), [('phi_always', 'rad'), ('usable', 'm')])
def test_given_signals_in_other_units_when_a_shipped_formula_reads_them_then_refused(
    name: str, unit: str
) -> None:
    signals = signal_names(SHIPPED[name].formula)
    first, told = signals[0], SIGNALS[signals[0]]
    for accepted in (told, ''):
        assert parse_spec(name, signals=dict.fromkeys(signals, '') | {first: accepted})
    with pytest.raises(
        UsageError, match=f'spec {name}: reads {first} in {told}, here it is in {unit}$'
    ):
        parse_spec(name, signals=dict.fromkeys(signals, unit))


def test_given_a_shipped_name_with_its_own_formula_when_read_then_it_is_accepted() -> None:
    assert parse_spec('phi_always = G abs(cte) <= 1.5') == SHIPPED['phi_always']


def test_given_every_signal_when_used_then_it_is_known_with_a_unit() -> None:
    assert len(SIGNALS) == 14
    text = ' and '.join(f'{name} < 1' for name in SIGNALS)
    assert signal_names(parse_formula(text)) == tuple(sorted(SIGNALS))
    assert all(SIGNALS.values())


def test_given_bounds_when_read_then_the_monitor_takes_them() -> None:
    bounds = parse_bounds(['cte=-25:25', ' he = -0.5 : 5e-1', 'x=0:inf'])
    assert bounds == {'cte': (-25.0, 25.0), 'he': (-0.5, 0.5), 'x': (0.0, math.inf)}
    monitor = Monitor(parse_spec('phi_always'), 1, bounds=bounds)
    assert monitor.push(0, {'cte': 0.0}).lower == -23.5


def test_given_rates_when_read_then_the_monitor_takes_them() -> None:
    rates = parse_rates(['cte=3', 'he= 0'])
    assert rates == {'cte': 3.0, 'he': 0.0}
    monitor = Monitor(parse_spec('phi_always'), 10**9, rates=rates)
    assert monitor.push(0, {'cte': 0.0}).lower == pytest.approx(-1.5, abs=1e-4)
    assert parse_bounds([]) == parse_rates([]) == {}


@pytest.mark.parametrize(
    ('parse', 'texts', 'message'),
    [
        (parse_bounds, ['cte'], "bounds 'cte': expected SIGNAL=..., e.g. cte=-25:25"),
        (parse_bounds, ['lateral=0:1'], "unknown signal 'lateral'; known: cte"),
        (parse_bounds, ['cte=0:1', 'cte=0:2'], 'cte has one already'),
        (parse_bounds, ['cte=25'],
         r'expected LOW:HIGH with LOW <= HIGH \[m\], e.g. cte=-25:25'),
        (parse_bounds, ['cte=2:1'], 'expected LOW:HIGH'),
        (parse_bounds, ['cte=a:b'], 'expected LOW:HIGH'),
        (parse_bounds, ['cte=nan:1'], 'expected LOW:HIGH'),
        (parse_bounds, ['cte=inf:inf'], 'expected LOW:HIGH'),
        (parse_bounds, ['he=0:1:2'], r'\[rad\], e.g. he='),
        (parse_rates, ['cte'], "rates 'cte': expected SIGNAL=..., e.g. cte=3"),
        (parse_rates, ['cte=-1'], r'expected a number >= 0 \[m per s\], e.g. cte=3'),
        (parse_rates, ['cte=inf'], 'expected a number'),
        (parse_rates, ['cte=fast'], 'expected a number'),
        (parse_rates, ['cte=1', 'cte=1'], 'cte has one already'),
        (parse_rates, ['up=1'], "unknown signal 'up'"),
    ],
)
def test_given_bad_bounds_or_rates_when_read_then_one_line_says_why(parse, texts, message) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        parse(texts)
    assert '\n' not in str(caught.value)


def test_given_signals_of_another_robot_then_those_are_known_and_ours_are_not():
    found = parse_assumptions(['depth=0:40'], ['depth=2', 'yaw=0.5'], signals=['depth', 'yaw'])
    assert found == Assumptions(bounds={'depth': (0, 40)}, rates={'depth': 2, 'yaw': 0.5})
    assert found.about({'yaw'}) == Assumptions(rates={'yaw': 0.5})
    with pytest.raises(UsageError) as caught:
        parse_assumptions(['cte=0:1'], [], signals=['depth', 'yaw'])
    assert str(caught.value) == "bounds 'cte=0:1': unknown signal 'cte'; known: depth, yaw"
    with pytest.raises(UsageError, match=r'rates .yaw=-1.: expected a number >= 0, e\.g\. yaw=3'):
        parse_assumptions([], ['yaw=-1'], signals=['depth', 'yaw'])
