"""Requirements before a run: how they are understood, what is refused, what is warned of."""

from __future__ import annotations

import math
from typing import Any

import pytest

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, signals
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.mtl import SHIPPED, Verdict, parse_spec
from taxinet_ros.core.mtl.lint import check_windows
from taxinet_ros.core.perception.perception import GroundTruth, Perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, TrackingError
from taxinet_ros.core.verdict.judge import Judge, check_specs, signal_ranges
from taxinet_ros.core.verdict.judging import StopOn
from taxinet_ros.errors import UsageError

GAINS = SteeringGains()


def understood(text: str, duration_s: float = 30.0) -> str:
    found = check_specs([parse_spec(text)], Scenario(duration_s=duration_s), GAINS)
    return f'{found.lines[0]}; {found.reaches[0]}'


def warned(text: str, duration_s: float = 30.0, gains: SteeringGains | None = GAINS) -> list[str]:
    return list(check_specs([parse_spec(text)], Scenario(duration_s=duration_s), gains).warnings)


# Of gentle and phi_eventually the command's own test has every word (test_cli_spec.py).
@pytest.mark.parametrize(
    ('text', 'words'),
    [
        (
            'a=eventually[0:500 ms](x >= 1.4 km)',
            'a: at some time from 0 s to 0.5 s: x >= 1400 m (1.4 km); '
            'x between -225 m and 2825 m (2.825 km); horizon 0.5 s',
        ),
        (
            'a=always(he_estimate > 1 implies once[0:2](speed < 10 kt))',
            'a: always over the run: if he_estimate > 1 rad (57.3 deg) then '
            '(at some time from 2 s to 0 s before: speed < 5.14444 m/s (10 kt)); '
            'speed within ±7.5 m/s (14.58 kt); horizon 30 s',
        ),
        (
            'a=cte < 1 and speed * 2 s > 3 m',
            'a: cte < 1 m and speed * 2 > 3; cte within ±240 m; '
            'speed within ±7.5 m/s (14.58 kt); horizon 0 s',
        ),
    ],
)
def test_people2_given_a_requirement_when_looked_at_then_it_is_told_as_understood(
    text: str, words: str
) -> None:
    assert understood(text) == words


@pytest.mark.parametrize(('text', 'about', 'fact'), [
    ('a=always(abs(he) <= 10)', 'violate it: |he| <= 10 rad (573 deg)', 'did you mean 10 deg?'),
    ('a=always(abs(he) <= 3)', '|he| <= 3 rad (171.9 deg)', 'did you mean 3 deg?'),
    ('a=always(abs(he_estimate) <= 20)', '|he_estimate| <= 20 rad (1146 deg)', 'mean 20 deg?'),
    ('a=always(cte < 1 or abs(steering) <= 5)', 'violate it: |steering| <= 5 rad', 'mean 5 deg?'),
    ('a=always(cte < 1 and abs(steering) <= 5)', 'a: |steering| <= 5 rad', '±0.261799 rad'),
    ('a=eventually(speed >= 20 kt)', 'satisfy it: speed >= 10.2889 m/s (20 kt)', '±7.5 m/s'),
    ('a=always(abs(cte) <= 300)', 'violate it: |cte| <= 300 m always holds', 'cte within ±240 m'),
    ('a=always(1 <= 2)', 'violate it: 1 <= 2 always holds', 'by its numbers alone'),
    ('a=eventually[0:60](abs(cte) <= 1.5)', 'a: eventually[0:60] ends at 60 s', 'the run of 30 s'),
    ('a=always(cte / speed <= 1)', 'a: cte / speed has no value', 'where speed is 0'),
    ('a=always(sqrt(cte) <= 1)', 'a: sqrt(cte) has no value', 'where cte is below 0'),
    ('a=abs(cte) <= 10', 'a: evaluated at the first sample only', 'write always(...)'),
])
def test_people2_given_a_requirement_that_says_little_when_looked_at_then_one_line_warns(
    text: str, about: str, fact: str
) -> None:
    (line,) = warned(text)
    assert line.startswith('a: ')
    assert about in line
    assert fact in line


