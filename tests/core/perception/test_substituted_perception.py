"""What may take a network's place: each substitution on its own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.perception.substituted import (
    AS_RECORDED,
    TRUTH_CTE,
    TRUTH_HEADING,
    parse_substitution,
    substituted,
)
from taxinet_ros.core.types import NO_ESTIMATE, TrackingError
from taxinet_ros.errors import UsageError

ERRORS = st.builds(TrackingError, cte_m=st.floats(-20, 20), he_rad=st.floats(-1.5, 1.5))


class Wrong(Perception):
    """A network that is wrong in a way one can foresee."""

    word, fingerprint, needs_image = 'wrong', 'abc', True

    def estimate(self, image, truth):
        if truth is None:
            return NO_ESTIMATE
        return TrackingError(cte_m=truth.cte_m + 1.0, he_rad=truth.he_rad - 0.25)


class Lost(Wrong):
    """A network without an answer."""

    def estimate(self, image, truth):
        return NO_ESTIMATE


def made(word, seed=(1, 2), network=Wrong):
    return substituted(parse_substitution(word), network(), seed)


@given(ERRORS)
def test_given_one_true_half_then_the_other_is_the_networks(truth):
    seen = Wrong().estimate(None, truth)
    heading = made(TRUTH_HEADING).estimate(None, truth)
    cte = made(TRUTH_CTE).estimate(None, truth)
    assert (heading.cte_m, heading.he_rad) == (seen.cte_m, truth.he_rad)
    assert (cte.cte_m, cte.he_rad) == (truth.cte_m, seen.he_rad)
    assert made('truth').estimate(None, truth) == truth
    assert made(AS_RECORDED).estimate(None, truth) == seen


def test_given_a_network_without_an_answer_then_half_the_truth_is_none_either():
    truth = TrackingError(cte_m=1.0, he_rad=0.0)
    for word in (TRUTH_HEADING, TRUTH_CTE):
        assert not made(word, network=Lost).estimate(None, truth).usable


def test_given_no_truth_then_neither_is_its_half():
    for word in (TRUTH_HEADING, TRUTH_CTE):
        assert not made(word).estimate(None, None).usable


@given(st.integers(1, 40), st.lists(ERRORS, min_size=1, max_size=80), st.booleans())
def test_given_a_delay_then_estimates_come_so_many_steps_late(steps, truths, true):
    late = made(f'{"truth-" if true else ""}delayed:{steps / 10:g}')
    network = made('truth') if true else Wrong()
    answers = [late.estimate(None, truth) for truth in truths]
    for step, answer in enumerate(answers):
        assert answer == network.estimate(None, truths[max(step - steps, 0)])
    assert late.needs_image is not true


def test_given_noise_then_it_has_the_size_and_the_memory_asked_for_from_the_first_step_on():
    truth = TrackingError(cte_m=3.0, he_rad=0.1)
    paths = np.array([
        [noisy.estimate(None, truth).cte_m - 3.0 for _ in range(31)]
        for noisy in (made('noisy:0.8', (7, index)) for index in range(3000))
    ])
    assert paths.mean(axis=0) == pytest.approx(0.0, abs=0.06)
    assert paths.std(axis=0) == pytest.approx(0.8, abs=0.05)
    for lag in (1, 10, 30):
        correlation = np.corrcoef(paths[:, 0], paths[:, lag])[0, 1]
        assert correlation == pytest.approx(math.exp(-lag / 10), abs=0.06)
    assert made('noisy:0.8').estimate(None, truth).he_rad == 0.1


@given(st.integers(0, 2**40), st.integers(0, 10**6))
def test_given_equal_seeds_then_the_noise_is_equal_and_other_runs_have_another(seed, index):
    truth = TrackingError(cte_m=0.0, he_rad=0.0)
    one, same, other = (made('noisy:1', (seed, at)) for at in (index, index, index + 1))
    errors = [[p.estimate(None, truth).cte_m for _ in range(5)] for p in (one, same, other)]
    assert errors[0] == errors[1] != errors[2]


@pytest.mark.parametrize(
    ('word', 'says'),
    [
        ('turth', 'known: as-recorded, truth, truth-heading, truth-cte, delayed:SECONDS'),
        ('delayed', 'needs an amount above 0 up to 30 s, as in delayed:0.5'),
        ('delayed:0.25', 'a delay has to be a multiple of 0.1 s'),
        ('delayed:-1', 'needs an amount'),
        ('noisy:inf', 'needs an amount above 0 up to 20 m'),
        ('noisy:nan', 'needs an amount'),
        ('truth:3', 'unknown'),
    ],
)
def test_given_a_word_that_is_none_then_one_line_says_what_is(word, says):
    with pytest.raises(UsageError) as error:
        parse_substitution(word)
    assert says in str(error.value)
    assert '\n' not in str(error.value)


def test_given_a_word_then_it_is_read_back_from_how_it_is_written():
    for word in ('truth', 'truth-delayed:0.5', 'noisy:1.5', 'delayed:30'):
        assert parse_substitution(word).word == word
    assert parse_substitution(' delayed: 0.50').word == 'delayed:0.5'
