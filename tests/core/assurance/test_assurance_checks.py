"""The checks of the run-time monitor: what is right passes, what is wrong is seen."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxinet_ros.core.assurance.checks import (
    _ASIDE_M,
    CHECKS,
    COMPONENTS,
    FEATURES,
    MEMORY,
    MOVES,
    RESPONSES,
    Consistency,
    Kinematics,
    Moves,
    Reprojection,
    Usual,
    features,
    fit_usual,
)
from taxinet_ros.core.assurance.monitor import (
    NO_ESTIMATE,
    SUSTAINED,
    CalibratedMonitor,
    Calibration,
    Fitted,
    Seen,
    conformal_threshold,
    make_monitor,
    make_perceptions,
    monitor_names,
    read_calibration,
)
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.core.world import SimulatedWorld
from taxinet_ros.errors import UsageError

STRAIGHT = TaxiCommand(steering_rad=0.0, speed_mps=5.0)
NONE = TrackingError(cte_m=0.0, he_rad=0.0, valid=False)
USUAL = Kinematics(turn_per_m=0.2, cte_spread_m=0.2, he_spread_rad=0.02)
SCENES = [
    Scenario(distance_m=1800.0, time_of_day_s=11 * 3600.0),
    Scenario(distance_m=1800.0, time_of_day_s=11 * 3600.0, cross_track_m=2.0, heading_rad=-0.1),
    Scenario(distance_m=2100.0, time_of_day_s=9 * 3600.0, cross_track_m=-1.5),
]


def seen_in(scene):
    now = SimulatedWorld(scene).observe()
    return now.image, now.truth


@pytest.mark.parametrize(('scene', 'off_m'), [*zip(SCENES, [-3.0, 2.0, 3.0], strict=True)])
def test_given_a_shifted_estimate_then_the_paint_is_found_where_it_is(scene, off_m):
    image, truth = seen_in(scene)
    looking = Reprojection(scene)
    shifted = replace(truth, cte_m=truth.cte_m + off_m)
    assert looking.score(image, truth) == 0
    assert looking.score(image, shifted) > 2
    # Who believes to be farther left looks for the line farther right, so sees it on the left.
    assert _ASIDE_M[np.nanargmax(looking.profile(image, shifted))] == pytest.approx(off_m, abs=0.3)


def test_given_nothing_to_be_seen_then_the_line_is_not_judged():
    image, truth = seen_in(SCENES[0])
    away = TrackingError(cte_m=truth.cte_m, he_rad=2.5)
    assert Reprojection(SCENES[0]).score(image, away) == 0
    assert Reprojection(SCENES[0]).score(np.full_like(image, 90), truth) == 0


def drive(steering_rad, speed_mps, steps, he_rad=0.1):
    """Estimates that follow the model exactly, with the commands before them."""
    estimates, cte_m = [], 0.0
    for _ in range(steps):
        he_rad += 0.2 * speed_mps * 0.1 * math.tan(steering_rad)
        cte_m += speed_mps * 0.1 * math.sin(he_rad)
        estimates.append(TrackingError(cte_m=cte_m, he_rad=he_rad))
    return estimates, TaxiCommand(steering_rad=steering_rad, speed_mps=speed_mps)


@settings(max_examples=40, deadline=None)
@given(st.floats(-0.25, 0.25), st.floats(0.0, 8.0), st.floats(-0.4, 0.4))
def test_given_estimates_by_the_kinematics_then_they_are_consistent(steering, speed, he):
    estimates, command = drive(steering, speed, 2 * MEMORY, he)
    checked = Consistency()
    scores = [checked.score(one, command, USUAL) for one in estimates]
    assert max(scores) < 1e-9


@pytest.mark.parametrize(('jump', 'score'), [
    (TrackingError(cte_m=1.0, he_rad=0.0), 5.0), (TrackingError(cte_m=0.0, he_rad=0.1), 5.0),
])
def test_given_a_jump_then_the_score_counts_its_spreads_until_it_is_forgotten(jump, score):
    still = TrackingError(cte_m=0.0, he_rad=0.0)
    stopped = TaxiCommand(steering_rad=0.0, speed_mps=0.0)
    checked = Consistency()
    scores = [
        checked.score(one, stopped, USUAL) for one in [still] * (MEMORY + 2) + [jump] * (MEMORY + 2)
    ]
    assert scores[:MEMORY + 2] == [0.0] * (MEMORY + 2)
    assert scores[MEMORY + 2:2 * MEMORY + 2] == pytest.approx([score] * MEMORY)
    assert scores[2 * MEMORY + 2:] == [0.0, 0.0]


def test_given_features_then_their_mean_square_distance_is_1_and_dusk_is_far():
    rng = np.random.default_rng(3)
    spread = rng.uniform(0.3, 2, FEATURES)
    known = fit_usual(4 + rng.standard_normal((4000, FEATURES)) * spread, COMPONENTS, 1e-3)
    fresh = 4 + rng.standard_normal((800, FEATURES)) * spread
    squares = ((fresh - known.mean) @ known.whitening.T) ** 2
    assert squares.shape == (800, COMPONENTS)
    assert squares.mean() == pytest.approx(1, abs=0.1)
    image, _ = seen_in(SCENES[0])
    day = [(image * share).astype(np.uint8) for share in np.linspace(0.6, 1, 60)]
    light = fit_usual(np.array([features(one) for one in day]), COMPONENTS, 1e-3)
    assert max(light.distance(features(one)) for one in day) < 1
    assert light.distance(features((image * 0.2).astype(np.uint8))) > 2.5
    assert light.distance(np.full(FEATURES, np.inf)) == math.inf


def test_given_a_picture_then_the_moved_ones_are_nearly_those_from_there():
    scene = SCENES[0]
    image, _ = seen_in(scene)
    looking = Moves(scene, make_perceptions('taxinet'))
    moved = looking.pictures(image)
    assert len(moved) == len(MOVES) == 4
    for (left_m, turn_rad), picture in zip(MOVES, moved, strict=True):
        there, _ = seen_in(replace(scene, cross_track_m=left_m, heading_rad=turn_rad))
        off, unmoved = (np.abs(one.astype(int) - there).mean() for one in (picture, image))
        assert off < 0.6 * unmoved


class Told:
    """A perception that always says the same."""

    needs_image, word, fingerprint = True, 'told', ''

    def __init__(self, estimate):
        self.told = estimate

    def begin(self, rig=None):
        pass

    def estimate(self, image, truth):
        return self.told


def test_given_moved_pictures_then_who_sees_responds_and_who_guesses_does_not():
    scene = SCENES[0]
    image, truth = seen_in(scene)
    sees = make_perception('taxinet').estimate(image, None)
    responses = Moves(scene, make_perceptions('taxinet')).responses(image, sees)
    assert responses.shape == (RESPONSES,)
    assert np.abs(responses).max() < 0.6
    # Unmoved estimates lack the whole move: 4 degrees are 0.70 m at 10 m, and 1.5 m aside.
    guesses = Moves(scene, [Told(truth)] * 4).responses(image, truth)
    wanted = [0, -0.698, 0, 0.698, -1.5, 0, 1.5, 0]
    assert guesses == pytest.approx(wanted, abs=0.01)
    # Told exactly what each move makes of it, nothing is left, whatever the heading.
    at = TrackingError(cte_m=1.0, he_rad=0.3)
    exact = [
        Told(TrackingError(cte_m=1.0 + left * math.cos(0.3), he_rad=0.3 + turn))
        for left, turn in MOVES
    ]
    assert Moves(scene, exact).responses(image, at) == pytest.approx([0] * 8, abs=1e-12)
    silent = Moves(scene, [*exact[:3], Told(NONE)]).responses(image, at)
    assert np.isinf(silent).tolist() == [False] * 6 + [True] * 2


def test_given_few_values_then_the_conformal_threshold_is_their_rank_or_refused():
    assert conformal_threshold(list(range(1, 100)), 0.01) == 99
    assert conformal_threshold(list(range(1, 200)), 0.01) == 198
    with pytest.raises(UsageError, match=r'needs 99 satisfied runs, there are 98'):
        conformal_threshold(list(range(98)), 0.01)


def test_given_many_calibrations_then_a_further_run_alarms_at_the_chosen_rate():
    rng = np.random.default_rng(11)
    exceeded = [
        rng.standard_cauchy() > conformal_threshold(rng.standard_cauchy(40).tolist(), 0.1)
        for _ in range(4000)
    ]
    # Exactly 4/41 on average: rank 37 of 40.
    assert np.mean(exceeded) == pytest.approx(4 / 41, abs=3 * math.sqrt(0.09 / 4000))


def calibration(**changes):
    fitted = Fitted(
        familiar=Usual(mean=np.full(FEATURES, 4.5), whitening=np.eye(COMPONENTS, FEATURES)),
        kinematics=changes.pop('kinematics', USUAL),
        moved=Usual(mean=np.zeros(RESPONSES), whitening=np.eye(RESPONSES)),
    )
    return Calibration(**{
        'perception': 'taxinet', 'source': 'taxinet', 'program': 'nominal', 'seed': 1,
        'perception_sha256': make_perception('taxinet').fingerprint,
        'runs': 9, 'rate': 0.3, 'fitted': fitted,
        'thresholds': dict.fromkeys(CHECKS, 1.0), **changes,
    })


def test_given_a_calibration_then_its_file_reads_back_and_has_the_same_bytes(tmp_path):
    path = tmp_path / 'mine.npz'
    path.write_bytes(calibration().to_bytes())
    found, sha256 = read_calibration(path)
    assert found.to_bytes() == path.read_bytes()
    assert make_monitor(str(path)).fingerprint == sha256


@pytest.mark.parametrize(('content', 'said'), [
    (b'', 'no calibration'), (b'PK\x03\x04 not a zip', 'no calibration'),
    (calibration(perception_sha256='ab').to_bytes(), 'taxinet has changed since'),
    (calibration(source='gone.onnx').to_bytes(), 'gone.onnx'),
    (calibration(thresholds={'unseen': 1.0}).to_bytes(), 'thresholds of'),
    (calibration(thresholds=dict.fromkeys(CHECKS, 0.0)).to_bytes(), 'not positive'),
    (calibration(kinematics=replace(USUAL, turn_per_m=math.nan)).to_bytes(), 'not finite'),
])
def test_given_a_damaged_calibration_then_it_is_named(content, said, tmp_path):
    path = tmp_path / 'mine.npz'
    path.write_bytes(content)
    with pytest.raises(UsageError, match=said) as refused:
        make_monitor(str(path))
    assert str(path) in str(refused.value) or said == 'gone.onnx'


def test_given_a_score_at_its_threshold_then_there_is_no_alarm_above_it_there_is_one():
    image = np.full((200, 360, 3), 90, np.uint8)
    at = calibration()
    score = at.fitted.familiar.distance(features(np.full_like(image, 96)))
    for factor, alarm in ((1.0, False), (0.999, True)):
        limits = {**dict.fromkeys(CHECKS, 1e9), 'unfamiliar': score * factor}
        monitor = CalibratedMonitor(
            'x', calibration(thresholds=limits), '', make_perceptions('taxinet')
        )
        monitor.begin(Scenario())
        found = [
            monitor.scores(Seen(
                image=np.full_like(image, 96), command=STRAIGHT,
                estimate=TrackingError(cte_m=0.0, he_rad=0.0),
            ))['unfamiliar'] >= 1
            for _ in range(SUSTAINED + 2)
        ]
        assert found == [False] * (SUSTAINED - 1) + [alarm] * 3


def test_given_no_estimate_for_half_a_second_then_that_is_the_alarm():
    monitor = CalibratedMonitor('x', calibration(), '', make_perceptions('taxinet'))
    monitor.begin(Scenario())
    image = np.full((200, 360, 3), 90, np.uint8)
    found = [
        monitor.scores(Seen(image=image, command=STRAIGHT, estimate=NONE))
        for _ in range(SUSTAINED)
    ]
    assert found[-1] == {NO_ESTIMATE: math.inf}
    assert all(max(before.values()) < 1 for before in found[:-1])


def test_given_the_shipped_monitors_then_each_knows_the_kinematics_of_the_aircraft():
    assert monitor_names() == ['original', 'taxinet']
    for name in monitor_names():
        found = make_monitor(name).calibration
        assert found.perception == name
        # 1 / wheelbase of the Caravan, whose least radius is 15.5 m.
        assert found.fitted.kinematics.turn_per_m == pytest.approx(0.2, abs=0.03)
        assert found.runs >= 1 / found.rate - 1


def test_given_the_profile_then_offsets_are_even():
    assert {round(b - a, 9) for a, b in pairwise(_ASIDE_M)} == {0.25}