@pytest.mark.parametrize('text', [
    *SHIPPED, 'always[10:inf](abs(steering) <= 3 deg)', 'always(abs(steering) <= 15 deg)',
    'always(abs(he) <= 90 deg)', 'always(abs(he) <= 1.5)', 'eventually(x >= 1.4 km)',
    'always(abs(cte - cte_estimate) <= 2 m)', 'always(cte < 0 implies eventually[0:5](cte > -1))',
    'eventually[0:15](always(abs(cte) <= 1.0 and abs(he) <= 0.1))',
    'always(sqrt(cte*cte) <= 1.5 m)', 'always(sqrt(cte*cte + he*he) <= 1.5)',
    'eventually[0:0.1](cte < 1)', 'cte < 1 and always(he < 1)', 'always(once(cte < 1))',
    # The last position of the inner window may be cut; the first is whole.
    'a=eventually[20:25](always[0:10](abs(cte) <= 1.5))',
])
def test_people2_given_a_sound_requirement_when_looked_at_then_nothing_is_warned_of(
    text: str,
) -> None:
    assert warned(text) == []


@pytest.mark.parametrize('text', [
    'once(cte <= 1)', 'historically(cte <= 1)', 'eventually[0:0](cte <= 1)', 'once[0:1](cte <= 1)',
    'always[0:1e-9](cte <= 1)', 'always[0:99ms](cte <= 1)', 'not once(cte <= 1 and he <= 1)',
    '(cte <= 1) since (he <= 1)', 'cte <= 1 and historically(he <= 1)',
])
def test_people2_attack_given_a_window_of_the_first_sample_alone_when_looked_at_then_it_warns(
    text: str,
) -> None:
    wanted = 'a: evaluated at the first sample only; for the whole run write always(...)'
    assert warned(f'a={text}') == [wanted]


@pytest.mark.parametrize(
    ('text', 'part', 'verb'),
    [
        ('always(abs(cte) <= 1.5 or abs(cte) > 1.5)', '(abs(cte) <= 1.5) or (abs(cte) > 1.5)',
         'violate'),
        ('always(abs(cte) <= 1.5 and abs(cte) > 2)', '(abs(cte) <= 1.5) and (abs(cte) > 2)',
         'satisfy'),
        ('always(abs(cte) > 1.5 and 1.5 >= abs(cte))', '(abs(cte) > 1.5) and (1.5 >= abs(cte))',
         'satisfy'),
        ('eventually(cte > 1) implies eventually(cte > 1)',
         '(eventually(cte > 1)) implies (eventually(cte > 1))', 'violate'),
        ('always(cte > -1 or -2 > -3 * he and abs(cte) >= 1)', '', ''),
        ('always(cte > -1 or abs(cte) >= 1)', '(cte > -1) or (abs(cte) >= 1)', 'violate'),
        ('always(cte > -1 or abs(cte) > 1.1)', '', ''),
        ('always(cte > 2 implies cte > 1)', '(cte > 2) implies (cte > 1)', 'violate'),
        ('always(cte > 1 implies cte > 2)', '', ''),
        ('always(cte > he or cte < he)', '(cte > he) or (cte < he)', 'violate'),
        ('always(he < 1 and (cte <= 1 or cte > 0))', '(cte <= 1) or (cte > 0)', 'violate'),
        ('eventually(cte > 1) or not eventually[0:5](cte > 1)', '', ''),
        ('always(cte > 1) and (cte < -1)', '', ''),
        ('always(cte <= 1 or cte > 1.0000000000000002)', '(cte <= 1) or (cte > 1.0000000000000002)',
         'violate'),
        ('always(cte <= 1e308 or cte > -1e308)', None, ''),
    ],
)
def test_people2_attack_given_logic_that_settles_itself_when_looked_at_then_it_warns(
    text: str, part: str | None, verb: str
) -> None:
    if part is not None:
        wanted = f'a: {part}: nothing measured can {verb} it, for logical reasons'
        assert warned(f'a={text}') == ([wanted] if part else [])
        return
    assert len(warned(f'a={text}')) == 1, 'its ranges have told it already'


def test_people2_attack_given_a_negative_angle_when_told_then_its_degrees_are_negative() -> None:
    assert understood('a=always(he >= -10 deg)').startswith(
        'a: he >= -0.174533 rad (-10 deg) all the time; '
    )
    assert 'he + (-0.174533 rad (-10 deg)) <= 1 rad' in understood('a=he + (-10 deg) <= 1')


def test_people2_given_a_window_beyond_a_short_run_when_looked_at_then_it_warns() -> None:
    assert warned('phi_eventually', 2.0) == [
        'phi_eventually: eventually[0:10] ends at 10 s, after the run of 2 s; only the part '
        'within the run is evaluated'
    ]


def test_people2_given_other_gains_or_a_foreign_controller_then_its_limits_count() -> None:
    text = 'gentle=always(abs(steering) <= 0.3)'
    assert warned(text, gains=SteeringGains(max_steering_rad=0.5)) == []
    assert warned(text, gains=None) == []


