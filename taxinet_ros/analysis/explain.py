"""Why a network failed in a run: where its estimates are wrong, what of the scene makes them so.

Everything that is done asks the network for nothing but answers to pictures, so it holds for any.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taxinet_ros.analysis.counterfactual import CROSSING, SHADOW, Effect, effects, to_blame
from taxinet_ros.analysis.explain_track import (
    Frame,
    Look,
    Moment,
    Track,
    choose_rows,
    moments,
    read_track,
)
from taxinet_ros.analysis.nearest_images import NearestImages, Nearness
from taxinet_ros.analysis.occlusion import OcclusionMap, changed_pixels, occlusion_map
from taxinet_ros.bag.errors import BagEmpty
from taxinet_ros.bag.recorded_run import RecordedRun
from taxinet_ros.core.perception import Perception
from taxinet_ros.core.types import TrackingError

Progress = Callable[[str, int, int], None]
"""Is told stage, done and total."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Insight:
    """What was found out about one moment.

    Attributes:
        moment: the moment.
        occlusion: which part of its frame the network goes by.
        parts: shares of the frame and of what the network goes by (0..1 each) that the aircraft's
            shadow and the crossing take up, by the factor's name; only what is in the frame.
        nearness: where it stands to the training images; None where none were given.
    """

    moment: Moment
    occlusion: OcclusionMap
    parts: dict[str, tuple[float, float]]
    nearness: Nearness | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """What was found out about a run.

    Attributes:
        bag: where the run is.
        run: what it was.
        perception: word of the network that looked now.
        fingerprint: of its weights.
        track: its estimates along the run.
        insights: the moments that were looked into, in time's order; one at least.
        effects: what changing the scene does to the estimates then, in the factors' order; empty
            where the run cannot be driven again.
        training: the training images, or None.
    """

    bag: Path
    run: RecordedRun
    perception: str
    fingerprint: str
    track: Track
    insights: tuple[Insight, ...]
    effects: tuple[Effect, ...]
    training: NearestImages | None

    @property
    def own(self) -> bool:
        """Whether the network is the one that took part in the run."""
        return self.fingerprint == self.run.fingerprint

    @property
    def worst(self) -> int:
        """Number of the insight at which the network misleads the aircraft most."""
        misled = [abs(insight.moment.misled_rad) for insight in self.insights]
        return int(np.argmax(np.nan_to_num(misled, nan=-1.0)))

    @property
    def blamed(self) -> Effect | None:
        """What of the scene takes most of the error away, if it takes much."""
        return to_blame(self.effects)


def explain(
    bag: Path, run: RecordedRun, perception: Perception, *, frames: int,
    training: NearestImages | None = None, on_progress: Progress = lambda stage, done, total: None,
) -> Explanation:
    """Look into a run.

    Args:
        bag: a run folder or an ``.mcap`` file.
        run: what :func:`.recorded_run.read_run` says of it.
        perception: a network, which looks at frames.
        frames: most moments to look into, at least 1.
        training: images to hold the frames against.
        on_progress: is told what is done.

    Raises:
        WorldDiffers: frames are missing and cannot be rendered as they were.
        BagError, UsageError: the bag cannot be read.
    """
    def look(image: Frame) -> TrackingError:
        return perception.estimate(image, None)

    track = read_track(bag, run, look, lambda done, all_: on_progress('frames', done, all_))
    chosen = tuple(moments(bag, run, track, choose_rows(track, frames)))
    if not chosen:
        raise BagEmpty(f'{bag}: no camera frame of it can be looked into', path=bag)
    found: tuple[Effect, ...] = ()
    if not track.differs and all(moment.state is not None for moment in chosen):
        found = effects(
            run.request.scenario, chosen, look, track.gains,
            lambda done, all_: on_progress('scenes', done, all_),
        )
    insights = []
    for number, moment in enumerate(chosen):
        insights.append(_insight(number, moment, look, track, found, run, training))
        on_progress('maps', number + 1, len(chosen))
    return Explanation(
        bag=bag, run=run, perception=perception.word, fingerprint=perception.fingerprint,
        track=track, insights=tuple(insights), effects=found, training=training,
    )


def _insight(
    number: int, moment: Moment, look: Look, track: Track, found: tuple[Effect, ...],
    run: RecordedRun, training: NearestImages | None,
) -> Insight:
    occlusion = occlusion_map(look, moment.image, track.gains)
    parts = {}
    for effect in found:
        if effect.factor.name in (SHADOW, CROSSING) and effect.outcomes[number].changed > 0:
            mask = changed_pixels(moment.image, effect.outcomes[number].image)
            parts[effect.factor.name] = (float(mask.mean()), occlusion.share(mask))
    nearness = None if training is None else training.near(moment.image, _scene(moment, run))
    return Insight(moment=moment, occlusion=occlusion, parts=parts, nearness=nearness)


def _scene(moment: Moment, run: RecordedRun) -> dict[str, float | str]:
    """Values by the names that training sets use."""
    human = run.request.scenario.to_human()
    return {
        'cte_m': moment.truth.cte_m,
        'heading_error_deg': float(np.degrees(moment.truth.he_rad)),
        **{name: human[name] for name in ('time_of_day', 'rain', 'clouds')},
    }
