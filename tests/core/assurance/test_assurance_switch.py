"""The simplex switch: it latches, records why, and each fallback does what it says."""

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.core.assurance.monitor import RuntimeMonitor, monitor_doubts
from taxinet_ros.core.assurance.switch import (
    SLOW_MPS,
    Assured,
    Parts,
    check_controller,
    make_controller,
    monitored,
    named_parts,
    parts_of,
)
from taxinet_ros.core.fork import ReplayedController
from taxinet_ros.core.motion.controller import STOP, SteeringGains, SteeringLaw
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.errors import UsageError

IMAGE = np.zeros((200, 360, 3), np.uint8)
LEFT = TrackingError(cte_m=1.0, he_rad=0.0)
PLAIN = TaxiCommand(
    steering_rad=-1.6 * SteeringGains().cte_gain_rad_per_m, speed_mps=5.0
)


class Scripted(RuntimeMonitor):
    """Gives a list of scores."""

    word, fingerprint = 'scripted', 'f'

    def __init__(self, scores):
        self.script, self.seen = scores, []

    def begin(self, scenario):
        self.seen = []

    def scores(self, seen):
        self.seen.append(seen)
        return {'calm': 0.1, 'bad': self.script[len(self.seen) - 1]}


class Right(Perception):
    """Sees the aircraft on the right of its line, whatever the picture."""

    word, fingerprint, needs_image = 'right', 'r', True

    def estimate(self, image, truth):
        assert image is not None
        assert truth is None
        return TrackingError(cte_m=-1.0, he_rad=0.0)


def drive(fallback, scores, second=None):
    parts = Parts(controller='steering', monitor='m', fallback=fallback)
    monitor = Scripted(scores)
    switch = Assured(parts, SteeringLaw(SteeringGains()), monitor, second)
    switch.begin(Scenario())
    commands = []
    for _ in scores:
        switch.see(IMAGE)
        commands.append(switch.command(LEFT))
    return switch, commands, monitor


@pytest.mark.parametrize(('fallback', 'second', 'after'), [
    ('stop', None, STOP),
    ('slow', None, TaxiCommand(steering_rad=PLAIN.steering_rad, speed_mps=SLOW_MPS)),
    ('second:right', Right(), TaxiCommand(steering_rad=-PLAIN.steering_rad, speed_mps=5.0)),
    ('watch', None, PLAIN),
])
def test_given_an_alarm_then_the_fallback_takes_over_for_good(fallback, second, after):
    switch, commands, monitor = drive(fallback, [0.2, 0.99, 1.0, 0.0, 5.0], second)
    assert commands == [PLAIN, PLAIN, after, after, after]
    assert (switch.alarm.step, switch.alarm.reason, switch.alarm.score) == (2, 'bad', 1.0)
    assert str(switch.alarm) == 'bad at 0.2 s (1.00 times its threshold)'
    assert len(monitor.seen) == 3, 'a latched switch asks no more'
    assert [one.command for one in monitor.seen[1:]] == [PLAIN, PLAIN]


def test_given_another_run_then_the_switch_is_open_again():
    switch, _, _ = drive('stop', [2.0])
    assert switch.alarm is not None
    switch.begin(Scenario())
    assert switch.alarm is None


def test_given_no_frame_then_the_estimate_is_not_judged_alone():
    switch, _, _ = drive('stop', [0.0])
    with pytest.raises(ValueError, match='together with its frame'):
        switch.command(LEFT)


def test_given_a_fork_then_the_monitor_sees_the_whole_run():
    switch, _, monitor = drive('stop', [0.0, 0.0])
    again = ReplayedController(switch, [PLAIN], same=True)
    again.begin(Scenario())
    assert again.needs_image
    for _ in range(2):
        again.see(IMAGE)
        again.command(LEFT)
    assert len(monitor.seen) == 2


@pytest.fixture
def mine(tmp_path):
    (tmp_path / 'm.py').write_text(
        'def often(seen):\n    return seen.estimate.cte_m\n'
        'def blind(truth):\n    return 0.0, 0.0\nblind.needs_image = False\n'
    )
    return tmp_path / 'm.py'


