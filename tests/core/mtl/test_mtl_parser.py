"""Formula texts: what is read, how it prints, and what is refused."""

from __future__ import annotations

import math
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mtl_strategies import Trace, formulas, fuzz, traces

from taxinet_ros.core.mtl import Spec, ast, parse_formula, robustness
from taxinet_ros.core.mtl.lint import Setting, warnings
from taxinet_ros.core.mtl.parser import parse
from taxinet_ros.core.units import UNITS
from taxinet_ros.errors import UsageError

NEAR = {'near': 'abs(cte) <= 1.5'}
PHI = 'eventually[0:10](always(abs(cte) <= 1.5))'


@pytest.mark.parametrize(
    'text',
    [
        PHI,
        'F[0,10] G abs(cte)<=1.5;',
        'F[0, 10] G near',
        'eventually[0 s : 10000 ms] always[0:inf] near',
        '◇[0:10e0] □ near',
        '◊[0:10] (globally (abs(cte) ≤ 1.50))',
    ],
)
def test_given_spellings_of_one_formula_when_parsed_then_the_tree_is_one(text: str) -> None:
    always = ast.Temporal(
        'always',
        ast.Interval(),
        ast.Compare('<=', ast.Function('abs', (ast.Signal('cte'),)), ast.Number(1.5)),
    )
    wanted = ast.Temporal('eventually', ast.Interval(0, 10_000_000_000), always)
    assert parse_formula(text, NEAR) == wanted
    assert str(wanted) == PHI


@pytest.mark.parametrize(
    ('text', 'printed'),
    [
        ('cte < 1 or he < 1 and x < 1', '(cte < 1) or ((he < 1) and (x < 1))'),
        ('not cte < 1 and he < 1', '(not (cte < 1)) and (he < 1)'),
        ('G cte < 1 U he < 1', '(always(cte < 1)) until (he < 1)'),
        (
            'cte<1 ∧ ¬ he<1 ∨ x<1 → x>2',
            '(((cte < 1) and (not (he < 1))) or (x < 1)) implies (x > 2)',
        ),
        (
            '!cte<1 & he<1 | x<1 -> x>2',
            '(((not (cte < 1)) and (he < 1)) or (x < 1)) implies (x > 2)',
        ),
        ('cte - 1 - 2 < -he * 3 / x', '(cte - 1) - 2 < ((-he) * 3) / x'),
        ('(cte - (1 - 2)) >= min(he, 1, x)', 'cte - (1 - 2) >= min(he, 1, x)'),
        ('sqrt(cte*cte) > max(1, 2)', 'sqrt(cte * cte) > max(1, 2)'),
        ('cte<1 until he<1 until x<1', '((cte < 1) until (he < 1)) until (x < 1)'),
        ('O[100ms:2] cte<1', 'once[0.1:2](cte < 1)'),
        ('H cte<1 S[5, inf] he<1', '(historically(cte < 1)) since[5:inf] (he < 1)'),
        ('historically[1ns:2us](cte<1)', 'historically[0.000000001:0.000002](cte < 1)'),
        ('cte<1 until[3:3] he<1', '(cte < 1) until[3:3] (he < 1)'),
        ('(cte<1 -> he<1) -> x<1', '((cte < 1) implies (he < 1)) implies (x < 1)'),
        ('cte_estimate - cte < 0.000001', 'cte_estimate - cte < 1e-06'),
        ('G[0:500ms] cte<1', 'always[0:0.5](cte < 1)'),
        ('cte<1 unless he<1', '((cte < 1) until (he < 1)) or (always(cte < 1))'),
        ('cte<1 W[1:2] he<1', '((cte < 1) until[1:2] (he < 1)) or (always[0:2](cte < 1))'),
        ('cte<1 R[0,3] he<1', 'not ((not (cte < 1)) until[0:3] (not (he < 1)))'),
        ('cte<1 release he<1', 'not ((not (cte < 1)) until (not (he < 1)))'),
    ],
)
def test_given_a_formula_when_parsed_then_it_prints_fully_parenthesised(
    text: str, printed: str
) -> None:
    formula = parse_formula(text)
    assert str(formula) == printed
    assert parse_formula(printed) == formula


