"""Counterfactuals: the same moment without shadow, rain, dirt, etc., and the same run without wind.

Our camera is deterministic, so a single property of the scene can be changed. If the error vanishes
with the property, the property causes it; this needs no gradient and works for any network. It is
valid for single frames; the effect on the whole run requires a rerun. So faults, and what pushes
the aircraft without being visible, are also removed from the whole run.

Another camera is asked for what it shows, and first for the recorded scenes: where it does not
take the recorded pictures again, nothing that it shows otherwise can be laid to the change.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.analysis.explain.track import Estimator, Frame, Moment, misled_rad
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.core.assurance.switch import make_controller
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.faults import shown_step
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.controller import STEERING, SteeringGains
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.renderer import PICTURE_KEYS, ChosenRenderer, RunCamera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CAMERA_OFFSETS,
    FAULTS,
    GNSS_BIAS,
    GNSS_DROPOUT,
    GNSS_DROPOUT_START,
    GNSS_FIELDS,
    GNSS_NOISE,
    GUST,
    PICTURE_FAULTS,
    RUNWAY_STATE,
    WIND_DIRECTION,
    WIND_SPEED,
    ScenarioField,
)
from taxinet_ros.core.signals import VARYING
from taxinet_ros.core.traffic.traffic import NOBODY
from taxinet_ros.core.types import TrackingError, step_stamp_ns
from taxinet_ros.core.verdict.outcome import Outcome, outcome_of

SHADOW, CROSSING, RAIN, OTHERS = 'shadow', 'crossing', 'rain', 'others'
AGAIN = 'again'

LEAST_SHARE = 0.25
"""Minimum share of the error that a factor must remove to be named as its cause."""

_CLOSE = 0.85
"""Share of a wider factor's effect at which a narrower factor is preferred."""

_TEN = 10 * 3600.0
_EASY: dict[str, Any] = {
    'clouds': 'clear', 'rain_fraction': 0.0, 'time_of_day_s': _TEN, 'shadows': False,
    'crossing': False, 'traffic': NOBODY,
}
EVERYTHING = frozenset(PICTURE_KEYS)
"""What our camera shows."""


class Factor(NamedTuple):
    """A property of the scene that is changed; of several, the narrower ones stand first.

    Attributes:
        name: name in JSON.
        words: description of the changed scene, such as ``without its shadow``.
        cause: the cause if it has an effect, such as ``the aircraft's own shadow``.
        scenario: scenario with the property changed.
    """

    name: str
    words: str
    cause: str
    scenario: Scenario


@dataclass(frozen=True, kw_only=True, eq=False)
class ChangedView:
    """The network's estimate at one moment with one factor changed.

    Attributes:
        image: the changed frame.
        estimate: the estimate.
        misled_rad: see :attr:`.Moment.misled_rad`.
        changed: share of pixels that differ, 0..1.
    """

    image: Frame
    estimate: TrackingError
    misled_rad: float
    changed: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """Effect of a factor at all moments.

    Attributes:
        factor: the factor.
        outcomes: one for each moment.
        removed: share of the moments' error removed by the edit; negative if the error grows.
        changed: whether it changes any of the pictures.
    """

    factor: Factor
    outcomes: tuple[ChangedView, ...]
    removed: float
    changed: bool

    @property
    def most_changed(self) -> float:
        """Largest share of the pixels of a picture that it changes."""
        return max(outcome.changed for outcome in self.outcomes)


def factors(
    scenario: Scenario, shows: Collection[str] = EVERYTHING
) -> tuple[Factor, ...]:
    """Factors of a scene's images, without those that would change nothing.

    Args:
        scenario: the scene.
        shows: keys of the scenario that the camera shows; a change of another one is left out.
    """
    rain = scenario.rain_fraction > 0
    seen = [field for field in scenario.faults if field in PICTURE_FAULTS]
    hidden = {BY_KEY[key].attribute for key in EVERYTHING.difference(shows)}
    easy = {name: value for name, value in _EASY.items() if name not in hidden}

    def changed(**values: Any) -> Scenario:
        return scenario if hidden & values.keys() else dataclasses.replace(scenario, **values)

    return _different(scenario, [
        *_without_faults(scenario, seen, 'without any fault of the camera'),
        ('offset', 'with the camera in its place', 'the offset of the camera',
         changed(**{field.attribute: 0.0 for field in CAMERA_OFFSETS})),
        (SHADOW, 'without its shadow', "the aircraft's own shadow", changed(shadows=False)),
        (CROSSING, 'without the crossing', 'the crossing runway', changed(crossing=False)),
        (
            OTHERS, 'with nobody else there', 'the presence of others on the ground',
            changed(traffic=NOBODY),
        ),
        (RAIN, 'dry', 'the rain', changed(rain_fraction=0.0)),
        ('overcast', 'under an overcast sky', f'the {scenario.clouds} sky',
         changed(clouds='overcast')),
        ('clear', 'dry under a clear sky' if rain else 'under a clear sky',
         f'the {scenario.clouds} sky with its rain' if rain else f'the {scenario.clouds} sky',
         changed(clouds='clear', rain_fraction=0.0)),
        ('ten', 'at 10:00', 'the hour', changed(time_of_day_s=_TEN)),
        ('easy', f'all at once{", under a clear sky" if "clouds" in easy else ""}',
         'all of it together',
         dataclasses.replace(scenario.without_faults(*PICTURE_FAULTS), **easy)),
    ])


