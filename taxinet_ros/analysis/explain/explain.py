"""Explain why a network failed in a run: where its estimates are wrong, and the causes.

Contains the explanation and its sentences, the most important first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taxinet_ros.analysis.explain.counterfactual import (
    CROSSING,
    LEAST_SHARE,
    OTHERS,
    SHADOW,
    Effect,
    Rerun,
    effect_to_blame,
    effects,
    not_shown,
    reruns,
    run_factors,
    taken_again,
)
from taxinet_ros.analysis.explain.nearest_images import NearestImages, Nearness
from taxinet_ros.analysis.explain.occlusion import OcclusionMap, changed_pixels, occlusion_map
from taxinet_ros.analysis.explain.track import (
    Estimator,
    Frame,
    Moment,
    Track,
    choose_rows,
    moments,
    read_track,
)
from taxinet_ros.bag.errors import BagEmpty
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.renderer import OURS, ChosenRenderer
from taxinet_ros.core.scenario_fields import along_words
from taxinet_ros.core.types import TrackingError
from taxinet_ros.core.user_code import UserCodeError
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.registry import KMWH

Progress = Callable[[str, int, int], None]
"""Called with the stage, the number of steps done and their total."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Insight:
    """Findings about one moment.

    Attributes:
        moment: the moment.
        occlusion: dependence of the estimate on parts of its frame.
        parts: shares of the frame and of the effect on the estimate (0..1 each) of the aircraft's
            shadow and the crossing, by the factor's name, as far as they are visible.
        nearness: comparison with the training images; None if none were given.
    """

    moment: Moment
    occlusion: OcclusionMap
    parts: dict[str, tuple[float, float]]
    nearness: Nearness | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """Findings about a run.

    Attributes:
        bag: path of the run.
        run: the recorded run.
        perception: word of the evaluated network.
        fingerprint: fingerprint of its weights.
        track: its estimates along the run.
        insights: the examined moments in order of time, at least one.
        effects: effects of changing the scene at these moments, in the factors' order; empty if the
            run cannot be rerun.
        training: the training images, or None.
        reruns: the whole run as recorded, and without what failed in it or pushed the aircraft;
            empty if nothing did.
        not_rerun: why there are none, though something did; '' otherwise.
        not_modified: why its scenes are not modified; '' otherwise.
        again: the examined moments, taken again unchanged by a camera other than ours that was
            asked; None if none was.
        hidden: scenario keys that were not changed, as this camera does not show them.
        outcome: outcome of the recorded run, or '' if the bag ends before.
    """

    bag: Path
    run: RecordedRun
    perception: str
    fingerprint: str
    track: Track
    insights: tuple[Insight, ...]
    effects: tuple[Effect, ...]
    training: NearestImages | None
    reruns: tuple[Rerun, ...] = ()
    not_rerun: str = ''
    not_modified: str = ''
    again: Effect | None = None
    hidden: tuple[str, ...] = ()
    outcome: str = ''

    @property
    def own(self) -> bool:
        """Whether the network is that of the run."""
        return self.fingerprint == self.run.fingerprint

    @property
    def worst(self) -> int:
        """Index of the insight at which the network misleads the aircraft most."""
        misled = [abs(insight.moment.misled_rad) for insight in self.insights]
        return int(np.argmax(np.nan_to_num(misled, nan=-1.0)))

    @property
    def blamed(self) -> Effect | None:
        """The factor without which most of the error disappears, if enough of it does."""
        return effect_to_blame(self.effects)


