from __future__ import annotations

import dataclasses
import enum
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, json_text, load_yaml, parse_yaml, typed

FILE = Path('a.yaml')


def section(text: str, **words: object) -> Section:
    return Section(FILE, parse_yaml(FILE, text.encode(), about='it: '), about='it: ', **words)


def test_given_a_file_when_asked_then_it_hands_out_what_is_there_and_else_the_default() -> None:
    top = section('{n: 3, x: 2, on_: true, w: red, l: [1, 2.5], s: {t: a}, many: [a, b], one: c}')
    assert (top.whole('n', 0), top.whole('m', 0, default=7)) == (3, 7)
    assert (top.number('x', 0, 2), top.switch('on_'), top.word('w', ('red', 'blue'))) == (
        2.0, True, 'red'
    )
    assert top.numbers('l', 2, 0, 3) == (1.0, 2.5)
    assert top.section('s', ('t',)).text('t') == 'a'
    assert list(top.section('gone', optional=True)) == []
    assert [one.text('many') for one in top.several('many')] == ['a', 'b']
    assert [one.text('one') for one in top.several('one')] == ['c']


@pytest.mark.parametrize(('text', 'look', 'complaint'), [
    ('[1]', lambda top: None, 'it: a.yaml: expected KEY: VALUE pairs, got [1]'),
    ('on: 1', lambda top: None,
     "it: a.yaml: expected words as keys, got True; put it in '…' quotes"),
    ('s: {t: {u: 1}}', lambda top: top.section('s').section('t', ('v', 'w')),
     'it: a.yaml: s.t.u: unknown key; known: v, w'),
    ('s: {}', lambda top: top.section('s').whole('n', 1, 9),
     "it: a.yaml: s: the key 'n' is missing; expected a whole number, 1 to 9"),
    ('s: {n: 1.0}', lambda top: top.section('s').whole('n', 1),
     'it: a.yaml: s.n: expected a whole number, 1 or more, got 1.0'),
    ('x: 1e2', lambda top: top.number('x', 0),
     "it: a.yaml: x: expected a number, 0 or more, got '1e2'; write it as 0.5 or 1.0e-3"),
    ('x: 75 ft', lambda top: top.number('x', 0),
     "it: a.yaml: x: expected a number, 0 or more, got '75 ft'; without a unit: it is that of the "
     'key'),
    ('x: .inf', lambda top: top.number('x', 0),
     'it: a.yaml: x: expected a number, 0 or more, got inf'),
    ('l: [{a: 1}, {b: 1}]', lambda top: top.sections('l', ('a',)),
     'it: a.yaml: l[1].b: unknown key; known: a'),
    ('l: [a, a]', lambda top: top.several('l'),
     "it: a.yaml: l: expected one or several, each once, got ['a', 'a']"),
    ('a: 1\na: 2', lambda top: None, 'it: a.yaml: line 2, column 1: a is given twice'),
    ('<<: {a: 1}', lambda top: None,
     'it: a.yaml: line 1, column 1: a merge key (<<) is not read; write it out'),
])
def test_given_what_is_wrong_then_one_line_has_file_key_and_what_is_expected(
    text, look, complaint
) -> None:
    with pytest.raises(UsageError) as caught:
        look(section(text))
    assert str(caught.value) == complaint


@pytest.mark.parametrize('text', ['a: 1\na: 2', 'b: &b {a: 1}\nc: {<<: *b}'])
def test_given_yaml_of_a_bag_with_a_key_twice_or_a_merge_key_then_it_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match='not YAML of plain values'):
        load_yaml(text)


@pytest.mark.parametrize('text', ['- ' * 200_000 + 'x', '? ' * 200_000 + 'x', '[' * 200_000,
                                  ''.join(f'{" " * at}a:\n' for at in range(200))])
def test_given_yaml_of_a_bag_that_is_nested_too_deeply_then_it_is_refused_at_once(
    text: str
) -> None:
    with pytest.raises(ValueError, match='not YAML of plain values'):
        load_yaml(text)


def test_given_yaml_of_a_bag_when_aliases_are_not_allowed_then_it_is_refused() -> None:
    assert load_yaml('a: &one [1]\nb: *one') == {'a': [1], 'b': [1]}
    with pytest.raises(ValueError, match='not YAML of plain values'):
        load_yaml('a: &one [1]\nb: *one', aliases=False)


class Word(enum.StrEnum):
    ONE = 'one'


class Pair(NamedTuple):
    low: float
    high: float


@dataclass
class Result:
    pair: Pair
    word: Word
    path: Path
    numbers: tuple[float, ...]


@dataclass
class Results:
    by_name: Mapping[str, Pair]
    named: tuple[tuple[str, Result], ...]
    keys: frozenset[str]
    best: Result | None = None
    other: Word | None = None


def test_a_result_becomes_plain_values_of_json():
    found = Result(Pair(0.5, math.inf), Word.ONE, Path('a/b'), (math.nan, np.float64(2.0)))
    assert json.loads(json_text({'found': found, 'all': np.array([1, 2])})) == {
        'found': {
            'pair': {'low': 0.5, 'high': None}, 'word': 'one', 'path': 'a/b',
            'numbers': [None, 2.0],
        },
        'all': [1, 2],
    }


def test_a_dataclass_comes_back_from_its_plain_values():
    result = Result(Pair(-math.inf, 0.5), Word.ONE, Path('a/b'), (1 / 3,))
    found = Results({'f': Pair(0.1, 0.2)}, (('one', result),), frozenset(['x']), best=result)
    values = json.loads(json.dumps(dataclasses.asdict(found), default=lambda one: (
        sorted(one) if isinstance(one, frozenset) else str(one))))
    assert typed(Results, values) == found
    for wrong in ({**values, 'more': 1}, {'keys': []}, {**values, 'other': 'two'}):
        with pytest.raises((TypeError, ValueError)):
            typed(Results, wrong)