@pytest.mark.parametrize('values', [
    {'speed_mps': 10.0}, {'wind_speed_mps': 10.0, 'wind_direction_rad': 1.6}, {'gust_mps': 2.0},
    {'runway_state': 'icy'}, {'slope_fraction': 0.05},
])
def test_given_what_moves_the_aircraft_faster_or_astray_then_no_bound_of_its_motion_is_claimed(
    values: dict[str, Any],
) -> None:
    scenario = Scenario(**values)
    for text in ('fast=always(speed <= 12)', 'wide=always(abs(cte) <= 250)'):
        spec = parse_spec(text)
        assert check_specs([spec], scenario, GAINS).warnings == ()
    gentle = parse_spec('gentle=always(abs(steering) <= 0.3)')
    assert len(check_specs([gentle], scenario, GAINS).warnings) == 1, 'the law clips it anyway'


def test_given_a_longer_runway_then_its_length_bounds_the_position() -> None:
    spec = parse_spec('ahead=always(x <= 2830)')
    assert len(check_specs([spec], Scenario(), GAINS).warnings) == 1
    assert check_specs([spec], Scenario(place='bikf_10'), GAINS).warnings == ()


def test_people2_given_a_run_then_no_signal_leaves_its_range() -> None:
    scenario = Scenario(cross_track_m=-15, heading_rad=-1.5, distance_m=0, duration_s=8)
    ranges = signal_ranges(8.0, GAINS, scenario)
    seen: dict[str, list[float]] = {name: [] for name in ('cte', 'he', 'x', 'speed', 'steering')}

    def note(step) -> None:  # type: ignore[no-untyped-def]
        state = step.observation.state
        for name, value in zip(
            seen, (state.y_m, state.yaw_rad, state.x_m, state.speed_mps, step.command.steering_rad),
            strict=True,
        ):
            seen[name].append(value)

    run_closed_loop(scenario, GroundTruth(), specs=[SHIPPED['usable']], on_step=note)
    for name, values in seen.items():
        low, high = ranges[name]
        assert low <= min(values) <= max(values) <= high
    assert max(map(abs, seen['steering'])) == ranges['steering'][1], 'the limit is reached'


@pytest.mark.parametrize(
    ('text', 'duration_s', 'message'),
    [
        ('far=always[35:40](cte < 1)', 12, 'spec far: always[35:40] begins 35 s into the run, '
                                           'which lasts 12 s; it cannot be evaluated'),
        ('far=eventually[20:inf](cte < 1)', 12, 'eventually[20:inf] begins 20 s into the run'),
        ('far=always[10:12](eventually[5:6](cte < 1))', 12, 'eventually[5:6] begins 15 s into'),
        ('far=cte < 1 and always[35:40](cte < 1)', 12, 'always[35:40] begins 35 s into the run'),
        ('far=cte < 1 until[35:40] he < 1', 12, 'until[35:40] begins 35 s into the run'),
        ('back=once[1:2](cte < 1)', 12, 'once[1:2] looks back to before the run'),
        ('thin=always[0.05:0.08](cte < 1)', 12, 'robustness is inf whatever is measured'),
        ('end=always(eventually[1:2](cte < 1))', 12, 'robustness is -inf whatever is measured'),
    ],
)
def test_t17_given_a_window_without_samples_when_looked_at_then_it_is_refused(
    text: str, duration_s: float, message: str
) -> None:
    spec = parse_spec(text)
    with pytest.raises(UsageError) as caught:
        check_specs([spec], Scenario(duration_s=duration_s), GAINS)
    assert message in str(caught.value)
    assert '\n' not in str(caught.value)


def test_t17_given_a_window_that_begins_where_the_run_ends_then_it_can_be_evaluated() -> None:
    spec = parse_spec('far=always[35:40](cte < 1)')
    check_windows(spec, 35 * NS_PER_S, CONTROL_PERIOD_NS)
    with pytest.raises(UsageError, match='it cannot be evaluated'):
        check_windows(spec, 35 * NS_PER_S - 1, CONTROL_PERIOD_NS)


@pytest.mark.parametrize('text', [
    'always[0.05:0.08](cte < 1)', 'always(eventually[1:2](cte < 1))',
])
@pytest.mark.parametrize('stop_on', StopOn)
def test_t17_given_an_infinite_rho_when_judged_all_the_same_then_it_is_no_verdict(
    text: str, stop_on: StopOn
) -> None:
    judge = Judge([parse_spec(text)], 3 * NS_PER_S, CONTROL_PERIOD_NS, stop_on)
    for step in range(31):
        (reading,) = judge.push(step * CONTROL_PERIOD_NS, sample(0.0))
        assert not judge.stopped_early
    assert math.isinf(reading.lower)
    assert reading.verdict is Verdict.UNKNOWN
    assert (judge.judgement.complete, judge.judgement.satisfied) == (False, False)


