"""What a made-up network is fooled by must be blamed, and nothing else."""

import dataclasses
import math

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.analysis.explain.counterfactual import (
    changed_pixels,
    effect_to_blame,
    effects,
    factors,
    reruns,
    run_factors,
)
from taxinet_ros.analysis.explain.track import Moment, misled_rad, moments, read_track
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.rig.catalogue import WING
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import NO_ESTIMATE, TaxiCommand, TrackingError
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.core.world import SimulatedWorld

GAINS = SteeringGains()
AFTERNOON = Scenario(time_of_day_s=16 * 3600.0, cross_track_m=2.0, clouds='clear')
WRONG_M = 4.0


def moment_in(scenario, look):
    """The first moment of a scene, and what the network makes of it."""
    now = SimulatedWorld(scenario).observe()
    truth = now.state.tracking_error
    estimate = look(now.image)
    return Moment(
        camera=WING, row=0, seq=0, t_s=0.0, x_m=now.state.x_m, line=scenario.line,
        image=now.image, state=now.state, truth=truth, estimate=estimate,
        misled_rad=misled_rad(estimate, truth, GAINS),
    )


def fooled_where(condition, truth):
    """Right, but for frames of a condition."""
    def look(image, rig=None):
        off = WRONG_M if condition(image) else 0.0
        return dataclasses.replace(truth, cte_m=truth.cte_m + off)

    return look


def truth_in(scenario):
    return SimulatedWorld(scenario).observe(picture=False).state.tracking_error


def effects_on(scenario, condition):
    look = fooled_where(condition, truth_in(scenario))
    moment = moment_in(scenario, look)
    assert abs(moment.misled_rad) > math.radians(5)
    return moment, effects(scenario, [moment], look, GAINS)


def test_given_two_frames_then_pixels_that_differ_in_any_colour_are_found():
    frame = np.full((20, 30, 3), 90, np.uint8)
    other = frame.copy()
    other[3, 5, 1] += 5
    other[9, 8, 2] += 4
    assert np.argwhere(changed_pixels(frame, other)).tolist() == [[3, 5]]


def test_given_a_network_fooled_only_by_a_van_then_others_on_the_ground_are_blamed():
    van = {'kind': 'vehicle', 'x_m': 415, 'y_m': -4}
    scene = dataclasses.replace(AFTERNOON, traffic=load_traffic([van]))
    bare = SimulatedWorld(AFTERNOON).observe().image
    _, found = effects_on(scene, lambda image: bool(changed_pixels(image, bare, levels=60).any()))
    blamed = effect_to_blame(found)
    assert blamed is not None
    assert (blamed.factor.name, blamed.factor.words) == ('others', 'with nobody else there')
    assert blamed.removed == pytest.approx(1)
    assert 'others' not in {factor.name for factor in factors(AFTERNOON)}


def test_given_a_network_fooled_only_by_the_shadow_then_the_shadow_is_blamed():
    now = SimulatedWorld(AFTERNOON).observe()
    bare = Camera(dataclasses.replace(AFTERNOON, shadows=False)).render(now.state, 0)
    mask = changed_pixels(now.image, bare, levels=20)
    assert mask.mean() > 0.01  # there is a shadow in the picture

    def contrast(image):
        grey = image.mean(axis=2)
        return grey[mask].mean() / grey[~mask].mean()

    between = (contrast(now.image) + contrast(bare)) / 2

    def shaded(image):
        return contrast(image) < between

    moment, found = effects_on(AFTERNOON, shaded)
    blamed = effect_to_blame(found)
    assert blamed is not None
    assert blamed.factor.name == 'shadow'
    assert blamed.removed == pytest.approx(1.0)
    (outcome,) = blamed.outcomes
    assert np.array_equal(outcome.image, bare)
    assert outcome.estimate == moment.truth
    assert outcome.changed == changed_pixels(now.image, bare).mean()
    by_name = {effect.factor.name: effect for effect in found}
    # Diffuse light has no shadow either; that wider change must not be named in its place.
    assert by_name['overcast'].removed == pytest.approx(1.0)
    assert by_name['crossing'].removed == 0.0


def test_given_a_network_fooled_by_the_dark_then_the_hour_is_blamed():
    dawn = Scenario(time_of_day_s=6.2 * 3600.0, clouds='overcast')
    _, found = effects_on(dawn, lambda image: image.mean() < 70)
    blamed = effect_to_blame(found)
    assert blamed is not None
    assert blamed.factor.name == 'ten'
    assert {effect.factor.name for effect in found if not effect.changed} == {'shadow', 'crossing'}


def test_given_a_network_wrong_whatever_the_scene_then_nothing_of_it_is_blamed():
    _, found = effects_on(AFTERNOON, lambda image: True)
    assert [effect.removed for effect in found] == [0.0] * len(found)
    assert len(found) == 5
    assert effect_to_blame(found) is None


