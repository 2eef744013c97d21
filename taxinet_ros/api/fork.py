"""Fork a run: repeat it up to a moment, to the bit, and go on in a changed world."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taxinet_ros.api.run import (
    NOTHING,
    Look,
    Run,
    Steer,
    asked_controller,
    asked_perception,
    drive,
)
from taxinet_ros.arguments import NUMBER, PATH, Kind, a, takes, told
from taxinet_ros.bag.errors import BagEmpty
from taxinet_ros.bag.layout import mcap_path
from taxinet_ros.bag.run.message_values import error_of, stamp_of
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.resimulation import check_state, states_and_commands
from taxinet_ros.bag.run.run_bag import node_words
from taxinet_ros.bag.run.topics import ESTIMATE
from taxinet_ros.bag.run.trace import CameraFrame
from taxinet_ros.core.fork import (
    MOVES,
    Fork,
    ReplayedController,
    ReplayedPerception,
    check_changeable,
    forked_world,
    needs_other_model,
)
from taxinet_ros.core.loop import Step
from taxinet_ros.core.motion.aircraft import Placed
from taxinet_ros.core.motion.controller import STEERING, Controller, SteeringGains, SteeringLaw
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE
from taxinet_ros.core.perception.perception import Perception, perception_names
from taxinet_ros.core.place.catalogue import find_place
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    HEADING,
    HUMAN_KEYS,
    along_words,
    by_key,
    is_point,
)
from taxinet_ros.core.types import (
    NS_PER_S,
    TaxiCommand,
    TrackingError,
    step_stamp_ns,
    steps_in,
    yaw_of,
)
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.registry import KMWH

_GAIN = 'steering.'
_OFF_STEP_S = 1e-6  # 7.3 s is no binary fraction
_RUN = a('a tx.Run, a tx.Recording', Run, Recording)
_NAMED = Kind(
    'a mapping from names to values',
    lambda value: isinstance(value, Mapping) and all(isinstance(name, str) for name in value),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Past:
    """A recorded run, read once, to be repeated and forked any number of times.

    Attributes:
        recording: of the run.
        sha256: SHA-256 of its file.
        states: numbers of the recorded odometry by control step.
        estimates, commands: of the control steps from 0 on, without a gap.
    """

    recording: Recording
    sha256: str
    states: Mapping[int, dict[str, float]]
    estimates: Sequence[TrackingError]
    commands: Sequence[TaxiCommand]

    @property
    def last_seq(self) -> int:
        """The last step at which it can be forked."""
        return min(len(self.estimates), len(self.commands), max(self.states))

    def step_at(self, at_s: float) -> int:
        """Control step of a moment.

        Raises:
            UsageError: there is no step at this time.
        """
        period_ns = self.recording.period_ns
        end_s = step_stamp_ns(self.last_seq, period_ns) / NS_PER_S
        if not 0 <= at_s <= end_s + _OFF_STEP_S:
            raise UsageError(f'fork: {at_s:g} s is not within the run, 0 to {end_s:g} s')
        after = steps_in(round((at_s - _OFF_STEP_S) * NS_PER_S), period_ns)
        low_s, high_s = (step_stamp_ns(after - k, period_ns) / NS_PER_S for k in (1, 0))
        if high_s - at_s > _OFF_STEP_S:
            raise UsageError(
                f'fork: {at_s:g} s is between control steps; take {low_s:g} or {high_s:g} s'
            )
        return after


def read_past(recording: Recording) -> Past:
    """Read what is needed to repeat a run.

    Raises:
        UsageError: it cannot be repeated here: a free run, a fork, or of a package's world.
        BagError: the bag cannot be read.
    """
    run, path = recording.run, recording.path
    if run.timing.free:
        raise UsageError(f'{path}: a free run, not reproducible: {NOT_REPRODUCIBLE}')
    if run.fork:
        raise UsageError(f'{path}: is itself a fork; fork the run that it was forked from')
    if run.world:
        raise UsageError(
            f'{path}: used world {run.world}; only runs of {KMWH}, the simulated world, can change'
        )
    states, commands = states_and_commands(recording)
    estimates = {}
    for _, _, message in recording.messages((ESTIMATE,)):
        estimates[stamp_of(message) // recording.period_ns] = error_of(message)
    if not states:
        raise BagEmpty(f'{path}: no states, so there is nothing to repeat', path=path)
    file = mcap_path(path) if path.is_dir() else path
    return Past(
        recording=recording, sha256=hashlib.sha256(file.read_bytes()).hexdigest(), states=states,
        estimates=_without_gap(estimates), commands=_without_gap(commands),
    )


def _without_gap(found: Mapping[int, Any]) -> list[Any]:
    listed: list[Any] = []
    while len(listed) in found:
        listed.append(found[len(listed)])
    return listed


@takes(
    run=_RUN | PATH, at_s=NUMBER, settings=_NAMED, moved=_NAMED,
)
def fork(
    run: Run | Recording | str | os.PathLike[str], *, at_s: float,
    settings: Mapping[str, Any] = NOTHING, moved: Mapping[str, float] = NOTHING,
    perception: str | Perception | Look | None = None,
    controller: str | Controller | Steer | None = None,
) -> Run:
    """Repeat a run up to a moment, to the bit, and go on in a changed world.

    Up to the moment the recorded estimates and commands hold; states, frames (where recorded),
    and the answers of perception and controller (where they stay) are compared with the recorded
    ones. A perception or controller of the time after sees the whole run.

    Args:
        run: a run, a recording of one, or the path of its bag.
        at_s: from when it is forked [s]; a control step.
        settings: scenario values from then on by their user-facing keys, ``{'rain_percent': 0}``,
            and gains of the steering law, ``{'steering.heading_gain': 1.2}``; ``duration_s`` is the
            length of the whole run.
        moved: offsets by which the aircraft is placed anew then: ``distance_m``, ``cte_m`` (left
            positive), ``heading_deg`` (left positive), ``speed_mps``. It then rolls straight, in
            the attitude in which it taxis, within the limits of a start at this place, or no
            farther out than it was.
        perception: from then on, as for :func:`taxinet_ros.run`; None: the run's own.
        controller: likewise.

    Returns:
        The forked run, judged as a whole by the run's requirements; :attr:`Run.fork_of` tells from
        what it was forked.

    Raises:
        UsageError: the run cannot be repeated, a value cannot change during a run, or the
            repetition differs from the recording.
        BagError: the bag cannot be read.
        InfraError: the simulator failed.
    """
    if isinstance(run, Run):
        return run.fork(at_s, settings=settings, moved=moved, perception=perception,
                        controller=controller)
    recording = run if isinstance(run, Recording) else open_recording(Path(run))
    return fork_past(
        read_past(recording), at_s=at_s, settings=settings, moved=moved, perception=perception,
        controller=controller,
    )


def fork_past(
    past: Past, *, at_s: float, settings: Mapping[str, Any], moved: Mapping[str, float],
    perception: str | Perception | Look | None, controller: str | Controller | Steer | None,
    anywhere: bool = False,
) -> Run:
    """Fork a run that has been read; arguments and errors as for :func:`fork`.

    With ``anywhere`` the place of the aircraft has no limits.
    """
    recorded, step = past.recording.run, past.step_at(at_s)
    before = recorded.request.scenario
    gains = {name: value for name, value in settings.items() if name.startswith(_GAIN)}
    scene = {name: value for name, value in settings.items() if name not in gains}
    after = _changed(before, scene)
    if after.duration_ns < step_stamp_ns(step, before.period_ns):
        raise UsageError(f'fork: duration_s is {after.duration_s:g}, before {at_s:g} s')
    before = dataclasses.replace(before, duration_s=after.duration_s)
    eyes, same_eyes = _perception(past, perception)
    hands, same_hands = _controller(past, controller, gains)
    replayed = (
        ReplayedPerception(eyes, past.estimates[:step], same=same_eyes),
        ReplayedController(hands, past.commands[:step], same=same_hands),
    )
    how = Fork(
        run_id=recorded.request.run_id, sha256=past.sha256, step=step, scenario=after,
        placed=_placed(past, step, before, after, moved, anywhere=anywhere),
        perception=recorded.perception, controller=recorded.controller or STEERING,
    )
    world = forked_world(how)
    return drive(
        before, *replayed, judging=recorded.request.judging, timing=recorded.timing,
        world=world, draws=(recorded.request.seed, recorded.request.index), fork_of=how,
        on_step=_Check(past, how, pictures=eyes.needs_image),
        nodes=node_words(eyes, hands, world, recorded.timing, before),
    )


class _Check:
    """Compares steps before a fork with the recorded ones."""

    def __init__(self, past: Past, fork: Fork, *, pictures: bool) -> None:
        self._past, self._fork = past, fork
        self._frames: Iterator[CameraFrame] = past.recording.frames(
            lambda seq: pictures and seq < fork.step, render=False
        )
        self._frame = next(self._frames, None)

    def __call__(self, step: Step) -> None:
        now, last = step.observation, self._fork.step - (self._fork.placed is not None)
        if now.seq <= last:
            check_state(
                self._past.recording.path, now.seq, self._past.states[now.seq], now.state
            )
        if self._frame is not None and self._frame.seq == now.seq and now.image is not None:
            if not np.array_equal(self._frame.image, now.image):
                raise UsageError(
                    f'fork: the camera frame of step {now.seq} is another than the recorded one: '
                    'by another version or on another machine'
                )
            self._frame = next(self._frames, None)


def _changed(before: Scenario, scene: Mapping[str, Any]) -> Scenario:
    values = by_key(scene)
    for key in values:
        if key not in BY_KEY:
            raise UsageError(
                f'fork: unknown key {key!r}{near_miss(key, HUMAN_KEYS)}; known: '
                f'{", ".join(HUMAN_KEYS)}, steering.<gain>'
            )
    # A value from now on is in place of the control points that the run had.
    kept = before.without_signals(*(BY_KEY[key] for key in values))
    after = dataclasses.replace(before, **{'signals': kept, **{
        BY_KEY[key].attribute: value if is_point(key) else BY_KEY[key].from_human(value)
        for key, value in values.items()
    }})
    check_changeable(before, after)
    for key in values:
        same = before.points.get(key) == after.points.get(key) if is_point(key) else (
            getattr(before, BY_KEY[key].attribute) == getattr(after, BY_KEY[key].attribute)
            and kept == before.signals
        )
        if same:
            words = BY_KEY[key].value_words(after.to_human()[key])
            raise UsageError(f'fork: {key} is {words} in the run already; leave it out')
    return after


def _perception(
    past: Past, asked: str | Perception | Look | None
) -> tuple[Perception, bool]:
    """The perception after the fork, and whether it is the run's own."""
    run = past.recording.run
    if asked is None and run.perception not in perception_names():
        what = f'{run.perception!r}, not a shipped one' if run.perception else 'not told'
        raise UsageError(
            f"{run.request.run_id}: the run's own perception is {what}; name one by perception"
        )
    found = asked_perception(run.perception if asked is None else asked)
    same = found.fingerprint == run.fingerprint and found.word == run.perception
    if asked is None and not same:
        raise UsageError(
            f"{run.request.run_id}: the run's {run.perception} has sha256 {run.fingerprint[:12]}…, "
            f"today's {found.fingerprint[:12]}…; name the file, or another one, by perception"
        )
    return found, same