def explain(
    recording: Recording, perception: Perception, *, frames: int,
    training: NearestImages | None = None, on_progress: Progress = lambda stage, done, total: None,
    renderer: ChosenRenderer | None = None,
) -> Explanation:
    """Explain a run.

    Args:
        recording: recording of the run.
        perception: a network.
        frames: maximum number of moments to examine, at least 1.
        training: images to compare the frames with.
        on_progress: called with the progress.
        renderer: the run's camera, where that is not ours, asked for pictures of modified scenes;
            None: they are not modified.

    Raises:
        WorldDiffers: frames are missing and cannot be reproduced.
        InfraError: the camera failed.
        BagError, UsageError: the bag cannot be read.
    """
    def look(image: Frame) -> TrackingError:
        return perception.estimate(image, None)

    bag, run = recording.path, recording.run
    world, camera = world_and_camera(run.world or KMWH)
    if world != KMWH:
        raise UsageError(f'{bag}: used world {world}, whose modified scenes cannot be rendered')
    theirs = '' if camera == OURS or renderer is not None else (
        f'its pictures are of the camera {camera}, which is asked for others with --camera {camera}'
    )
    track = read_track(recording, look, lambda done, all_: on_progress('frames', done, all_))
    chosen = tuple(moments(recording, track, choose_rows(track, frames)))
    if not chosen:
        raise BagEmpty(f'{bag}: none of its camera frames can be examined', path=bag)
    found: tuple[Effect, ...] = ()
    again: Effect | None = None
    if not theirs and not track.differs and all(moment.state for moment in chosen):
        scenario = run.request.scenario
        if renderer is not None:
            again = taken_again(scenario, chosen, look, track.gains, renderer)
            theirs = _other_pictures(renderer, chosen, again)
        if not theirs:
            found = effects(
                scenario, chosen, look, track.gains,
                lambda done, all_: on_progress('scenes', done, all_), renderer,
            )
    driven, not_rerun = _driven_again(
        run, perception, '' if camera == OURS else f'its pictures are of the camera {camera}',
        lambda done, all_: on_progress('runs', done, all_),
    )
    insights = []
    for number, moment in enumerate(chosen):
        insights.append(_insight(number, moment, look, track, found, run, training))
        on_progress('maps', number + 1, len(chosen))
    return Explanation(
        bag=bag, run=run, perception=perception.word, fingerprint=perception.fingerprint,
        track=track, insights=tuple(insights), effects=found, training=training,
        reruns=driven, not_rerun=not_rerun, not_modified=theirs, again=again,
        hidden=() if renderer is None else not_shown(renderer.shows),
        outcome='' if recording.facts is None else recording.facts.outcome,
    )


_SAME_SHARE, _SAME_CODES = 0.1, 6.0
"""What may differ when pictures are taken again: the share of the error, less than half of what a
factor has to remove to be named; and the mean of the pixels [codes], more than streaks of rain."""


def _other_pictures(
    renderer: ChosenRenderer, moments: Sequence[Moment], again: Effect
) -> str:
    """Why what a camera shows now cannot be compared with the recording; '' where it can."""
    codes = max(
        float(np.abs(moment.image.astype(np.int16) - outcome.image).mean())
        for moment, outcome in zip(moments, again.outcomes, strict=True)
    )
    if abs(again.removed) <= _SAME_SHARE and codes <= _SAME_CODES:
        return ''
    # Its streaks are elsewhere in each picture: what they do to a network is in this figure.
    rain = ' (its rain falls otherwise)' if again.factor.scenario.rain_fraction else ''
    return (
        f'the camera {renderer.name} does not take the recorded pictures again{rain}: one differs '
        f'by {codes:.0f} of 255 on average, and {effect_words(again)}'
    )


def _most_changed(effect: Effect) -> float:
    return max(outcome.changed for outcome in effect.outcomes)


def _driven_again(
    run: RecordedRun, perception: Perception, theirs: str,
    on_progress: Callable[[int, int], None],
) -> tuple[tuple[Rerun, ...], str]:
    """Its reruns; else why there are none."""
    why = theirs or (f'a free run: {NOT_REPRODUCIBLE}' if run.timing.free else '')
    if why:
        return (), why if run_factors(run.request.scenario) else ''
    try:
        return reruns(run, perception, on_progress), ''
    except (InfraError, UsageError, UserCodeError) as error:
        return (), str(error)