def test_given_a_change_that_takes_the_answer_away_then_it_takes_no_error_away():
    noon = Scenario()
    shown = SimulatedWorld(noon).observe().image

    def look(image, rig=None):
        if not np.array_equal(image, shown):
            return NO_ESTIMATE
        return TrackingError(cte_m=3.0, he_rad=0.0)

    found = effects(noon, [moment_in(noon, look)], look, GAINS)
    assert {effect.removed for effect in found} == {0.0}
    assert any(effect.changed for effect in found)
    assert effect_to_blame(found) is None


@pytest.mark.parametrize(('scenario', 'names'), [
    (Scenario(), ['shadow', 'crossing', 'overcast', 'ten', 'easy']),
    (Scenario(clouds='stratus', rain_fraction=0.5, time_of_day_s=36000.0, shadows=False),
     ['crossing', 'rain', 'overcast', 'clear', 'easy']),
    (Scenario(time_of_day_s=36000.0, shadows=False, crossing=False), ['overcast']),
    (Scenario(lens_dirt_fraction=0.1, fault_seed=3.0, steering_bias_rad=0.1, fault_onset_s=1.0),
     ['lens_dirt_percent', 'shadow', 'crossing', 'overcast', 'ten', 'easy']),
    (Scenario(lens_dirt_fraction=0.1, exposure_jump_ev=1.0), [
        'lens_dirt_percent', 'exposure_jump_ev', 'faults', 'shadow', 'crossing', 'overcast', 'ten',
        'easy',
    ]),
])
def test_given_a_scene_then_what_is_so_already_is_not_changed(scenario, names):
    found = factors(scenario)
    assert [factor.name for factor in found] == names
    assert all(factor.scenario != scenario for factor in found)
    assert all(
        factor.scenario.rain_fraction == scenario.rain_fraction for factor in found
        if factor.name not in ('rain', 'clear', 'easy')
    )


def test_given_errors_that_cancel_each_other_then_the_aircraft_is_not_misled():
    truth = TrackingError(cte_m=0.0, he_rad=0.0)
    gain = GAINS.cte_gain_rad_per_m
    assert misled_rad(TrackingError(cte_m=2.0, he_rad=-2 * gain), truth, GAINS) == pytest.approx(0)
    assert misled_rad(TrackingError(cte_m=2.0, he_rad=0.1), truth, GAINS) == (
        pytest.approx(2 * gain + 0.1))
    far = misled_rad(TrackingError(cte_m=40.0, he_rad=0.0), truth, GAINS)
    assert far == pytest.approx(GAINS.max_intercept_rad)
    assert math.isnan(misled_rad(NO_ESTIMATE, truth, GAINS))


def test_given_a_network_fooled_only_by_dirt_then_the_dirt_is_blamed():
    dirty = dataclasses.replace(AFTERNOON, lens_dirt_fraction=0.3, steering_bias_rad=0.05)
    clean = SimulatedWorld(AFTERNOON).observe().image
    _, found = effects_on(dirty, lambda image: changed_pixels(image, clean).mean() > 0.2)
    blamed = effect_to_blame(found)
    assert blamed is not None
    assert blamed.factor.name == 'lens_dirt_percent'
    assert np.array_equal(blamed.outcomes[0].image, clean)
    assert blamed.factor.scenario.steering_bias_rad == 0.05


def test_given_a_frozen_camera_then_only_without_it_a_moment_is_seen_as_it_is():
    frozen = dataclasses.replace(AFTERNOON, camera_freeze_s=1.0)
    world = SimulatedWorld(frozen)
    start = world.observe()
    for _ in range(6):
        world.advance(TaxiCommand(steering_rad=0.2, speed_mps=5.0))
    now = world.observe()
    assert np.array_equal(now.image, start.image)
    truth = now.state.tracking_error
    estimate = dataclasses.replace(truth, cte_m=truth.cte_m + WRONG_M)
    moment = Moment(
        camera=WING, row=6, seq=6, t_s=0.6, x_m=now.state.x_m, line=frozen.line,
        image=now.image, state=now.state, truth=truth, estimate=estimate,
        misled_rad=misled_rad(estimate, truth, GAINS), shown=start.state,
    )
    found = {
        effect.factor.name: effect.outcomes[0].image
        for effect in effects(frozen, [moment], lambda image, rig=None: estimate, GAINS)
    }
    camera = Camera(AFTERNOON)
    assert np.array_equal(found['camera_freeze_s'], camera.render(now.state, now.stamp_ns))
    bare = Camera(dataclasses.replace(AFTERNOON, shadows=False))
    assert np.array_equal(found['shadow'], bare.render(start.state, 0))


