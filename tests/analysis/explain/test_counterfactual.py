"""What a made-up network is fooled by must be blamed, and nothing else."""

import dataclasses
import math

import numpy as np
import pytest

from taxinet_ros.analysis.explain.counterfactual import effect_to_blame, effects, factors
from taxinet_ros.analysis.explain.occlusion import changed_pixels
from taxinet_ros.analysis.explain.track import Moment, misled_rad
from taxinet_ros.core.camera.camera import WING, Camera
from taxinet_ros.core.controller import SteeringGains
from taxinet_ros.core.perception.perception import NO_ESTIMATE
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TrackingError
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
    def look(image):
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

    def look(image):
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