def not_shown(shows: Collection[str]) -> tuple[str, ...]:
    """Keys that :func:`factors` would change, and that a camera does not show."""
    return tuple(
        key for key in PICTURE_KEYS
        if key not in shows and BY_KEY[key].attribute in _EASY
    )


def run_factors(scenario: Scenario) -> tuple[Factor, ...]:
    """What fails in a run, or pushes the aircraft; left out is what does not."""
    calm: dict[str, Any] = {
        'wind_speed_mps': 0.0, 'wind_direction_rad': 0.0, 'gust_mps': 0.0, 'gust_seed': 0.0,
        'signals': scenario.without_signals(WIND_SPEED, WIND_DIRECTION, GUST),
    }
    nothing = dataclasses.replace(
        scenario.without_faults(*FAULTS),
        **{**calm, **dict.fromkeys((field.attribute for field in GNSS_FIELDS), 0.0),
           'signals': '', 'runway_state': 'dry', 'slope_fraction': 0.0},
    )
    wanted = [
        *_without_faults(scenario, scenario.faults, 'without any fault'),
        *_without_gnss_faults(scenario),
        ('wind', 'without wind', 'the wind', dataclasses.replace(scenario, **calm)),
        ('friction', 'on a dry runway', f'the {scenario.surface} runway',
         dataclasses.replace(
             scenario, runway_state='dry', signals=scenario.without_signals(RUNWAY_STATE))),
        ('slope', 'on a level runway', 'the slope',
         dataclasses.replace(scenario, slope_fraction=0.0)),
        *_steady(scenario),
    ]
    if nothing not in [changed for *_, changed in wanted]:
        wanted.append(('all', 'without any of this', 'all of it together', nothing))
    return _different(scenario, wanted)


_Wanted = tuple[str, str, str, Scenario]


def _steady(scenario: Scenario) -> list[_Wanted]:
    """A scene with each value that changes within the run as it is at the start, if that is any."""
    return [
        (f'{field.key}@', f'with the {field.title} as at the start',
         f'the change of the {field.title}',
         dataclasses.replace(scenario, signals=scenario.without_signals(field)))
        for field in VARYING if getattr(scenario, field.attribute) != field.absent
    ]


def _without_faults(
    scenario: Scenario, faults: Sequence[ScenarioField], words: str
) -> list[_Wanted]:
    """A scene without each of its faults, and without all."""
    found = [
        (field.key, f'without the {field.title}', f"the fault '{field.title}'",
         scenario.without_faults(field))
        for field in faults
    ]
    if len(faults) > 1:
        found.append(
            ('faults', words, 'the sum of the faults', scenario.without_faults(*faults))
        )
    return found


def _without_gnss_faults(scenario: Scenario) -> list[_Wanted]:
    """A scene without each fault of its GNSS; those that it does not have change nothing."""
    found = []
    for fields in ((GNSS_NOISE,), (GNSS_BIAS,), (GNSS_DROPOUT, GNSS_DROPOUT_START)):
        none: dict[str, Any] = {field.attribute: field.absent for field in fields}
        title = fields[0].title
        found.append((fields[0].key, f'without the {title}', f"the fault '{title}'",
                      dataclasses.replace(scenario, **none)))
    return found


def _different(scenario: Scenario, wanted: Sequence[_Wanted]) -> tuple[Factor, ...]:
    """The factors that change the scene."""
    return tuple(one for one in map(Factor._make, wanted) if one.scenario != scenario)


@dataclass(frozen=True, kw_only=True)
class Rerun:
    """What a whole run comes to.

    Attributes:
        name: of the factor that was changed; ``recorded`` where none was.
        words: how the scene then is.
        outcome: PASS or FAIL, or INFRA_ERROR where it could not be judged.
        robustness: of the headline; None if it could not be judged.
    """

    name: str
    words: str
    outcome: Outcome
    robustness: RobustnessInterval | None