@pytest.mark.parametrize(
    ('text', 'column', 'expected'),
    [
        ('', 1, 'a signal, number'),
        ('cte', 4, "'<=', '<', '>=' or '>'"),
        ('always(cte + 1)', 7, 'a formula'),
        ('0 <= cte <= 1', 10, "'and', got '<='; write it as two: 0 <= cte and cte <= ..."),
        ('cte == 1', 5, "'<=', '<', '>=' or '>', got '=='; two numbers are hardly ever equal"),
        ('cte = 1', 5, "'<=', '<', '>=' or '>', got '='; a comparison is one of"),
        ('cte < = 1', 7, 'without a space in it'),
        ('(cte < 1) == (he < 1)', 11, "or the end, got '=='; for iff write (a implies b) and (b"),
        ('((cte < 1) = (he < 1))', 12, "or the end, got '='; for iff write (a implies b) and"),
        ('(cte < 1) != (he < 1)', 11, "or the end, got '!='; for xor write it with 'and', 'or'"),
        ('alw_[0,10](cte < 1)', 1, "got unknown 'alw_'; write always(...), or always[0:10](...)"),
        ('[](cte < 1)', 1, "got '[]'; write always(...), or always[0:10](...)"),
        ('ev_[0,10](cte < 1)', 1, "got unknown 'ev_'; write eventually(...), or eventually[0:10]"),
        ('always <>[0,3](cte < 1)', 8, "got '<>'; write eventually(...); for another number"),
        ('cte <> 1', 5, "'>', got '<>'; write eventually(...); for another number cte < 1 or cte"),
        ('rise(cte < 1)', 1, "got unknown 'rise'; write p and once[0.1:0.1](not p), with"),
        ('fall(cte < 1)', 1, "got unknown 'fall'; write (not p) and once[0.1:0.1](p), with"),
        ('cte => 1', 5, "got '=>'; that means implies; a comparison is written >="),
        ('cte ^ 2 < 1', 5, 'for a power write cte * cte'),
        ('cte**2 < 1', 4, 'for a power write cte * cte'),
        ('abs cte < 1', 5, "'(' after abs, got 'cte'"),
        ('|cte| < 1', 1, "got '|'; for an absolute value write abs(...)"),
        ('cte < 1 AND he < 1', 9, "got 'AND'; did you mean 'and'?"),
        ('Always(cte < 1)', 1, "got unknown 'Always'; did you mean 'always'?"),
        ('ctee < 1', 1, "got unknown 'ctee'; did you mean 'cte'?; known: cte, he,"),
        ('heading < 1', 1, "got unknown 'heading'; did you mean 'he'?; known:"),
        ('prev(cte < 1)', 1, 'write a window, such as once[0.1:0.1]'),
        ('cte<1 -> he<1 -> x<1', 15, "parentheses in a chain of 'implies'"),
        ('cte<1 implies he<1 implies x<1', 20, "parentheses in a chain of 'implies'"),
        ('always[10:0] cte<1', 8, 'a <= b, got [10:0]'),
        ('always[0:10hours] cte<1', 12, "']' or a unit (s, ms, us, ns, min), got 'hours'"),
        ('always[0:1) cte<1', 11, "']'"),
        ('always[0 1] cte<1', 10, "':' or ','"),
        ('always[inf:inf] cte<1', 8, 'a number of seconds'),
        ('always[-1:2] cte<1', 8, "0 seconds or more; 'once' and 'historically' look back"),
        ('always[0:0.5ns] cte<1', 10, 'a whole number of nanoseconds'),
        ('always[0:1e-999999999999999999] cte<1', 10, 'a whole number of nanoseconds'),
        ('always[0:1e99] cte<1', 10, "'inf'"),
        ('always[0:1e999999999] cte<1', 10, 'a whole number of nanoseconds'),
        ('lateral <= 1', 1, "unknown 'lateral'; known: cte, he, speed, x, steering"),
        ('(cte < 1', 9, "')' to close '(' of column 1"),
        ('abs(cte < 1', 12, "')' to close '(' of column 4"),
        ('cte < 1)', 8, "no ')': nothing is open"),
        ('cte < 1 he < 2', 9, "'and', 'or' or the end"),
        ('cte < 1e999', 7, 'a finite number'),
        ('abs(cte, he) < 1', 1, '1 argument of abs'),
        ('min(cte) < 1', 1, 'at least 2 arguments of min'),
        ('1 + (cte < 1) < 2', 5, 'a number or signal'),
        ('abs(cte < 1) < 2', 9, "')'"),
        ('abs((cte < 1)) < 2', 5, 'a number or signal'),
        ('not cte', 5, 'a formula'),
        ('cte < 1 and', 12, 'a signal, number'),
        ('cte # 1', 5, 'a formula sign or name'),
        ('(' * 60 + 'cte < 1' + ')' * 60, 51, 'at most 50 nested'),
        ('not ' * 60 + 'cte < 1', 201, 'at most 50 nested'),
        ('cte < 1' + ' and cte < 1' * 130, 1501, 'at most 500 words'),
        # Units that do not fit.
        ('cte <= 10 deg', 8, 'a length (m, km, cm, mm, ft, nmi) to go with cte, got 10 deg'),
        ('abs(he) <= 10 m', 12, 'an angle (rad, mrad, deg, °) to go with abs(he), got 10 m'),
        ('always(5 % >= speed)', 8, 'a speed (m/s, km/h, kt) to go with speed, got 5 %'),
        ('cte - 3 s < 1', 7, 'a length (m, km, cm, mm, ft, nmi) to go with cte, got 3 s'),
        ('max(he, 1, 1 m) < 1', 12, 'an angle (rad, mrad, deg, °) to go with he, got 1 m'),
        ('cte / speed < 3 m', 15, 'a time (s, ms, us, ns, min, h) to go with cte / speed, got 3 m'),
        ('cte < 5 degrees', 9, "got 'degrees'; did you mean 'deg'?"),
        ('cte < 5 furlongs', 9, "got 'furlongs'; units are m, km, cm,"),
        ('eventually[0:10 m] cte < 1', 17, "']' or a unit (s, ms, us, ns, min), got 'm'"),
        ('(cte + 1) m < 3', 11, "'<=', '<', '>=' or '>', got 'm'"),
        # A unit beside a sum of unlike parts.
        ('cte + speed <= 3 m', 7, 'a length (m, km, cm, mm, ft, nmi) to go with cte, got speed, a '
                                  'speed (m/s, km/h, kt)'),
        ('always(he + cte <= 3 m)', 13, 'an angle (rad, mrad, deg, °) to go with he, got cte'),
        ('3 m >= cte - speed', 14, 'to go with cte, got speed'),
        ('cte + 1 + speed <= 3 m', 11, 'to go with cte + 1, got speed'),
        ('cte + he + 1 m <= 3', 7, 'to go with cte, got he'),
        ('(cte + he) * 2 <= 3 m', 8, 'to go with cte, got he'),
        ('(cte + he) * 2 s <= 3', 8, 'to go with cte, got he'),
        ('max(cte, he) <= 3 m', 10, 'to go with cte, got he'),
        ('max(cte, 1 m, he) <= 3', 10, 'an angle (rad, mrad, deg, °) to go with he, got 1 m'),
        ('min(1, cte, abs(he)) <= 3 m', 13, 'to go with cte, got abs(he)'),
        ('speed * he + speed <= 3 deg', 23, 'a speed (m/s, km/h, kt) to go with'),
        ('always[0:0.5 m](cte <= 1)', 14,
         "']' or a unit (s, ms, us, ns, min), got 'm'; did you mean s or min?"),
        ('always[0 m:5](cte <= 1)', 10, "':' or ',' or a unit (s, ms, us, ns, min), got 'm'"),
        ('always[0:5 sec](cte <= 1)', 12, "got 'sec'; did you mean s?"),
        ('always[0:5 deg](cte <= 1)', 12, "got 'deg'"),
        # Constants without a value.
        ('1/0 <= 2', 2, '1 / 0 divides by zero'),
        ('cte / (1 - 1) <= 2', 5, 'divides by zero'),
        ('0/0 <= cte', 2, 'divides by zero'),
        ('cte <= sqrt(-1)', 8, 'sqrt(-1) has no finite value'),
        ('cte <= 1e308 * 10', 14, '1e+308 * 10 has no finite value'),
        ('1e308 <= -1e308', 1, 'has no finite margin'),
    ],
)
def test_given_a_bad_text_when_parsed_then_one_line_names_column_and_expectation(
    text: str, column: int, expected: str
) -> None:
    with pytest.raises(UsageError) as caught:
        parse_formula(text)
    message = str(caught.value)
    assert message.startswith(f'formula: column {column}: ')
    assert expected in message
    assert '\n' not in message