def _insight(
    number: int, moment: Moment, look: Estimator, track: Track, found: tuple[Effect, ...],
    run: RecordedRun, training: NearestImages | None,
) -> Insight:
    occlusion = occlusion_map(look, moment.image, track.gains)
    parts = {}
    for effect in found:
        if effect.factor.name in PARTS and effect.outcomes[number].changed > 0:
            mask = changed_pixels(moment.image, effect.outcomes[number].image)
            parts[effect.factor.name] = (float(mask.mean()), occlusion.share(mask))
    nearness = None if training is None else training.near(moment.image, _scene(moment, run))
    return Insight(moment=moment, occlusion=occlusion, parts=parts, nearness=nearness)


def _scene(moment: Moment, run: RecordedRun) -> dict[str, float | str]:
    """Scene values by the names used in training sets."""
    human = run.request.scenario.to_human()
    return {
        'cte_m': moment.truth.cte_m,
        'heading_error_deg': float(np.degrees(moment.truth.he_rad)),
        **{name: human[name] for name in ('time_of_day_h', 'rain_percent', 'clouds')},
    }


_HARDLY_RAD = math.radians(2.0)
"""Equivalent of half a metre of cross-track error in the steering law."""
_NOT_IN_VIEW = 0.002
PARTS = {
    SHADOW: "the aircraft's own shadow", CROSSING: 'the crossing', OTHERS: 'the group of others',
}


def explain_sentences(found: Explanation) -> Iterator[str]:
    """The findings."""
    worst = found.insights[found.worst]
    yield from _cause(found)
    yield from camera_sentences(found)
    yield from rerun_sentences(found)
    yield f'Largest error at {moment_words(worst.moment)}.'
    yield from attention_sentences(worst)
    yield from _nearness(found)
    yield recomputed_sentence(found)
    if found.run.controller:
        yield (
            f'This run used the controller {found.run.controller}, but the effect of an estimate '
            'is computed with the shipped steering law.'
        )


def camera_sentences(found: Explanation) -> Iterator[str]:
    """What a camera other than ours was asked for, and what it could not be."""
    if found.again is None:
        return
    _, camera = world_and_camera(found.run.world)
    if found.effects:
        yield (
            f'Taken again unchanged by the camera {camera}, at most '
            f'{100 * _most_changed(found.again):.1f} % of the pixels of a picture differ: '
            f'{effect_words(found.again)}.'
        )
    if found.hidden:
        yield f'Not changed, as the camera {camera} does not show it: {", ".join(found.hidden)}.'


def rerun_sentences(found: Explanation) -> Iterator[str]:
    """What the run would have been without what failed in it, or pushed the aircraft."""
    headline = found.run.request.judging.headline
    for rerun in found.reruns:
        known = rerun.robustness
        result = 'could not be judged'
        if known is not None:
            verb = 'satisfies' if known.satisfied else 'violates'
            result = f'{verb} {headline} ({known.words(".2f")})'
        yield f'Driven again {rerun.words}, the run {result}.'
    if found.not_rerun:
        yield f'The run cannot be driven again otherwise: {found.not_rerun}.'


def moment_words(moment: Moment) -> str:
    """Display text: time, place, estimate, and its effect."""
    where = f'{moment.t_s:.1f} s, {moment.x_m:,.0f} m {along_words(moment.line.name)}: '
    if not moment.estimate.usable:
        return f'{where}truth {error_words(moment.truth)}; the network gave no estimate'
    return (
        f'{where}truth {error_words(moment.truth)}; estimate {error_words(moment.estimate)}; '
        f'{misled_words(moment.misled_rad)}'
    )


def error_words(error: TrackingError) -> str:
    """Display text of a tracking error, such as ``1.2 m left, nose 3° right``."""
    if not error.usable:
        return 'no estimate'
    return f'{_side(error.cte_m, " m", 1)}, nose {_side(math.degrees(error.he_rad), "°", 0)}'


def misled_words(misled_rad: float) -> str:
    """Display text of the heading by which the steering law is misled."""
    if not math.isfinite(misled_rad):
        return 'no estimate, so the aircraft brakes'
    degrees = math.degrees(misled_rad)
    if round(abs(degrees)) == 0:
        return 'steered as with the truth'
    # If the estimate is too far left, in position or heading, the aircraft turns right.
    side = 'right' if degrees > 0 else 'left'
    return f'the estimate asks for a heading {abs(degrees):.0f}° too far {side}'


