"""What was found out about a run's network, in words: the most important first."""

from __future__ import annotations

import math
from collections.abc import Iterator

from taxinet_ros.analysis.counterfactual import LEAST_SHARE, SHADOW, Effect
from taxinet_ros.analysis.explain import Explanation, Insight
from taxinet_ros.analysis.explain_track import Moment
from taxinet_ros.core.types import TrackingError

_HARDLY_RAD = math.radians(2.0)
"""Half a metre of cross-track error, as the steering law sees it."""

_NOT_IN_VIEW = 0.002
PARTS = {SHADOW: "the aircraft's own shadow", 'crossing': 'the crossing'}


def explain_sentences(found: Explanation) -> Iterator[str]:
    """The findings."""
    worst = found.insights[found.worst]
    yield from _cause(found)
    yield f'Most wrong at {moment_words(worst.moment)}.'
    yield from attention_sentences(worst)
    yield from _nearness(found)
    yield recomputed_sentence(found)
    if found.run.controller:
        yield (
            f'Another controller than the steering law drove this run: {found.run.controller}. '
            'What an estimate does is told as the law would follow it.'
        )


def moment_words(moment: Moment) -> str:
    """Where and when it was, what the network saw, and what that does."""
    where = f'{moment.t_s:.1f} s, {moment.x_m:,.0f} m past the threshold: '
    if not moment.estimate.usable:
        return f'{where}truth {error_words(moment.truth)}; the network had no answer'
    return (
        f'{where}truth {error_words(moment.truth)}; seen {error_words(moment.estimate)}; '
        f'{misled_words(moment.misled_rad)}'
    )


def error_words(error: TrackingError) -> str:
    """A tracking error, as ``1.2 m left, nose 3° right``."""
    if not error.usable:
        return 'no answer'
    return f'{_side(error.cte_m, " m", 1)}, nose {_side(math.degrees(error.he_rad), "°", 0)}'


def misled_words(misled_rad: float) -> str:
    """How far the steering law is misled."""
    if not math.isfinite(misled_rad):
        return 'no answer, so the aircraft brakes'
    degrees = math.degrees(misled_rad)
    if round(abs(degrees)) == 0:
        return 'headed as the truth asks'
    # An aircraft that is thought to be, or to point, too far left is turned to the right.
    return f'headed {abs(degrees):.0f}° too far {"right" if degrees > 0 else "left"}'


def attention_sentences(insight: Insight) -> Iterator[str]:
    """What part of a frame the network goes by."""
    region, share = insight.occlusion.region
    time = f'At {insight.moment.t_s:.1f} s'
    if share == 0:
        yield f'{time} no patch of the picture changes the estimate.'
    else:
        yield (
            f'{time} the network goes by the {region} of the picture most: '
            f'{100 * share:.0f} % of what covering a patch changes is there '
            '(a ninth would be 11 %).'
        )
    for name, (area, weight) in insight.parts.items():
        if area >= _NOT_IN_VIEW:
            yield (
                f'{_capital(PARTS[name])} takes up {100 * area:.0f} % of that picture, and '
                f'{100 * weight:.0f} % of what the network goes by.'
            )
    if insight.occlusion.lost:
        yield f'With {insight.occlusion.lost} of the patches covered the network had no answer.'


def recomputed_sentence(found: Explanation) -> str:
    """Whether the estimates of now are those of the run."""
    cte_m, he_rad = found.track.greatest_change
    if not found.own:
        who = found.run.perception or 'an unnamed perception'
        return f'The network in question did not drive this run: {who} did.'
    if cte_m == he_rad == 0:
        return 'All estimates came out as recorded, to the bit.'
    if math.isinf(cte_m):
        return 'Not every estimate that was recorded could be made again, or the other way round.'
    return (
        f'The estimates differ from those recorded by up to {cte_m:.2g} m and '
        f'{math.degrees(he_rad):.2g}°.'
    )


def effect_words(effect: Effect) -> str:
    """What a factor does to the error."""
    percent = round(100 * effect.removed)
    if not effect.changed:
        return 'the pictures stay the same'
    if percent == 0:
        return 'the error stays'
    return f'{abs(percent)} % {"less" if percent > 0 else "more"} error'


def _cause(found: Explanation) -> Iterator[str]:
    track, worst = found.track, found.insights[found.worst].moment
    if not worst.estimate.usable:
        yield 'The network had no answer to any of the frames that were looked into.'
        return
    if abs(worst.misled_rad) < _HARDLY_RAD:
        yield (
            f'While the aircraft was on the runway, its network misled the steering law by '
            f'{math.degrees(abs(worst.misled_rad)):.1f}° at most: if the run failed, hardly for '
            'its network.'
        )
        return
    if not found.effects:
        why = track.differs or 'a state is missing'
        yield f'What of the scene causes the error cannot be told, for {why}.'
        return
    blamed = found.blamed
    if blamed is None:
        yield (
            f'No change of the scene takes {100 * LEAST_SHARE:.0f} % of the error away: neither '
            f'{_list([effect.factor.cause for effect in found.effects])}. What is left is the '
            'pose, the ground and the network itself.'
        )
        return
    yield (
        f'{_capital(blamed.factor.cause)} makes the network err: in the same scene, '
        f'{blamed.factor.words}, {100 * blamed.removed:.0f} % of the error in the '
        f'{len(found.insights)} frames is gone.'
    )
    outcome = blamed.outcomes[found.worst]
    yield (
        f'At {worst.t_s:.1f} s it sees {error_words(outcome.estimate)} then, and '
        f'{error_words(worst.estimate)} as it was; true is {error_words(worst.truth)}.'
    )
    yield from _others(found, blamed)


def _others(found: Explanation, blamed: Effect) -> Iterator[str]:
    others = [
        f'{effect.factor.words}: {effect_words(effect)}' for effect in found.effects
        if effect is not blamed
    ]
    if others:
        yield f'Other changes: {"; ".join(others)}.'


def _nearness(found: Explanation) -> Iterator[str]:
    if found.training is None:
        return
    near = [insight.nearness for insight in found.insights if insight.nearness is not None]
    foreign = [one for one in near if one.foreign]
    worst = near[found.worst]
    name = found.training.images.name
    far = (
        f'At the worst the nearest training image is {worst.by_picture[0].distance:.1f} grey '
        f'levels away, farther than {100 * worst.farther_than:.1f} % of the images of data set '
        f'{name} are from their nearest other one (usual: {worst.usual:.1f})'
    )
    if foreign:
        yield f'{far}; {len(foreign)} of {len(near)} frames are out of distribution.'
    else:
        yield f'{far}; no frame is out of distribution.'


def _list(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f'{", ".join(words[:-1])} nor {words[-1]}'


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]


def _side(value: float, unit: str, decimals: int) -> str:
    size = f'{abs(value):.{decimals}f}'
    if float(size) == 0:
        return f'{size}{unit}'
    return f'{size}{unit} {"left" if value > 0 else "right"}'