def _controller(
    past: Past, asked: str | Controller | Steer | None, gains: Mapping[str, Any]
) -> tuple[Controller, bool]:
    """The controller after the fork, and whether it is the run's own."""
    run = past.recording.run
    own = dict(run.gains)
    changed = {name.removeprefix(_GAIN): value for name, value in gains.items()}
    for name, value in changed.items():
        if name not in SteeringGains.__dataclass_fields__:
            known = ', '.join(SteeringGains.__dataclass_fields__)
            raise UsageError(f'fork: steering.{name}: unknown gain; known: {known}')
        if not NUMBER.has(value):
            raise UsageError(f'fork: steering.{name} is {told(value)}, not a number')
    word = asked if asked is not None else run.controller or STEERING
    if not (isinstance(word, str) and word == STEERING):
        found = asked_controller(word)
        if changed:
            raise UsageError(
                f'fork: steering.{min(changed)} has no effect on controller {found.word}'
            )
        return found, bool(found.fingerprint) and found.fingerprint == run.controller_fingerprint
    law = SteeringLaw(SteeringGains(**{**own, **changed}))
    return law, not run.controller and not changed


def _placed(
    past: Past, step: int, before: Scenario, after: Scenario, moved: Mapping[str, float], *,
    anywhere: bool,
) -> Placed | None:
    """Where the aircraft is placed anew at a step; None if it rolls on."""
    for name, value in moved.items():
        if name not in MOVES:
            raise UsageError(f'fork: unknown offset {name!r}; known: {", ".join(MOVES)}')
        if not NUMBER.has(value):
            raise UsageError(f'fork: the offset {name} is {told(value)}, not a number')
    if not moved and not needs_other_model(before, after):
        return None
    along_m, cte_m, he_rad, was_mps = _motion(past.states[step], before, step)
    speed_mps = was_mps + moved.get('speed_mps', 0.0)
    if not speed_mps >= 0:
        raise UsageError(f'fork: the aircraft would roll at {speed_mps:g} m/s, which is backwards')
    if not anywhere:
        here = dict(zip(MOVES, (along_m, cte_m, he_rad / HEADING.si, was_mps), strict=True))
        for name in moved:
            _check_move(before, name, here[name], moved[name])
    x_m, y_m, yaw_rad = before.line.pose(
        along_m + moved.get('distance_m', 0.0), cte_m + moved.get('cte_m', 0.0),
        he_rad + moved.get('heading_deg', 0.0) * HEADING.si,
    )
    return Placed(x_m, y_m, yaw_rad, speed_mps)