@pytest.mark.filterwarnings('ignore:camera_freeze_s. no effect, as the perception needs no picture')
def test_given_others_that_react_then_moments_without_recorded_frames_show_them_where_they_were(
    tmp_path,
):
    x_m = AFTERNOON.distance_m
    shy = {'kind': 'vehicle', 'y_m': -8, 'heading_deg': 90, 'stands_within_m': 16}
    scene = dataclasses.replace(
        AFTERNOON, duration_s=3.0, camera_freeze_s=0.6, fault_onset_s=2.0, traffic=load_traffic([
            {**shy, 'x_m': x_m + 20, 'path': [{'x_m': x_m + 20, 'y_m': 8, 'speed_mps': 2.5}]},
        ]),
    )
    run = tx.run(scene)
    held = [step.observation.held[0].ns for step in run.steps]
    assert 0 < held[20] < held[24] < held[28]
    recording = tx.open_recording(run.save_bag(tmp_path / 'run', images=False))
    assert not recording.recorded_steps

    def look(image, rig=None):
        return NO_ESTIMATE

    found = list(moments(recording, read_track(recording, look), [15, 24, 28]))
    for moment, row in zip(found, (15, 24, 28), strict=True):
        assert np.array_equal(moment.image, run.frame(row))
    seen = {one.factor.name: one for one in effects(scene, found, look, GAINS)}
    thawed = tx.run(dataclasses.replace(scene, camera_freeze_s=0.0, fault_onset_s=0.0))
    for k, row in enumerate((15, 24, 28)):
        assert np.array_equal(seen['camera_freeze_s'].outcomes[k].image, thawed.frame(row))
    assert seen['camera_freeze_s'].outcomes[1].changed > 0


def recorded(scenario):
    request = RunRequest(
        run_id='r', index=2, program='p', seed=4, scenario=scenario,
        judging=Judging(specs=('phi_eventually',)), participants=(),
    )
    return RecordedRun(request=request, perception='truth', fingerprint='', gains={})


def test_given_what_fails_and_what_pushes_then_the_run_is_driven_again_without_each_and_all():
    biased = Scenario(
        cross_track_m=2.0, duration_s=15.0, steering_bias_rad=math.radians(12), fault_onset_s=2.0,
    )
    well = Scenario(cross_track_m=2.0, duration_s=15.0)
    assert run_factors(well) == ()
    assert reruns(recorded(well), make_perception('truth')) == ()
    found = reruns(recorded(biased), make_perception('truth'))
    assert [rerun.name for rerun in found] == ['recorded', 'steering_bias_deg']
    assert [rerun.outcome for rerun in found] == ['FAIL', 'PASS']
    for rerun, scenario in zip(found, (biased, well), strict=True):
        assert rerun.robustness == tx.run(scenario).rho['phi_eventually']
    pushed = dataclasses.replace(
        biased, wind_speed_mps=5.0, gust_mps=1.0, gust_seed=3.0, runway_state='wet',
        loop_delay_s=0.2,
    )
    wanted = run_factors(pushed)
    assert [factor.words for factor in wanted] == [
        'without the delay from frame to command', 'without the steering bias',
        'without any fault', 'without wind', 'on a dry runway', 'without any of this',
    ]
    assert wanted[-1].scenario == well
    assert wanted[3].scenario == dataclasses.replace(
        biased, runway_state='wet', loop_delay_s=0.2,
    )


def test_given_faults_of_the_gnss_then_the_run_is_driven_again_without_each_and_all():
    well = Scenario(duration_s=15.0, sensors='standard')
    wanted = run_factors(dataclasses.replace(
        well, gnss_bias_m=-3.0, gnss_dropout_start_s=2.0, gnss_dropout_s=9.0))
    assert [factor.words for factor in wanted] == [
        'without the GNSS offset to the left', 'without the GNSS drop-out', 'without any of this']
    assert wanted[1].scenario == dataclasses.replace(well, gnss_bias_m=-3.0)
    assert wanted[2].scenario == well


def test_given_what_changes_within_a_run_then_the_run_is_driven_again_with_it_as_at_the_start():
    calm = Scenario(cross_track_m=2.0, duration_s=15.0)
    scene = dataclasses.replace(calm, wind_speed_mps=4.0, **{
        'wind_speed_mps@5': 20.0, 'wind_direction_deg@5': 90.0, 'steering_bias_deg@4': 12.0,
        'runway_state@3': 'wet', 'exposure_jump_ev@2': 1.0,
    })
    wanted = {factor.name: factor for factor in run_factors(scene)}
    assert list(wanted) == [
        'exposure_jump_ev', 'steering_bias_deg', 'faults', 'wind', 'friction', 'wind_speed_mps@',
        'all',
    ]
    assert wanted['all'].scenario == calm
    assert wanted['wind_speed_mps@'].words == 'with the wind as at the start'
    assert 'wind_speed_mps@5' not in wanted['wind_speed_mps@'].scenario.points
    assert set(wanted['wind'].scenario.points) == {
        'steering_bias_deg@4', 'runway_state@3', 'exposure_jump_ev@2'}
    assert set(wanted['friction'].scenario.points) == {*scene.points} - {'runway_state@3'}
    assert 'exposure_jump_ev' in {factor.name for factor in factors(scene)}
    found = reruns(recorded(scene), make_perception('truth'))
    assert [rerun.outcome for rerun in found[:3]] == ['FAIL', 'FAIL', 'PASS']
