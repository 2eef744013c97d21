"""Counterfactual images: the network's estimate of the same moment without shadow, rain, etc.

The camera is deterministic, so a single property of the scene can be changed. If the error vanishes
with the property, the property causes it; this needs no gradient and works for any network. It is
valid for single frames; the effect on the whole run requires a rerun.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taxinet_ros.analysis.explain.occlusion import changed_pixels
from taxinet_ros.analysis.explain.track import Estimator, Frame, Moment, misled_rad
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.controller import SteeringGains
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TrackingError

SHADOW, CROSSING, RAIN = 'shadow', 'crossing', 'rain'

LEAST_SHARE = 0.25
"""Minimum share of the error that a factor must remove to be named as its cause."""

_CLOSE = 0.85
"""Share of a wider factor's effect at which a narrower factor is preferred."""

_TEN = 10 * 3600.0
_EASY: dict[str, Any] = {
    'clouds': 'clear', 'rain_fraction': 0.0, 'time_of_day_s': _TEN, 'shadows': False,
    'crossing': False,
}


@dataclass(frozen=True, kw_only=True)
class Factor:
    """A property of the scene that is changed.

    Attributes:
        name: name in JSON.
        words: description of the changed scene, such as ``without its shadow``.
        cause: the cause if it has an effect, such as ``the aircraft's own shadow``.
        rank: lower for narrower factors; factors of equal effect are named in this order.
        scenario: scenario with the property changed.
    """

    name: str
    words: str
    cause: str
    rank: int
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


def factors(scenario: Scenario) -> tuple[Factor, ...]:
    """Factors of a scene, without those that would change nothing."""
    rain = scenario.rain_fraction > 0
    wanted: list[tuple[str, str, str, dict[str, Any]]] = [
        (SHADOW, 'without its shadow', "the aircraft's own shadow", {'shadows': False}),
        (CROSSING, 'without the crossing', 'the crossing runway', {'crossing': False}),
        (RAIN, 'dry', 'the rain', {'rain_fraction': 0.0}),
        ('overcast', 'under an overcast sky', f'the {scenario.clouds} sky', {'clouds': 'overcast'}),
        ('clear', 'dry under a clear sky' if rain else 'under a clear sky',
         f'the {scenario.clouds} sky with its rain' if rain else f'the {scenario.clouds} sky',
         {'clouds': 'clear', 'rain_fraction': 0.0}),
        ('ten', 'at 10:00', 'the hour', {'time_of_day_s': _TEN}),
        ('easy', 'all at once, under a clear sky', 'all of it together', _EASY),
    ]
    return tuple(
        Factor(name=name, words=words, cause=cause, rank=rank,
               scenario=dataclasses.replace(scenario, **changes))
        for rank, (name, words, cause, changes) in enumerate(wanted)
        if any(getattr(scenario, field) != value for field, value in changes.items())
    )


def effects(
    scenario: Scenario, moments: Sequence[Moment], look: Estimator, gains: SteeringGains,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Effect, ...]:
    """Change each factor at each moment and evaluate the network.

    Args:
        scenario: scenario of the run.
        moments: moments with a known state.
        look: the network.
        gains: gains of the run's steering law.
        on_progress: called with the number of factors done and their total.
    """
    found = []
    wanted = factors(scenario)
    for number, factor in enumerate(wanted, 1):
        camera = Camera(factor.scenario)
        outcomes = tuple(_outcome(camera, moment, look, gains) for moment in moments)
        found.append(Effect(
            factor=factor, outcomes=outcomes, removed=_removed(moments, outcomes),
            changed=any(outcome.changed > 0 for outcome in outcomes),
        ))
        on_progress(number, len(wanted))
    return tuple(found)


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
    return min(single or enough, key=lambda effect: effect.factor.rank)


def _best_single(found: Sequence[Effect]) -> float:
    return max((e.removed for e in found if e.factor.name != 'easy'), default=0.0)


def _outcome(camera: Camera, moment: Moment, look: Estimator, gains: SteeringGains) -> ChangedView:
    if moment.state is None:
        raise ValueError(f'step {moment.seq}: its state is unknown')
    image = camera.render(moment.state, moment.seq * CONTROL_PERIOD_NS)
    estimate = look(image)
    return ChangedView(
        image=image, estimate=estimate, misled_rad=misled_rad(estimate, moment.truth, gains),
        changed=float(changed_pixels(image, moment.image).mean()),
    )


def _removed(moments: Sequence[Moment], outcomes: Sequence[ChangedView]) -> float:
    """Share of the summed error that is removed; 0 where there is no estimate."""
    before, after = 0.0, 0.0
    for moment, outcome in zip(moments, outcomes, strict=True):
        if math.isfinite(moment.misled_rad):
            was = abs(moment.misled_rad)
            before += was
            after += abs(outcome.misled_rad) if np.isfinite(outcome.misled_rad) else was
    return 1 - after / before if before > 0 else 0.0