def _check_move(scenario: Scenario, name: str, here: float, offset: float) -> None:
    """Check that a moved aircraft is where a run may begin, or no farther out than it is."""
    line = scenario.line
    low, high, unit = {
        'distance_m': (0.0, line.last_start_m, f'm {along_words(scenario.track)}'),
        'cte_m': (-line.farthest_start_m, line.farthest_start_m, 'm left of the line'),
        'heading_deg': (HEADING.low / HEADING.si, HEADING.high / HEADING.si, 'deg, left positive'),
        'speed_mps': (0.0, scenario.aircraft_model.taxi_speed_mps[1], 'm/s'),
    }[name]
    there = here + offset
    if not min(low, here) <= there <= max(high, here):
        place = find_place(scenario.place).reference
        raise UsageError(
            f'fork: the offset {name} of {offset:g} leads to {there:.6g}, outside '
            f'{low:g}..{high:g} {unit}, at {place}'
        )


def _motion(
    there: Mapping[str, float], scenario: Scenario, step: int
) -> tuple[float, float, float, float]:
    """Distance along the track, cross-track and heading error, and speed at a step."""
    if step == 0:  # exactly; angles come back from a quaternion rounded
        return (
            scenario.distance_m, scenario.cross_track_m, scenario.heading_rad, scenario.speed_mps
        )
    yaw_rad = yaw_of(*(there[f'q{axis}'] for axis in 'xyzw'))
    return *scenario.line.measure(there['x'], there['y'], yaw_rad), there['speed']


