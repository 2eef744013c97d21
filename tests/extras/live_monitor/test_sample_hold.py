import math

from taxinet_ros.extras.live_monitor.sample_hold import SampleHold

S = 10**9
TOPICS = {'a': '/a', 'b': '/b'}


def feed(holder, *messages):
    """Each message is topic, time [s], value; the samples as (time [s], values, troubles)."""
    return [
        (sample.stamp_ns / S, dict(sample.values), dict(sample.troubles))
        for topic, at_s, value in messages
        if (sample := holder.arrive(topic, round(at_s * S), {topic[1:]: (value, '')}))
    ]


def test_given_a_topic_that_samples_then_the_other_is_held_and_the_first_sample_waits_for_it():
    holder = SampleHold(TOPICS, sampled_on='/a', max_age_ns=S)
    assert feed(holder, ('/a', 1, 10.0)) == []
    assert holder.missing == ['b']
    assert feed(holder, ('/b', 1.1, 5.0), ('/a', 1.5, 11.0), ('/a', 2, 12.0)) == [
        (1.5, {'a': 11.0, 'b': 5.0}, {}), (2.0, {'a': 12.0, 'b': 5.0}, {}),
    ]


def test_given_a_held_value_that_is_too_old_then_it_is_none_until_the_next_one():
    holder = SampleHold(TOPICS, sampled_on='/a', max_age_ns=S)
    feed(holder, ('/b', 0, 5.0), ('/a', 0, 1.0))
    (late, fresh) = feed(holder, ('/a', 1.5, 2.0), ('/b', 1.6, 6.0), ('/a', 2.0, 3.0))
    assert math.isnan(late[1]['b'])
    assert late[2] == {'b': 'b is 1.500 s old (max_age 1 s)'}
    assert fresh == (2.0, {'a': 3.0, 'b': 6.0}, {})


def test_given_no_max_age_then_a_value_is_held_for_ever():
    holder = SampleHold(TOPICS, sampled_on='/a')
    samples = feed(holder, ('/b', 0, 5.0), ('/a', 9000, 1.0))
    assert samples == [(9000.0, {'a': 1.0, 'b': 5.0}, {})]


def test_given_a_held_topic_whose_stamps_go_back_then_its_value_is_none_until_in_order():
    holder = SampleHold(TOPICS, sampled_on='/a', max_age_ns=S)
    feed(holder, ('/b', 1, 5.0), ('/a', 1, 1.0))
    back, good = feed(
        holder, ('/b', 0.9, 7.0), ('/a', 1.1, 2.0), ('/b', 1.2, 6.0), ('/a', 1.2, 3.0)
    )
    assert math.isnan(back[1]['b'])
    assert back[2] == {'b': 'stamps of /b went back by 0.1 s'}
    assert good == (1.2, {'a': 3.0, 'b': 6.0}, {})


def test_given_values_of_two_clocks_then_no_stretch_begins():
    holder = SampleHold(TOPICS, sampled_on='/a', max_age_ns=S)
    assert feed(holder, ('/b', 1.7e6, 5.0), ('/a', 1, 1.0), ('/a', 2, 1.0)) == []


def test_given_a_restart_then_stamps_may_begin_anew_and_the_first_sample_waits_again():
    holder = SampleHold(TOPICS, sampled_on='/a', max_age_ns=S)
    feed(holder, ('/b', 50, 5.0), ('/a', 50, 1.0))
    holder.restart()
    assert feed(holder, ('/a', 0.5, 2.0)) == [], 'what is held of b is from before'
    assert feed(holder, ('/b', 0.6, 6.0), ('/a', 0.7, 3.0)) == [(0.7, {'a': 3.0, 'b': 6.0}, {})]
