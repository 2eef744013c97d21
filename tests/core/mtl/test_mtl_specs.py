"""Requirements as users write them."""

from __future__ import annotations

import re

import pytest

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import SHIPPED, SIGNALS, parse_formula, parse_spec, signal_names


def test_given_the_shipped_names_when_asked_then_they_are_the_papers_formulas() -> None:
    assert {name: spec.text for name, spec in SHIPPED.items()} == {
        'phi_always': 'always(abs(cte) <= 1.5)',
        'phi_eventually': 'eventually[0:10](always(abs(cte) <= 1.5))',
        'on_runway': 'always(abs(cte) <= 15.24)',
        'usable': 'always((estimate_gap <= 0.5) and (unusable_share <= 0.05))',
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
        ('phi_alway', 'known: phi_always, phi_eventually, on_runway, usable'),
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


def test_given_a_shipped_name_with_its_own_formula_when_read_then_it_is_accepted() -> None:
    assert parse_spec('phi_always = G abs(cte) <= 1.5') == SHIPPED['phi_always']


def test_given_every_signal_when_used_then_it_is_known_with_a_unit() -> None:
    assert len(SIGNALS) == 9
    text = ' and '.join(f'{name} < 1' for name in SIGNALS)
    assert signal_names(parse_formula(text)) == tuple(sorted(SIGNALS))
    assert all(SIGNALS.values())
