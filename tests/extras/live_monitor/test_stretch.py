import math

from taxinet_ros.core.mtl import Assumptions, Verdict, parse_spec
from taxinet_ros.extras.live_monitor.sample_hold import Sample
from taxinet_ros.extras.live_monitor.stretch import Level, Stretch, standing_level, standing_line

S = 10**9
NEAR = parse_spec('near=always(abs(y) <= 1.5)', signals=['y', 'v'])
SOON = parse_spec('soon=eventually[0:1](v > 2)', signals=['y', 'v'])


def push(stretch, at_s, y, v=0.0, troubles=()):
    sample = Sample(stamp_ns=round(at_s * S), values={'y': y, 'v': v}, troubles=dict(troubles))
    return stretch.push(sample)


def words(stretch):
    return [(standing_level(each).name, standing_line(each)) for each in stretch.standings]


def test_given_a_horizon_then_the_stretch_ends_there_with_its_robustness():
    stretch = Stretch([NEAR, SOON], horizon_ns=2 * S)
    assert not stretch.begun
    assert push(stretch, 100, 1.0, 3.0) == [False, True]
    assert push(stretch, 101, 0.5, 0.0) == [False, False]
    assert not stretch.ended
    assert not stretch.beyond(102 * S)
    assert stretch.beyond(102 * S + 1)
    assert push(stretch, 102.5, 9.0, 0.0) == [True, True]
    assert stretch.ended
    assert stretch.length_s == 2.0
    assert words(stretch) == [
        ('OK', 'satisfied at 2 s, rho +0.5 (final)'), ('OK', 'satisfied at 0 s, rho +1 (final)'),
    ]


def test_given_a_window_between_the_samples_then_the_end_is_unclear_and_no_pass():
    never = parse_spec('never=always[0.05:0.06](v <= 1)', signals=['y', 'v'])
    stretch = Stretch([never, NEAR], horizon_ns=S)
    for tenth in range(11):
        push(stretch, tenth / 10, 0.5, 99.0)
    assert words(stretch) == [
        ('WARN', 'unclear, no sample in its windows, rho +inf (final)'),
        ('OK', 'satisfied at 1 s, rho +1 (final)'),
    ]


def test_given_no_horizon_then_always_stays_open_until_it_is_violated():
    stretch = Stretch([NEAR])
    push(stretch, 0, 1.0)
    assert push(stretch, 1e6, 1.25) == [False]
    assert words(stretch) == [('OK', 'open, rho within [-inf, +0.25]')]
    push(stretch, 1e6 + 1, 1.5)
    assert words(stretch) == [('WARN', 'open, rho within [-inf, +0]')]
    assert push(stretch, 1e6 + 2, -2.0) == [True]
    assert words(stretch) == [('ERROR', 'violated at 1e+06 s, rho within [-inf, -0.5]')]
    assert not stretch.ended


def test_given_a_verdict_then_its_parts_and_the_sample_that_decides_are_kept():
    both = parse_spec('both=always((abs(y) <= 1.5) and (v <= 1))', signals=['y', 'v'])
    stretch = Stretch([both])
    push(stretch, 50, 1.0)
    assert stretch.standings[0].parts == ()
    push(stretch, 51, 1.0, 3.0)
    push(stretch, 52, 9.0, 3.0)
    assert stretch.standings[0].parts == (
        'rho within [-inf, -2.000]    0.0 s  always((abs(y) <= 1.5) and (v <= 1))',
        'rho -2.000                   1.0 s    (abs(y) <= 1.5) and (v <= 1)',
        'rho +0.500                   1.0 s      abs(y) <= 1.5',
        'rho -2.000                   1.0 s      v <= 1  <- decides',
    )


def test_given_a_value_that_is_none_then_only_formulas_that_read_it_lose_their_validity():
    stretch = Stretch([NEAR, SOON], max_gap_ns=S)
    push(stretch, 0, 1.0)
    why = {'y': 'y is 2.000 s old (max_age 1 s)'}
    changed = push(stretch, 0.5, math.nan, 3.0, why)
    assert changed == [True, True]
    assert words(stretch) == [
        ('ERROR', 'not valid, at 0.5 s: y is 2.000 s old (max_age 1 s); before that open, '
         'rho within [-inf, +0.5]'),
        ('OK', 'satisfied at 0.5 s, rho within [+1, +inf]'),
    ]
    assert [each.reading.valid for each in stretch.standings] == [False, True]


def test_given_a_violation_when_the_stretch_is_not_valid_later_then_both_are_told():
    stretch = Stretch([NEAR], max_gap_ns=S)
    push(stretch, 0, 2.0)
    assert push(stretch, 3, 0.0) == [True]
    (standing,) = stretch.standings
    assert standing.decided is Verdict.VIOLATED
    assert standing.reading.verdict is Verdict.UNKNOWN
    assert standing_level(standing) is Level.ERROR
    assert standing_line(standing).startswith(
        'not valid, at 3 s: no sample for 3 s (max_age 1 s); before that violated at 0 s'
    )


def test_given_stamps_out_of_order_then_the_reason_is_told():
    for at_s, why in ((5.0, 'a stamp came twice'), (4.5, 'stamps went back by 0.5 s')):
        stretch = Stretch([NEAR])
        push(stretch, 5, 0.0)
        assert push(stretch, at_s, 0.0) == [True]
        assert why in stretch.standings[0].trouble
        assert stretch.length_s == 0.0


def test_given_a_bound_that_breaks_then_what_was_decided_on_it_is_taken_back():
    vouched = Assumptions(bounds={'y': (-1, 1), 'unread': (0, 1)}, rates={'v': 1.0})
    stretch = Stretch([NEAR, SOON], horizon_ns=5 * S, assumptions=vouched)
    assert push(stretch, 0, 0.5) == [True, True]
    assert words(stretch)[0] == ('OK', 'satisfied at 0 s, rho within [+0.5, +1]')
    push(stretch, 1, 1.25)
    level, line = words(stretch)[0]
    assert level == 'WARN'
    assert line == (
        'open, rho within [-inf, +0.25]; an assumption broke at 1 s y is 1.25, bounds are -1:1'
    )
    push(stretch, 5, 0.0)
    assert words(stretch)[0][1].startswith('satisfied at 5 s, rho +0.25 (final); an assumption')
