"""What the samplers say of weights and of what they learn, and what making one refuses.

What every sampler has to do is checked by the contract kit (tests/test_testing.py).
"""

from __future__ import annotations

import numpy as np
import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.histogram import Product
from taxinet_ros.samplers.registry import SAMPLERS, make_sampler
from taxinet_ros.samplers.sampler import split_options
from taxinet_ros.samplers.space import Branch, Dimension, Point, make_space

SPACE = (
    Dimension(name='x'),
    Dimension(name='weather', weights=(2, 0, 1)),
    Dimension(name='y', buckets=3),
)
RUNS = 19
WEIGHTED = ('random', 'halton', 'sobol', 'grid', 'ce', 'mab')
HISTOGRAMS = ('ce', 'mab')
RULE = {'rule': 'verifai'}


def bowl(point: Point) -> float:
    return sum((quantile - 0.2) ** 2 for quantile in point) - 0.1


def run(name: str, seed: int, rho=bowl, **options: str | float) -> list[Point]:
    sampler = make_sampler(name, SPACE, seed, RUNS, **options)
    points = []
    for _ in range(RUNS):
        index, point = sampler.next()
        points.append(point)
        sampler.tell(index, rho(point))
    return points


@pytest.mark.parametrize('name', SAMPLERS)
def test_given_a_sampler_then_known_densities_have_weights_and_histograms_are_probabilities(
    name: str
) -> None:
    learned = make_sampler(name, SPACE, 1, RUNS).learned()
    if name in HISTOGRAMS:
        assert list(learned) == [dimension.name for dimension in SPACE]
        assert learned['weather'] == pytest.approx((2 / 3, 0, 1 / 3))
        assert len(learned['x']) == 10
    else:
        assert learned == {}
    sampler = make_sampler(name, SPACE, (1 << 63) - 1, RUNS)
    weights = [sampler.weight(sampler.next()[0]) for _ in range(5)]
    if name in WEIGHTED:
        assert all(weight is not None and 0 < weight < 12 for weight in weights)
    else:
        assert weights == [None] * 5


@pytest.mark.parametrize('name', SAMPLERS)
def test_given_runs_without_results_when_told_then_nothing_is_learned_of_them(name: str) -> None:
    points = run(name, 1, rho=lambda point: None)
    assert points[:8] == run(name, 1)[:8]
    assert 0.3 < np.mean([point[0] for point in points]) < 0.7
    if name == 'ce':
        np.testing.assert_allclose(points, run('random', 1), atol=1e-12)


@pytest.mark.parametrize(
    ('name', 'seed', 'options', 'message'),
    [
        ('cma', 0, {}, r"sampler 'cma' is unknown; did you mean cmaes\?; known: random, .*;"),
        ('ce', -1, {}, r'seed is -1'),
        ('ce', 0, {'flor': '0.3'}, r'sampler ce: unknown option flor; known: floor, every$'),
        ('random', 0, {'floor': '0.3'}, r'unknown option floor; known: none$'),
        ('ce', 0, {'floor': 'a'}, r"sampler ce: floor=a: 'a' is no number"),
        ('ce', 0, {'floor': '0'}, r'sampler ce: floor=0: needs to be within 0.01..1'),
        ('ce', 0, {'floor': 'nan'}, r'floor=nan: needs to be within'),
        ('ce', 0, {**RULE, 'alpha': '1'}, r'alpha=1: needs to be within 0.5..0.99999'),
        ('ce', 0, {'alpha': '0.9'}, r'unknown option alpha; known: floor, every$'),
        ('ce', 0, {**RULE, 'every': '5'}, r'unknown option every; known: floor, alpha$'),
        ('ce', 0, {'rule': 'mine'}, r'rule=mine: unknown; known: verifai, or leave it out$'),
        ('mab', 0, RULE, r'sampler mab: unknown option rule; known: floor, explore$'),
        ('bo', 0, {'window': '12.5'}, r'window=12.5: needs to be a whole number'),
    ],
)
def test_given_a_bad_word_or_option_when_made_then_one_line_says_what_is_known(
    name: str, seed: int, options, message: str
) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        make_sampler(name, SPACE, seed, RUNS, **options)
    assert '\n' not in str(caught.value)