def attention_sentences(insight: Insight) -> Iterator[str]:
    """Sentences on which part of a frame the estimate depends on."""
    region, share = insight.occlusion.region
    time = f'At {insight.moment.t_s:.1f} s'
    if share == 0:
        yield f'{time} covering any patch of the image leaves the estimate unchanged.'
    else:
        yield (
            f'{time} the estimate depends most on the {region} of the picture: '
            f'{100 * share:.0f} % of the change by covering patches is there (11 % if all ninths '
            'were equal).'
        )
        for what, there in zip(
            ('cross-track', 'heading'), insight.occlusion.regions_alone, strict=True
        ):
            if there != region:
                yield f'The estimated {what} error alone depends most on the {there}.'
    for name, (area, weight) in insight.parts.items():
        if area >= _NOT_IN_VIEW:
            yield (
                f'{_capital(PARTS[name])} covers {100 * area:.0f} % of that picture, and has '
                f'{100 * weight:.0f} % of the effect on the estimate.'
            )
    if insight.occlusion.lost:
        yield f'With {insight.occlusion.lost} of the patches covered there was no estimate.'


def recomputed_sentence(found: Explanation) -> str:
    """Sentence on whether the recomputed estimates equal those of the run."""
    cte_m, he_rad = found.track.greatest_change
    if not found.own:
        who = found.run.perception or 'an unnamed perception'
        return f'The run was driven by {who}, not by this network.'
    if cte_m == he_rad == 0:
        return 'All estimates are equal to the recorded ones, bit for bit.'
    if math.isinf(cte_m):
        return 'Some estimates exist only in the recording, or only when recomputed.'
    return (
        f'The estimates differ from those recorded by up to {cte_m:.2g} m and '
        f'{math.degrees(he_rad):.2g}°.'
    )


def effect_words(effect: Effect) -> str:
    """Display text of a factor's effect on the error."""
    percent = round(100 * effect.removed)
    if not effect.changed:
        return 'the pictures stay the same'
    if percent == 0:
        return 'the error stays'
    return f'{abs(percent)} % {"less" if percent > 0 else "more"} error'


def _cause(found: Explanation) -> Iterator[str]:
    track, worst = found.track, found.insights[found.worst].moment
    if not worst.estimate.usable:
        yield 'The network gave no estimate for any of the examined frames.'
        return
    if abs(worst.misled_rad) < _HARDLY_RAD:
        yield (
            'While the aircraft was on the runway, the network misled the steering law by '
            f'{math.degrees(abs(worst.misled_rad)):.1f}° at most{outcome_words(found.outcome)}.'
        )
        return
    if not found.effects:
        why = found.not_modified or track.differs or 'a state is missing'
        yield f'The cause within the scene cannot be determined: {why}.'
        return
    blamed = found.blamed
    if blamed is None:
        yield (
            f'No change of the scene removes {100 * LEAST_SHARE:.0f} % of the error: neither '
            f'{_list([effect.factor.cause for effect in found.effects])}. The remaining candidates '
            'are the pose, the place, the camera and the network itself.'
        )
        return
    yield (
        f'{_capital(blamed.factor.cause)} contributes most to the error: in the same scene, '
        f'{blamed.factor.words}, {100 * blamed.removed:.0f} % of the error in the '
        f'{len(found.insights)} frames disappears.'
    )
    outcome = blamed.outcomes[found.worst]
    yield (
        f'At {worst.t_s:.1f} s the aircraft is {error_words(worst.truth)}. The network estimates '
        f'{error_words(worst.estimate)}; {blamed.factor.words}, {error_words(outcome.estimate)}.'
    )
    yield from _others(found, blamed)


def outcome_words(outcome: str) -> str:
    """Display text of what small errors of the network mean for a run with this outcome."""
    if outcome == Outcome.PASS:
        return ', and the run passed'
    failed = 'the run failed, but' if outcome == Outcome.FAIL else 'if the run failed,'
    return f': {failed} the network is probably not the reason'


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
        f'At the worst frame the nearest training image is {worst.by_picture[0].distance:.1f} grey '
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
