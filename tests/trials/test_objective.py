"""Rulebooks: the order of runs that break rules, what samplers make of it, and refusals."""

from __future__ import annotations

import math

import pytest

import taxinet_ros as tx
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.mtl.interval import exact_intervals
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.space import Dimension
from taxinet_ros.trials.objective import parse_objective

NAMES = ('a', 'b', 'c', 'd')


def value(text: str, *rho: float) -> float | None:
    return parse_objective(text, NAMES).value(exact_intervals(dict(zip(NAMES, rho, strict=False))))


def test_given_a_rulebook_then_each_level_counts_a_tenth_of_the_one_above() -> None:
    assert value('a > b', 1.0, -1.0) == pytest.approx(0.5 - 0.05)
    assert value('a > b, c', -3.0, 9.0, -1.0) == pytest.approx(-0.75 - 0.05)
    assert value('b > a', 1.0, -1.0) == pytest.approx(-0.5 + 0.05)
    assert value('a > b > c', -1.0, -1.0, 1.0) == pytest.approx(-0.5 - 0.05 + 0.005)
    # A fifth of the first outweighs all of the second.
    assert value('a > b', 0.2, 1e9) < value('a > b', 0.7, -1e9)


def test_given_one_level_then_it_is_the_least_robustness() -> None:
    assert value('a, c', 3.0, -9.0, 2.0) == 2.0
    assert value('a, b', 3.0, -9.0, 2.0) == -9.0


def test_given_a_run_that_was_stopped_then_what_is_not_known_is_not_taken_for_good() -> None:
    unknown = RobustnessInterval(-math.inf, math.inf)
    good, bad = RobustnessInterval(2.0, 3.0), RobustnessInterval(-math.inf, -1.0)
    equal, ranked = (parse_objective(text, NAMES) for text in ('a, b', 'a > b'))
    assert equal.value({'a': unknown, 'b': good}) is None
    assert equal.value({'a': unknown, 'b': bad}) == -1.0
    assert ranked.value({'a': unknown, 'b': bad}) is None
    assert ranked.value({'a': good, 'b': bad}) == pytest.approx(2 / 3 - 0.05)


def test_given_a_rare_important_rule_when_searched_then_the_rulebook_breaks_it_more_often() -> None:
    space = tuple(Dimension(name=f'x{number}') for number in range(5))

    def rules(point) -> dict[str, float]:
        # The second rule is broken far and in half of the space, the first in 2 %, elsewhere;
        # three dimensions do not matter.
        return {'a': abs(point[0] - 0.9) + abs(point[1] - 0.9) - 0.1, 'b': 4 * (point[0] - 0.5)}

    def broken(text: str) -> int:
        book, sampler = parse_objective(text, NAMES), make_sampler('tpe', space, 3, 100)
        count = 0
        for _ in range(100):
            index, point = sampler.next()
            rho = rules(point)
            count += rho['a'] <= 0
            sampler.tell(index, book.value(exact_intervals(rho)))
        return count

    assert broken('a > b') > 20 > broken('a, b')


@pytest.mark.parametrize(('asked', 'said'), [
    ({'objective': 'phi_always > nothing'}, "'nothing' is no requirement of this search"),
    ({'objective': 'phi_always > phi_always'}, 'phi_always is named twice'),
    ({'objective': 'on_runway'}, 'given as the first'),
    ({'objective': 'on_runway >'}, "'' is no requirement"),
    ({'objective': 'on_runway, phi_always', 'sampler': 'halton'}, 'no effect on .*sampler halton'),
    ({'objective': 'on_runway > phi_always', 'sampler': 'active'}, 'use one of tpe, bo, cmaes'),
])
def test_given_an_objective_that_cannot_be_then_one_line_says_so(asked, said, tmp_path) -> None:
    with pytest.raises(UsageError, match=said):
        tx.falsify('s_falsif', specs=('phi_always', 'on_runway'), out=tmp_path / 'out', **asked)


def test_given_an_objective_when_searched_then_it_is_recorded_and_resumed(tmp_path) -> None:
    asked = {
        'perception': 'truth', 'sampler': 'tpe', 'sampler_options': {'floor': 0, 'startup': 2},
        'settings': {'duration': 2}, 'specs': ('phi_always', 'on_runway'), 'lag': 1,
    }
    whole = tx.falsify('s_falsif', runs=5, out=tmp_path / 'whole', **asked,
                       objective='on_runway > phi_always')
    assert whole.facts['objective'] == 'on_runway > phi_always'
    with pytest.raises(UsageError, match='objective'):
        tx.falsify('s_falsif', runs=6, out=tmp_path / 'whole', resume=True, **asked)
    again = tx.falsify('s_falsif', runs=6, out=tmp_path / 'whole', resume=True, **asked,
                       objective='on_runway > phi_always')
    assert len(again.rows) == 6
    plain = tx.falsify('s_falsif', runs=2, out=tmp_path / 'plain', **asked)
    assert 'objective' not in plain.facts