@dataclass(frozen=True, kw_only=True, eq=False)
class Rescue:
    """Until when a violated run could still be saved by a change.

    Attributes:
        saved: the run forked at the last moment found that satisfies its requirements; None if not
            even the fork at the start does.
        lost_s: the next step, a fork at which violates them [s]; None if every one satisfies them.
        later_s: moments after it that satisfy them all the same, of those tried: the answer
            then depends on the moment, and there is no single point of no return.
        tried: number of forks.
    """

    saved: Run | None
    lost_s: float | None
    later_s: tuple[float, ...]
    tried: int


def find_rescue(
    past: Past, *, settings: Mapping[str, Any], moved: Mapping[str, float],
    perception: str | Perception | Look | None, controller: str | Controller | Steer | None,
    on_fork: Callable[[Run], None] = lambda run: None, probes: int = 8,
) -> Rescue:
    """Bisect the last step at which a change still saves a violated run.

    Bisection assumes that what comes too late at one moment comes too late at all later ones;
    ``probes`` later moments, evenly spread, test that.

    Args:
        past: the run.
        settings: the change, as for :func:`fork`.
        moved: likewise.
        perception: likewise.
        controller: likewise.
        on_fork: called with every forked run.
        probes: number of later moments.

    Raises:
        UsageError: as :func:`fork`; or the run satisfies its requirements.
    """
    facts, period_ns = past.recording.facts, past.recording.period_ns
    if facts is None or facts.outcome != Outcome.FAIL:
        what = facts.outcome if facts is not None and facts.outcome else 'not judged'
        raise UsageError(
            f'{past.recording.path}: is {what}; only what is violated can be saved'
        )
    forks: dict[int, Run] = {}

    def saves(step: int) -> bool:
        if step not in forks:
            forks[step] = fork_past(
                past, at_s=step_stamp_ns(step, period_ns) / NS_PER_S, settings=settings,
                moved=moved, perception=perception, controller=controller,
                anywhere=step > 0,  # offsets that are possible at the start are no larger later
            )
            on_fork(forks[step])
        return forks[step].outcome is Outcome.PASS

    last = min(past.last_seq, max(past.states) - 1)
    saved, lost = -1, last + 1
    if saves(0):
        saved = last if saves(last) else 0
        lost = last + 1 if saved else last
    while saved >= 0 and lost - saved > 1:
        middle = (saved + lost) // 2
        saved, lost = (middle, lost) if saves(middle) else (saved, middle)
    first = max(saved, 0) + 1
    tried = sorted({first + (last - first) * number // probes for number in range(1, probes + 1)})
    later = tuple(
        step_stamp_ns(step, period_ns) / NS_PER_S for step in tried if step > lost and saves(step)
    ) if lost <= last or saved < 0 else ()
    first_lost = lost if saved >= 0 else 0
    return Rescue(
        saved=forks.get(saved), later_s=later, tried=len(forks),
        lost_s=None if saved == last else step_stamp_ns(first_lost, period_ns) / NS_PER_S,
    )


def save_fork(
    past: Past, done: Run, change: Mapping[str, Any], out: Path, *, images: bool
) -> dict[str, Any]:
    """Write bag and picture of a forked run; what was done, as values of JSON.

    Args:
        past: the run that was forked.
        done: the forked run.
        change: arguments of :func:`fork_past`.
        out: folder.
        images: whether the bag has the camera frames.
    """
    from taxinet_ros.analysis.one_run.fork import change_words, forked_values

    fork = done.fork_of
    assert fork is not None
    out.mkdir(parents=True, exist_ok=True)
    bag = done.save_bag(out / f'{fork.run_id}-at-{fork.at_s:g}s', images=images)
    words = change_words(past.recording, change, fork)
    return forked_values(past.recording, bag, fork, words, out)


def save_rescue(
    past: Past, found: Rescue, change: Mapping[str, Any], out: Path, *, images: bool
) -> dict[str, Any]:
    """The same of the last moment at which a change saves a run; arguments as there."""
    from taxinet_ros.analysis.one_run.fork import change_words

    fork = None if found.saved is None else found.saved.fork_of
    saved = {} if found.saved is None else save_fork(past, found.saved, change, out, images=images)
    return {
        'run_id': past.recording.run_id, 'change': change_words(past.recording, change, fork),
        'last_saved_s': fork and fork.at_s, 'first_lost_s': found.lost_s,
        'saved_later_s': found.later_s, 'forks': found.tried, **saved,
    }


def sweep_past(
    past: Past, change: Mapping[str, Any], key: str, values: Sequence[float], *, at_s: float,
    on_fork: Callable[[], None],
) -> tuple[str, list[dict[str, Any]]]:
    """Fork a run with several values of a key or gain.

    Args:
        past: the run.
        change: what else changes; arguments of :func:`fork_past`.
        key: key or gain.
        values: its values.
        at_s: from when it is forked [s].
        on_fork: called after each fork.

    Returns:
        Name of the headline; value, outcome and ends of rho of each fork.

    Raises:
        UsageError: as :func:`fork`; or the key is changed in any case.
    """
    from taxinet_ros.analysis.one_run.fork import value_before

    if key in change['settings']:
        raise UsageError(f'sweep {key}: is in the settings too; leave one out')
    recorded, points = value_before(past.recording, key), []
    for value in values:
        # As recorded is no change, but is a point of the curve.
        new = {} if value == recorded else {key: value}
        done = fork_past(past, at_s=at_s, **{**change, 'settings': {**change['settings'], **new}})
        headline = next(iter(done.rho))
        points.append({key: value, 'outcome': done.outcome, **done.rho[headline].by_end()})
        on_fork()
    return headline, points