def test_given_options_as_text_or_numbers_when_made_then_they_act() -> None:
    assert run('ce', 1, floor='1') == run('random', 1)
    assert run('ce', 1, floor=1.0) == run('random', 1)
    assert run('ce', 1, every='2') != run('ce', 1)


def test_given_key_value_texts_when_split_then_they_are_checked() -> None:
    assert split_options(['floor=0.1', ' every = 5 ']) == {'floor': '0.1', 'every': '5'}
    assert split_options([]) == {}
    for text in ('floor', '=1', 'floor='):
        with pytest.raises(UsageError, match='expected key=value'):
            split_options([text])
    with pytest.raises(UsageError, match='floor is given twice'):
        split_options(['floor=1', 'floor=1'])


CONDITIONAL = make_space((
    Dimension(name='kind', weights=(3, 1)),
    Dimension(name='dry', weights=(1, 1), when=(Branch('kind', (0,)),)),
    Dimension(name='rain', buckets=4, when=(Branch('kind', (1,)),)),
    Dimension(name='x'),
))


def wet_failures(point: Point) -> float:
    """Fails in heavy rain: the last quarter of a quarter of the prior."""
    rain = point[2]
    return 1.0 if rain is None else 0.75 - rain


@pytest.mark.nightly
@pytest.mark.parametrize(('name', 'options', 'least'), [
    ('ce', {}, 0.45), ('mab', {}, 0.45),
    ('ce', {**RULE, 'alpha': 0.995}, 0.25),  # lest weights be too uneven to tell
])
def test_s9_given_idle_dimensions_when_learned_and_weighted_then_they_have_no_part(
    name: str, options, least: float
) -> None:
    learned, weights, terms = [], [], []
    for seed in range(4):
        sampler = make_sampler(name, CONDITIONAL, seed, 400, **options)
        for _ in range(400):
            index, point = sampler.next()
            sampler.tell(index, wet_failures(point))
            weights.append(sampler.weight(index))
            terms.append(weights[-1] * (point[2] is not None and point[2] < 0.25))
        learned.append(sampler.learned())
    # No failure is dry, so of the dry options nothing is known.
    assert np.mean([each['dry'] for each in learned], axis=0) == pytest.approx([0.5, 0.5], abs=0.1)
    assert min(each['rain'][3] for each in learned) > least
    for values, expected in ((weights, 1), (terms, 1 / 16)):
        error = np.std(values) / np.sqrt(len(values))
        assert np.mean(values) == pytest.approx(expected, abs=4 * error)


def test_s9_given_idle_dimensions_when_learned_histograms_propose_then_weights_ignore_them() -> (
    None
):
    histograms = [np.array([0.5, 0.5]), np.array([0.9, 0.1]), np.array([0.7, 0.1, 0.1, 0.1]),
                  np.full(10, 0.1)]
    product = Product(CONDITIONAL, histograms)
    assert product.density(CONDITIONAL.bins((0.1, 0.2, None, 0.5))) == pytest.approx(1.8 / 1.5)
    assert product.density(CONDITIONAL.bins((0.9, None, 0.1, 0.5))) == pytest.approx(2 * 2.8)


def test_s9_given_a_conditional_space_when_optuna_searches_then_it_finds_the_branch() -> None:
    for name, least in (('tpe', 30), ('bo', 10), ('cmaes', 20)):
        runs = 40 if name == 'bo' else 150
        sampler = make_sampler(name, CONDITIONAL, 3, runs)
        failed = 0
        for _ in range(runs):
            index, point = sampler.next()
            rho = wet_failures(point)
            failed += rho <= 0
            sampler.tell(index, rho)
        assert failed >= least, name  # by chance it were 9, and 2.5 of 40