def test_given_a_function_of_a_file_then_it_is_a_monitor_whose_file_is_in_the_hash(mine):
    word = monitored('steering', f'{mine}:often', 'stop')
    switch = make_controller(word, SteeringGains())
    assert check_controller(word) == switch.fingerprint
    assert check_controller(f'steering+{mine}:often+slow') != switch.fingerprint
    assert switch.word == 'steering+python+stop'
    switch.begin(Scenario())
    switch.see(IMAGE)
    assert switch.command(LEFT) == STOP
    assert switch.alarm.reason == 'often'
    before = switch.fingerprint
    mine.write_text(mine.read_text() + '\n')
    assert check_controller(word) != before


def test_given_a_monitor_of_another_perception_then_it_is_said_and_who_cannot_be_known_is_not(mine):
    said = (
        'monitor original is calibrated for original, and watches taxinet, whose usual errors it '
        'does not know: it may give alarms often, or never; calibrate one: taxinet assure '
        'calibrate PROGRAM --perception taxinet'
    )
    assert monitor_doubts('original', 'taxinet') == [said]
    assert monitor_doubts('original', 'original') == []
    assert monitor_doubts('original', 'external') == []
    assert monitor_doubts(f'{mine}:often', 'taxinet') == []
    with pytest.warns(UserWarning, match='is calibrated for original, and watches truth, whose'):
        tx.run(tx.Scenario(duration_s=0.5), controller='steering+original+watch')


@pytest.mark.parametrize('answer', ["'high'", "'0.5'", 'True', "float('nan')"])
def test_given_a_monitor_that_returns_no_number_then_the_run_ends_with_its_line(mine, answer):
    mine.write_text(f'def wrong(seen):\n    return {answer}\n')
    switch = make_controller(f'steering+{mine}:wrong+stop', SteeringGains())
    switch.begin(Scenario())
    switch.see(IMAGE)
    with pytest.raises(RuntimeError, match=f'wrong returned {eval(answer)!r}; expected a number'):
        switch.command(LEFT)


@pytest.mark.parametrize(('given', 'said'), [
    (('steering', None, 'stop'), 'fallback stop: no effect without a monitor'),
    (('steering', 'original', 'jump'), 'fallback jump: unknown; known: stop, slow, second'),
    (('steering', 'original', 'second:'), 'fallback second:: unknown'),
    (('cmd:mine', 'original', None), 'monitor original: the switch is in our controller node'),
    (('external', 'original', None), 'controller external is another node'),
    (('steering+original+stop', 'original', None), 'names one already'),
    (('steering', 'a+b', None), r'\+ is not allowed'),
])
def test_given_options_that_do_not_go_together_then_they_are_refused_by_name(given, said):
    with pytest.raises(UsageError, match=said):
        monitored(*given)


@pytest.mark.parametrize(('word', 'said'), [
    ('steering+nobody+stop', "monitor: 'nobody' is unknown; known: "),
    ('nobody+{mine}:often+stop', "controller: 'nobody' is unknown"),
    ('steering+{mine}:often+second:nobody', "perception: 'nobody' is unknown"),
    ('steering+{mine}:often+second:truth', 'sees no picture'),
    ('steering+{mine}:often+second:{mine}:blind', 'sees no picture'),
    ('steering+{mine}:often+second:external', 'is a node of a graph'),
    ('steering+{mine}:nothing+stop', 'no nothing in it'),
])
def test_given_a_word_with_an_unusable_part_then_it_is_named(word, said, mine):
    with pytest.raises(UsageError, match=said):
        make_controller(word.format(mine=mine), SteeringGains())


def test_given_gains_then_they_are_refused_with_a_monitor(mine):
    with pytest.raises(UsageError, match=r'steering\.heading_gain: cannot be set together'):
        check_controller(f'steering+{mine}:often+stop', {'heading_gain': 1.0})


def test_given_words_then_only_monitored_ones_have_parts():
    assert parts_of('steering') is None
    assert parts_of('a+b.py:steer') is None
    assert parts_of('cmd:x+original+stop') is None
    parts = parts_of('my+dir/c.py:steer+original+second:taxinet')
    assert parts == Parts(
        controller='my+dir/c.py:steer', monitor='original', fallback='second:taxinet'
    )
    assert (parts.second, parts.word) == ('taxinet', 'my+dir/c.py:steer+original+second:taxinet')
    assert named_parts('steering+original+second:taxinet')
    assert not named_parts('python+original+stop')
    assert not named_parts('steering')