def test_given_a_bad_predicate_when_parsed_then_the_message_names_it() -> None:
    with pytest.raises(UsageError, match=r"predicate 'near': column 5: expected"):
        parse_formula('G near', {'near': 'cte = 1'})


@pytest.mark.parametrize('name', ['cte', 'always', 'G', 'a b', '1a'])
def test_given_a_reserved_predicate_name_when_parsed_then_it_is_refused(name: str) -> None:
    with pytest.raises(UsageError, match='unreserved name'):
        parse_formula('cte < 1', {name: 'cte < 1'})


@given(st.text(alphabet='()[]{}:,<=>-+*/!&|;.^≠ 0159abcehtxsGFUWRinf□◇¬\n\t"', max_size=40))
@fuzz(500)
def test_given_any_text_when_parsed_then_it_is_a_formula_or_a_one_line_error(text: str) -> None:
    try:
        message = ''
        formula = parse_formula(text)
    except UsageError as error:
        message = str(error)
    assert message.startswith('formula: column ') or parse_formula(str(formula)) == formula
    assert '\n' not in message


@pytest.mark.parametrize('value', [-1.0, -0.0, float('inf'), float('nan')])
def test_given_a_number_that_cannot_be_written_when_made_then_it_is_refused(value: float) -> None:
    with pytest.raises(UsageError, match='finite and >= 0'):
        ast.Number(value)


