"""Requirements out of YAML files: written out for the bag, refused with file, key and column."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.requirements import read_specs

FILE = """\
predicates:
  on_centreline: abs(cte) <= 1.5
  fine: on_centreline and abs(he) <= 0.3
specs:
  reach: 'F[0, 10] G on_centreline'
  gentle: 'always[10 s:inf](abs(steering) <= 3 deg)'
  both: G fine
"""


@pytest.fixture
def write(tmp_path: Path):
    def write(text: str, name: str = 'specs.yaml') -> str:
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write


def test_given_a_file_when_read_then_its_formulas_come_in_order_with_predicates_written_out(write):
    texts = read_specs([write(FILE)])
    assert texts == (
        'reach=eventually[0:10](always(abs(cte) <= 1.5))',
        f'gentle=always[10:inf](abs(steering) <= {math.radians(3)!r})',
        'both=always((abs(cte) <= 1.5) and (abs(he) <= 0.3))',
    )
    assert parse_spec(texts[0]).formula == parse_spec('phi_eventually').formula


def test_given_words_around_a_file_then_later_ones_use_its_predicates_and_order_is_kept(write):
    texts = read_specs(['phi_always', write(FILE), 'soon=F[0,2] on_centreline', 'G fine'])
    specs = [parse_spec(text) for text in texts]
    assert [spec.name for spec in specs][:5] == ['phi_always', 'reach', 'gentle', 'both', 'soon']
    assert texts[4] == 'soon=eventually[0:2](abs(cte) <= 1.5)'
    assert specs[5].formula == specs[3].formula
    assert specs[5].name.startswith('spec_')


def test_given_words_without_a_file_then_they_stay_as_they_were_typed():
    words = ['phi_eventually', 'near = G abs(cte)<1', 'always(speed < 6)']
    assert read_specs(words) == tuple(words)
    assert read_specs([]) == ()


def test_given_a_file_when_a_campaign_is_asked_for_then_its_first_formula_is_the_headline(write):
    options = make_options(
        program='nominal', runs=1, seed=0, perception='truth', settings=(), out=None,
        specs=[write(FILE)], processes=False,
    )
    assert list(options.judging.names) == ['reach', 'gentle', 'both']


@pytest.mark.parametrize(('text', 'complaint'), [
    ("specs:\n  reach: 'F[0, 10] G cte <='\n", r'specs\.reach: column 18: expected a signal'),
    ('specs:\n  a: F[0, 10 G cte < 1\n', r"specs\.a: column 9: expected '\]'"),
    ('specs:\n  reach: G near\n', r"specs\.reach: column 3: expected a signal, got unknown 'near'"),
    ('predicates:\n  p: cte +\n', r'predicates\.p: column 6: expected a signal'),
    ('predicates:\n  q: p\n  p: cte < 1\n', r"predicates\.q: column 1: .* unknown 'p'"),
    ('predicates:\n  cte: cte < 1\n', r'predicates\.cte: choose another name'),
    ('predicates:\n  my-p: cte < 1\n', r'predicates\.my-p: choose another name'),
    ('specs:\n  Reach: G cte < 1\n', r'specs\.Reach: .*snake_case'),
    ('specs:\n  phi_always: G cte < 1\n', r'specs\.phi_always: .*shipped as always'),
    ('specs:\n  a: G cte < 1\n  a: G cte < 2\n', r'line 3, column 3: a is given twice$'),
    ('specs: {a: F[0, 1] cte < 1}\n', r"line 1, column 13: .* needs '…' quotes around it"),
    ('specs:\n  a: 5\n', r'specs\.a: expected a formula, got 5'),
    ('specs: [G cte < 1]\n', 'specs: expected KEY: VALUE pairs, got '),
    ('formulas: {}\n', 'formulas: unknown key; known: predicates, specs'),
    ('', 'expected KEY: VALUE pairs with the keys predicates, specs, got None'),
    ('specs:\n', 'has no formulas'),
    ('specs: !!python/object/apply:os.getpid []\n', 'could not determine a constructor'),
    (f'predicates:\n  p: {" and ".join(["cte < 1"] * 40)}\nspecs:\n  a: G (p and p)\n',
     r'specs\.a: .*at most 500 words'),
])
def test_given_a_bad_file_then_one_line_names_file_and_place(write, text, complaint):
    path = write(text)
    with pytest.raises(UsageError, match=complaint) as caught:
        read_specs([path])
    assert str(caught.value).startswith(f'{path}: ')
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('words', 'complaint'), [
    (['phi_always', 'phi_always'], 'phi_always is given twice'),
    (['none.yaml'], r'specs none\.yaml: cannot be read: No such file'),
    (['word'], "unknown name 'word'"),
])
def test_given_bad_words_then_one_line_says_so(words, complaint):
    with pytest.raises(UsageError, match=complaint):
        read_specs(words)


def test_given_predicates_and_no_formula_then_that_is_refused(write):
    only = write('predicates:\n  p: cte < 1\n')
    with pytest.raises(UsageError, match='only predicates are given'):
        read_specs([only])
    assert read_specs([only, 'q=G p']) == ('q=always(cte < 1)',)