def reruns(
    run: RecordedRun, perception: Perception,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Rerun, ...]:
    """Drive a run again, and again with each of :func:`run_factors`; empty if it has none.

    Args:
        run: in the simulated world, with reproducible timing.
        perception: the network.
        on_progress: is told how many are done, of how many.

    Raises:
        UsageError: its controller is not there.
        InfraError, UserCodeError: a run broke down.
    """
    wanted = run_factors(run.request.scenario)
    if not wanted:
        return ()
    judging = run.request.judging
    controller = make_controller(run.controller or STEERING, SteeringGains(**run.gains))
    scenes = [('recorded', 'as recorded', run.request.scenario)]
    scenes += [(factor.name, factor.words, factor.scenario) for factor in wanted]
    found = []
    for number, (name, words, scenario) in enumerate(scenes, 1):
        judged = run_closed_loop(
            scenario, perception, specs=judging.parsed_specs, controller=controller,
            assumptions=judging.assumptions, timing=run.timing,
            draws=(run.request.seed, run.request.index),
        )
        outcome = outcome_of(judged)
        found.append(Rerun(
            name=name, words=words, outcome=outcome,
            robustness=judged.readings[0].interval if outcome.judged else None,
        ))
        on_progress(number, len(scenes))
    return tuple(found)


def effects(
    scenario: Scenario, moments: Sequence[Moment], look: Estimator, gains: SteeringGains,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    renderer: ChosenRenderer | None = None,
) -> tuple[Effect, ...]:
    """Change each factor at each moment and evaluate the network.

    Args:
        scenario: scenario of the run.
        moments: moments with a known state.
        look: the network.
        gains: gains of the run's steering law.
        on_progress: called with the number of factors done and their total.
        renderer: who takes the pictures; None for our camera. What it does not show is not
            changed.

    Raises:
        InfraError: the camera failed.
    """
    found = []
    wanted = factors(scenario, EVERYTHING if renderer is None else renderer.shows)
    for number, factor in enumerate(wanted, 1):
        found.append(_effect(factor, moments, look, gains, renderer))
        on_progress(number, len(wanted))
    return tuple(found)


def taken_again(
    scenario: Scenario, moments: Sequence[Moment], look: Estimator, gains: SteeringGains,
    renderer: ChosenRenderer,
) -> Effect:
    """The recorded moments, taken again unchanged: the control of :func:`effects`.

    Raises:
        InfraError: the camera failed.
    """
    factor = Factor(AGAIN, 'taken again', 'the camera itself', scenario)
    return _effect(factor, moments, look, gains, renderer)


def _effect(
    factor: Factor, moments: Sequence[Moment], look: Estimator, gains: SteeringGains,
    renderer: ChosenRenderer | None,
) -> Effect:
    camera = Camera(factor.scenario) if renderer is None else renderer.make(factor.scenario)
    try:
        outcomes = tuple(
            _outcome(camera, factor.scenario, moment, look, gains) for moment in moments
        )
    finally:
        # The next one may need what this one holds.
        if isinstance(camera, RunCamera):
            camera.close()
    return Effect(
        factor=factor, outcomes=outcomes, removed=_removed(moments, outcomes),
        changed=any(outcome.changed > 0 for outcome in outcomes),
    )


def effect_to_blame(found: Sequence[Effect]) -> Effect | None:
    """The narrowest factor that removes about as much of the error as any other."""
    best = max((effect.removed for effect in found), default=0.0)
    if best < LEAST_SHARE:
        return None
    enough = [
        effect for effect in found
        if effect.removed >= LEAST_SHARE and effect.removed >= _CLOSE * _best_single(found)
    ]
    single = [effect for effect in enough if effect.factor.name != 'easy']
    return (single or enough)[0]


def _best_single(found: Sequence[Effect]) -> float:
    return max((e.removed for e in found if e.factor.name != 'easy'), default=0.0)


def _outcome(
    camera: Camera | RunCamera, scenario: Scenario, moment: Moment, look: Estimator,
    gains: SteeringGains,
) -> ChangedView:
    step = shown_step(scenario, moment.seq, scenario.period_ns)
    state, held = (moment.state, moment.held) if step == moment.seq else (
        moment.shown, moment.shown_held
    )
    if state is None:
        raise ValueError(f'step {step}: its state is unknown')
    image = camera.render(state, step_stamp_ns(step, scenario.period_ns), held=held)
    estimate = look(image, scenario.rig)
    return ChangedView(
        image=image, estimate=estimate, misled_rad=misled_rad(estimate, moment.truth, gains),
        changed=float(changed_pixels(image, moment.image).mean()),
    )


def changed_pixels(one: Frame, other: Frame, levels: int = 4) -> NDArray[np.bool_]:
    """Mask of the pixels where frames differ by more than ``levels`` in some colour, (H, W)."""
    return np.asarray(cv2.absdiff(one, other).max(axis=2) > levels, np.bool_)


def _removed(moments: Sequence[Moment], outcomes: Sequence[ChangedView]) -> float:
    """Share of the summed error that is removed; 0 where there is no estimate."""
    before, after = 0.0, 0.0
    for moment, outcome in zip(moments, outcomes, strict=True):
        if math.isfinite(moment.misled_rad):
            was = abs(moment.misled_rad)
            before += was
            after += abs(outcome.misled_rad) if np.isfinite(outcome.misled_rad) else was
    return 1 - after / before if before > 0 else 0.0