@pytest.mark.parametrize(
    ('text', 'printed'),
    [
        ('abs(he) <= 10 deg', f'abs(he) <= {math.radians(10)!r}'),
        ('abs(steering) <= 5°', f'abs(steering) <= {math.radians(5)!r}'),
        ('x >= 1.4 km', 'x >= 1400'),
        ('cte <= 150 cm', 'cte <= 1.5'),
        ('-29cm <= cte', '-0.29 <= cte'),
        ('speed >= 10 kt', f'speed >= {18520 / 3600!r}'),
        ('speed >= 18 km/h', 'speed >= 5'),
        ('speed < 5 m/s', 'speed < 5'),
        ('abs(cte) + 1 ft < 2 * cte_estimate', 'abs(cte) + 0.3048 < 2 * cte_estimate'),
        ('abs(he - 500 mrad) < 1', 'abs(he - 0.5) < 1'),
        ('speed * he <= 1 m/s', 'speed * he <= 1'),
        ('sqrt(cte * cte) <= 1 m', 'sqrt(cte * cte) <= 1'),
        ('unusable_share <= 5 %', 'unusable_share <= 0.05'),
        ('estimate_gap <= 500 ms', 'estimate_gap <= 0.5'),
        ('eventually[0:10 s] always[0:2min] cte < 1 m', 'eventually[0:10](always[0:120](cte < 1))'),
        # What was read before is read as before, whatever it adds up.
        ('cte + he <= 1', 'cte + he <= 1'),
    ],
)
def test_people2_given_a_unit_when_parsed_then_the_formula_is_in_si(
    text: str, printed: str
) -> None:
    assert str(parse_formula(text)) == printed
    assert parse_formula(printed) == parse_formula(text)


