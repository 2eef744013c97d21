"""When answers take effect: the words for it, the draws, and which answer holds when."""

from __future__ import annotations

import itertools
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, rolling_on
from taxinet_ros.core.loop import LateCommands
from taxinet_ros.core.pacing.timing import (
    AT_ONCE,
    LateAnswers,
    free_timing,
    parse_latency,
    parse_timing,
    timing_of,
)
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.errors import UsageError

FIRST = rolling_on(5.0)


def commands(count: int) -> list[TaxiCommand]:
    """Each its own step's: the steering angle tells which."""
    return [TaxiCommand(steering_rad=seq / 1000, speed_mps=4.0) for seq in range(count)]


def held(latency: str, count: int = 40, seed: int = 1, index: int = 0) -> list[int]:
    """Which frame's command holds from each step on; -1 for none."""
    late = LateCommands(parse_latency([latency]), seed, index, Scenario())
    frames = {command: seq for seq, command in enumerate(commands(count))}
    frames[FIRST] = -1
    return [frames[late.at(seq, command)] for seq, command in enumerate(commands(count))]


def test_r5_given_no_latency_then_each_answer_holds_at_once():
    assert held('') == held('perception=0 controller=0') == list(range(40))


@pytest.mark.parametrize(('latency', 'steps'), [
    ('perception=0.3', 3), ('perception=0.1', 1), ('perception=0.05', 1), ('perception=0.101', 2),
    ('perception=0.05 controller=0.05', 1), ('controller=0.2 perception=0.15', 4),
])
def test_r5_given_a_constant_latency_then_it_is_the_next_whole_number_of_steps(latency, steps):
    assert held(latency) == [max(seq - steps, -1) for seq in range(40)]


LATENCIES = st.lists(st.integers(0, 9 * CONTROL_PERIOD_NS), min_size=1, max_size=60)


@given(LATENCIES)
def test_r5_given_any_latencies_then_no_answer_is_of_the_future_and_none_is_overtaken(latencies):
    answers = LateAnswers(-1)
    dues: list[int] = []
    for seq, latency_ns in enumerate(latencies):
        now = seq * CONTROL_PERIOD_NS
        dues.append(now + latency_ns)
        answers.put(seq, dues[seq], seq)
        # Said once more, without a queue: the newest of all that are due.
        expected = max((k for k, due in enumerate(dues) if due <= now), default=-1)
        assert answers.newest(now) == answers.held == expected


DRAWN = 'perception=normal(0.15,0.05) controller=uniform(0,0.1)'


def test_r5_given_a_seed_and_an_index_then_the_draws_are_those_and_no_others():
    assert held(DRAWN) == held(DRAWN)
    assert len({tuple(held(DRAWN, seed=seed, index=i)) for seed in (1, 2) for i in (0, 1)}) == 4
    fixed = parse_latency([DRAWN]).of_run(1, 0)
    assert held(fixed.latency, seed=9, index=9) == held(DRAWN)
    assert fixed.of_run(5, 5) == fixed
    assert parse_latency(['perception=0.2']).of_run(1, 0).draws is None, 'it draws nothing'


def test_r5_given_another_name_then_its_draws_change_nothing_in_the_first():
    one = parse_latency(['perception=uniform(0,1)']).latencies_ns(1, 2)
    both = parse_latency(['perception=uniform(0,1)', 'controller=0.5']).latencies_ns(1, 2)
    for alone, with_other in itertools.islice(zip(one, both, strict=False), 50):
        assert with_other - alone == 500_000_000


@pytest.mark.parametrize(('law', 'mean', 'low', 'high'), [
    ('uniform(0.05,0.3)', 0.175, 0.05, 0.3),
    ('normal(0.15,0.05)', 0.150, 0.0, 0.4),
    # A half normal, mean sd sqrt(2/pi): what is below 0 is cut off, not heaped up there.
    ('normal(0,0.5)', 0.399, 0.0, 2.5),
])
def test_r5_given_a_law_then_latencies_are_distributed_so(law, mean, low, high):
    drawn = [ns / 1e9 for ns in itertools.islice(
        parse_latency([f'perception={law}']).latencies_ns(3, 4), 4000)]
    assert statistics.mean(drawn) == pytest.approx(mean, abs=0.02)
    assert low <= min(drawn) <= max(drawn) <= high
    assert drawn.count(0.0) == 0


NUMBERS = st.floats(0, 30).map(lambda x: x + 0.0)
WORDS = st.one_of(
    NUMBERS.map(lambda x: f'{x!r}'),
    st.tuples(NUMBERS, NUMBERS).filter(lambda p: p[0] != p[1]).map(
        lambda p: f'uniform({min(p)!r},{max(p)!r})'),
    st.tuples(NUMBERS, st.floats(1e-6, 30)).map(lambda p: f'normal({p[0]!r},{p[1]!r})'),
)


@given(WORDS, WORDS, st.none() | st.tuples(st.integers(-2**63, 2**63 - 1), st.integers(0, 2**31)))
def test_r5_given_any_timing_then_its_words_read_back_to_the_bit(perception, controller, draws):
    timing = parse_latency([f'perception={perception}', f'controller={controller}'])
    timing = timing if draws is None else timing.of_run(*draws)
    assert parse_timing(timing.words) == timing
    assert next(timing.latencies_ns(1, 1)) >= 0


def test_r5_given_no_words_then_answers_take_effect_at_once():
    assert parse_timing('') == AT_ONCE == parse_latency([])
    assert AT_ONCE.words == ''


@pytest.mark.parametrize('words', [
    'perception', 'perception=', '=0.1', 'camera=0.1', 'perception=-0.1', 'perception=nan',
    'perception=31', 'perception=normal(0.1)', 'perception=normal(0.1,0)', 'draws=1',
    'perception=uniform(0.3,0.1)', 'perception=gamma(1,2)', 'perception=0.1 perception=0.2',
    'perception=normal(0.1,0.2', 'perception=0.1s',
])
def test_r5_given_words_that_are_none_then_one_line_names_them(words):
    with pytest.raises(UsageError, match=r'^latency \w*') as raised:
        parse_latency([words])
    assert '\n' not in str(raised.value)


def test_given_the_simulators_parameters_then_one_without_effect_is_refused():
    assert timing_of('', lockstep=True, factor=1.0) == AT_ONCE
    assert timing_of('', lockstep=False, factor=0.5) == free_timing('0.5')
    late = timing_of('perception=0.15', lockstep=True, factor=1.0)
    assert late == parse_latency(['perception=0.15'])
    with pytest.raises(UsageError, match='real_time_factor: no effect in lockstep'):
        timing_of('', lockstep=True, factor=2.0)
    with pytest.raises(UsageError, match=r'latency perception=0\.15: no effect in a free run'):
        timing_of('perception=0.15', lockstep=False, factor=1.0)