def sample(cte_m: float, *, valid: bool = True, error_m: float = 0.0) -> dict[str, float]:
    return signals(
        cte_m=cte_m, he_rad=0.0, x_m=400.0, speed_mps=5.0,
        estimate=TrackingError(cte_m=cte_m + error_m, he_rad=0.0, valid=valid),
        command=TaxiCommand(steering_rad=0.0, speed_mps=5.0),
    )


class BlindFrom(Perception):
    """The truth, and from some frame on nothing."""

    needs_image = False

    def __init__(self, frame: int, *, until: int = 10**6, nan: bool) -> None:
        self._frames = range(frame, until)
        self._nan = nan
        self._at = -1

    def estimate(self, image: object, truth: TrackingError) -> TrackingError:
        self._at += 1
        if self._at not in self._frames:
            return truth
        return TrackingError(cte_m=math.nan if self._nan else 0.0, he_rad=0.0, valid=self._nan)


@pytest.mark.parametrize('nan', [True, False])
def test_ros10_given_a_perception_that_goes_blind_then_usable_fails_where_phi_passes(
    nan: bool,
) -> None:
    specs = [SHIPPED['phi_eventually'], SHIPPED['usable']]
    found = run_closed_loop(
        Scenario(cross_track_m=0.5, duration_s=12.0), BlindFrom(50, nan=nan), specs=specs
    )
    phi, usable = found.readings
    assert (phi.verdict, usable.verdict) == (Verdict.SATISFIED, Verdict.VIOLATED)
    # The last usable frame is 49, at 4.9 s; the run has 121 frames.
    assert usable.lower == min(0.5 - (12.0 - 4.9), 0.05 - 71 / 121)
    assert found.complete
    assert not found.satisfied
    assert found.statistics.unusable_estimates == 71


@pytest.mark.parametrize(
    ('frames', 'verdict'),
    [
        (range(0), Verdict.SATISFIED),
        (range(5), Verdict.SATISFIED),        # 0.5 s at the start, 5 of 121 frames
        (range(6), Verdict.VIOLATED),         # 0.6 s
        (range(40, 45), Verdict.SATISFIED),
        (range(40, 46), Verdict.VIOLATED),
        (range(0, 121, 21), Verdict.SATISFIED),  # 6 of 121 frames, 4.96 %
        (range(0, 121, 17), Verdict.VIOLATED),   # 8 of 121 frames
    ],
)  # fmt: skip
def test_ros10_given_unusable_frames_then_their_longest_gap_and_their_share_count(
    frames: range, verdict: Verdict
) -> None:
    judge = Judge([SHIPPED['usable']], 12 * NS_PER_S, CONTROL_PERIOD_NS)
    for step in range(121):
        (reading,) = judge.push(step * CONTROL_PERIOD_NS, sample(0.0, valid=step not in frames))
    gap_s = max((1 + b - a for a, b in runs_of(frames)), default=0) * 0.1
    assert reading.lower == pytest.approx(min(0.5 - gap_s, 0.05 - len(frames) / 121))
    if abs(reading.lower) > 1e-9:
        assert reading.verdict is verdict


def runs_of(frames: range) -> list[tuple[int, int]]:
    """First and last frame of each run of frames that follow each other."""
    return [(frames[0], frames[-1])] if frames and frames.step == 1 else [(f, f) for f in frames]


@pytest.mark.parametrize('huge', [1e308, -1e308, 1.7e308])
def test_ros15_given_huge_estimates_when_judged_then_every_figure_is_finite(huge: float) -> None:
    judge = Judge([SHIPPED['phi_always']], 3 * NS_PER_S, CONTROL_PERIOD_NS)
    for step in range(31):
        judge.push(step * CONTROL_PERIOD_NS, sample(0.0, error_m=huge))
    error = judge.judgement.statistics.cte_error
    assert error.mean == pytest.approx(huge)
    assert error.mean_abs == error.max_abs == pytest.approx(abs(huge))


def test_ros15_given_huge_estimates_of_both_signs_then_the_bias_is_theirs() -> None:
    judge = Judge([SHIPPED['phi_always']], 3 * NS_PER_S, CONTROL_PERIOD_NS)
    for step, huge in enumerate([1e308] * 20 + [-1e308] * 11):
        judge.push(step * CONTROL_PERIOD_NS, sample(0.0, error_m=huge))
    assert judge.judgement.statistics.cte_error.mean == pytest.approx(1e308 * (9 / 31))