@given(st.decimals(0, 10**6, allow_nan=False, places=3), st.sampled_from(sorted(UNITS)))
@fuzz(100)
def test_people2_given_any_number_and_unit_when_parsed_then_it_is_the_exact_value_rounded_once(
    number: Decimal, unit: str
) -> None:
    signals = {'signal': unit}
    parsed = parse(f'signal <= {number:f} {unit}', signals)
    factor = UNITS[unit].factor
    wanted = math.radians(float(number)) if factor is None else float(number * factor)
    assert isinstance(parsed, ast.Compare)
    assert isinstance(parsed.right, ast.Number)
    assert math.isclose(parsed.right.value, wanted, rel_tol=1e-15)


@pytest.mark.parametrize('text', [
    'cte + speed <= 3', 'max(cte, he) <= 3', 'cte <= he', 'cte + speed * 2 s <= 3 m',
    'speed * he + speed <= 3 m/s', 'cte + 1 + cte_estimate <= 3 m', 'min(1, cte, 2) <= 3 m',
    'cte + speed <= 3 and cte <= 3 m', 'cte * cte + x * x <= 9', '1 - he <= 5 deg',
])
def test_people2_attack_given_like_parts_or_no_unit_then_the_formula_is_read(text: str) -> None:
    parse_formula(text)


def test_people2_attack_given_a_signal_without_unit_in_a_sum_then_the_rest_still_counts() -> None:
    signals = {'cte': 'm', 'foo': ''}
    parse('cte + foo <= 3 m', signals)
    for text in ('cte + foo <= 3 deg', 'foo + cte <= 3 deg'):
        with pytest.raises(UsageError, match='expected a length'):
            parse(text, signals)


@pytest.mark.parametrize('number', ['1e-400', '0.01e-400', '1e-400 m', '1e-322 mm', '.2e-999 deg'])
def test_people2_attack_given_a_number_that_vanishes_when_parsed_then_it_is_refused(
    number: str,
) -> None:
    with pytest.raises(UsageError, match='column 8: expected a number of at least 5e-324, or 0'):
        parse_formula(f'cte <= {number}')
    parse_formula('cte <= 0e-400 and cte <= 5e-324 and cte <= 0.00 m and cte > 0e5')


FEW = st.sampled_from([parse(text, ('cte', 'he')) for text in (
    'cte <= 1', 'cte > 1', '1 >= abs(cte)', 'abs(cte) > 1', 'cte < -1', 'cte < he', 'cte >= he',
)])  # fmt: skip


@given(formulas(atoms=FEW), traces())
@fuzz(200)
def test_people2_attack_given_logic_that_settles_itself_then_no_trace_says_otherwise(
    formula: ast.Formula, trace: Trace,
) -> None:
    setting = Setting(units={}, ranges={}, horizon_ns=10**10)
    for line in warnings(Spec(name='a', formula=formula, text=str(formula)), setting):
        part, _, settled = line.removeprefix('a: ').partition(': nothing measured can ')
        if settled:
            rho = robustness(parse(part, ('cte', 'he')), trace.stamps, trace.columns)
            assert rho >= 0 if settled.startswith('violate') else rho <= 0


def test_people2_given_an_own_signal_named_like_a_unit_when_parsed_then_it_is_the_signal() -> None:
    formula = parse('cte <= 3 m / s', {'cte': '', 's': ''})
    assert str(formula) == 'cte <= 3 / s'


@pytest.mark.parametrize('text', [
    'cte < 0' + ' W cte < 1)' * 12, 'not ' * 30 + 'cte < 1', 'cte < 1' + ' and cte < 1' * 60,
])
def test_t12_given_a_formula_whose_text_could_not_be_read_back_when_parsed_then_it_is_refused(
    text: str,
) -> None:
    with pytest.raises(UsageError, match='there may be at most 500 words and 50 levels'):
        parse_formula('(' * text.count(')') + text)
