"""Explain why a network failed in a run: where its estimates are wrong, and the causes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from taxinet_ros.analysis.explain.counterfactual import (
    Effect,
    Rerun,
    effect_to_blame,
    effects,
    not_shown,
    reruns,
    run_factors,
    taken_again,
)
from taxinet_ros.analysis.explain.track import (
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
from taxinet_ros.core.mtl.explain import Explanation as Clauses
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE
from taxinet_ros.core.perception.perception import NetworkPerception, Perception
from taxinet_ros.core.renderer import OURS, ChosenRenderer
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario_fields import along_words
from taxinet_ros.core.types import TrackingError, time_words
from taxinet_ros.core.user_code import UserCodeError
from taxinet_ros.core.verdict.examined import Examined, examine_runs
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.registry import KMWH

Progress = Callable[[str, int, int], None]
"""Called with the stage, the number of steps done and their total."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """Findings about a run.

    Attributes:
        bag: path of the run.
        run: the recorded run.
        perception: word of the evaluated network.
        fingerprint: fingerprint of its weights.
        track: its estimates along the run.
        moments: those examined, in order of time, at least one.
        effects: effects of changing the scene at these moments, in the factors' order; empty if the
            run cannot be rerun.
        reruns: the whole run as recorded, and without what failed in it or pushed the aircraft;
            empty if nothing did.
        not_rerun: why there are none, though something did; '' otherwise.
        not_modified: why its scenes are not modified; '' otherwise.
        again: the examined moments, taken again unchanged by a camera other than ours that was
            asked; None if none was.
        hidden: scenario keys that were not changed, as this camera does not show them.
        outcome: outcome of the recorded run, or '' if the bag ends before.
        clauses: what the robustness of the requirement looked into comes from, if it was evaluated.
        examined: how that was chosen; it is the headline of ``run``.
    """

    bag: Path
    run: RecordedRun
    perception: str
    fingerprint: str
    track: Track
    moments: tuple[Moment, ...]
    effects: tuple[Effect, ...]
    reruns: tuple[Rerun, ...] = ()
    not_rerun: str = ''
    not_modified: str = ''
    again: Effect | None = None
    hidden: tuple[str, ...] = ()
    outcome: str = ''
    clauses: Clauses | None = None
    examined: Examined | None = None

    @property
    def own(self) -> bool:
        """Whether the network is that of the run."""
        return self.fingerprint == self.run.fingerprint

    @property
    def worst(self) -> int:
        """Index of the moment at which the network misleads the aircraft most."""
        misled = [abs(moment.misled_rad) for moment in self.moments]
        return int(np.argmax(np.nan_to_num(misled, nan=-1.0)))

    @property
    def blamed(self) -> Effect | None:
        """The factor without which most of the error disappears, if enough of it does."""
        return effect_to_blame(self.effects)


def explain(
    recording: Recording, perception: Perception, *, frames: int,
    on_progress: Progress = lambda stage, done, total: None,
    renderer: ChosenRenderer | None = None, spec: str | None = None,
) -> Explanation:
    """Explain a run.

    Args:
        recording: recording of the run.
        perception: a network.
        frames: maximum number of moments to examine, at least 1.
        on_progress: called with the progress.
        renderer: the run's camera, where that is not ours, asked for pictures of modified scenes;
            None: they are not modified.
        spec: name of the requirement to look into; None to choose it.

    Raises:
        WorldDiffers: frames are missing and cannot be reproduced.
        InfraError: the camera failed.
        BagError, UsageError: the bag cannot be read.
    """
    bag, run, facts = recording.path, recording.run, recording.facts
    judging = run.request.judging
    known = {name: one.interval for name, one in facts.judged.items()} if facts else {}
    examined = examine_runs(judging.names, [known], asked=spec, where=str(bag))
    run = replace(run, request=replace(run.request, judging=judging.headed_by(examined.spec)))

    def look(image: Frame, rig: Rig = run.request.scenario.rig) -> TrackingError:
        if isinstance(perception, NetworkPerception):
            perception.begin(rig)
        return perception.estimate(image, None)

    world, camera = world_and_camera(run.world or KMWH)
    if world != KMWH:
        raise UsageError(f'{bag}: used world {world}, whose modified scenes cannot be rendered')
    theirs = '' if camera == OURS or renderer is not None else (
        f'its pictures are of the camera {camera}, which takes others if named as camera'
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
    return Explanation(
        bag=bag, run=run, perception=perception.word, fingerprint=perception.fingerprint,
        track=track, moments=chosen, effects=found,
        reruns=driven, not_rerun=not_rerun, not_modified=theirs, again=again,
        hidden=() if renderer is None else not_shown(renderer.shows),
        outcome='' if facts is None else facts.outcome, examined=examined,
        clauses=recording.judge(run.request.judging.specs[0], explain=True).explanation,
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


def moment_words(moment: Moment) -> str:
    """Display text: time, place, estimate, and its effect."""
    where = f'{time_words(moment.t_s)}, {moment.x_m:,.0f} m {along_words(moment.line.name)}: '
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


def effect_words(effect: Effect) -> str:
    """Display text of a factor's effect on the error."""
    percent = round(100 * effect.removed)
    if not effect.changed:
        return 'the pictures stay the same'
    if percent == 0:
        return 'the error stays'
    return f'{abs(percent)} % {"less" if percent > 0 else "more"} error'


def _side(value: float, unit: str, decimals: int) -> str:
    size = f'{abs(value):.{decimals}f}'
    if float(size) == 0:
        return f'{size}{unit}'
    return f'{size}{unit} {"left" if value > 0 else "right"}'
