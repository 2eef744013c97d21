"""A run's estimates compared with the truth at every step, and the moments of the worst errors.

The steering law combines both errors into one heading (:mod:`taxinet_ros.core.motion.controller`):
a metre of cross-track error is worth a few degrees of heading, up to a limit. The difference
between the headings requested by the estimate and by the truth measures how much the estimate
misleads the aircraft: errors that cancel each other do no harm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.errors import BagEmpty
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.bag.run.resimulation import WorldDiffers, recorded_world
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.faults import shown_step
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M
from taxinet_ros.core.place.track import Track as Line
from taxinet_ros.core.renderer import RunCamera
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.traffic.traffic import NOTHING_HELD, Holds
from taxinet_ros.core.types import NS_PER_S, AircraftState, TrackingError, step_stamp_ns
from taxinet_ros.core.verdict.run_statistics import deciding_steps

Floats = NDArray[np.float64]
Frame = NDArray[np.uint8]


class Estimator(Protocol):
    """The network that is explained."""

    def __call__(self, image: Frame, rig: Rig = ...) -> TrackingError:
        """Its estimate from a frame of the run's rig, or of another."""
        ...
"""A network: maps a camera frame (200, 360, 3) uint8 RGB to an estimate."""

APART_NS = NS_PER_S
"""Minimum time between two examined moments [ns]."""

_TURNED_AWAY_RAD = np.radians(45.0)
"""Heading error that counts as turned away; with true errors it never exceeds 35 degrees."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Estimates and truth at every control step; NaN if unknown or declared invalid.

    Attributes:
        seq: control steps.
        t_s: simulated time [s].
        x_m: distance along the track of the run [m].
        cte_m, he_rad: the truth, left positive [m], [rad].
        est_cte_m, est_he_rad: the network's estimates on the frames.
        rec_cte_m, rec_he_rad: the estimates in the bag.
        gains: gains of the run's steering law.
        states: true states by control step; empty if the run cannot be rerun.
        held: others on the ground that the aircraft held, likewise.
        differs: reason why it cannot, or ''.
    """

    seq: NDArray[np.int64]
    t_s: Floats
    x_m: Floats
    cte_m: Floats
    he_rad: Floats
    est_cte_m: Floats
    est_he_rad: Floats
    rec_cte_m: Floats
    rec_he_rad: Floats
    gains: SteeringGains
    states: dict[int, AircraftState]
    differs: str
    half_width_m: float = KMWH_HALF_WIDTH_M
    held: dict[int, Holds] = field(default_factory=dict)

    @property
    def misled_rad(self) -> Floats:
        """Angle by which the estimates mislead the steering law, positive to the left [rad]."""
        asked = heading_asked_rad(self.est_cte_m, self.est_he_rad, self.gains)
        return asked - heading_asked_rad(self.cte_m, self.he_rad, self.gains)

    @property
    def steps_on_runway(self) -> int:
        """Control steps before the aircraft first leaves the runway, or turns away on it."""
        beyond = np.abs(self.cte_m) > self.half_width_m
        away = beyond | (np.abs(self.he_rad) > _TURNED_AWAY_RAD)
        return int(away.argmax()) if away.any() else len(away)

    @property
    def deciding_steps(self) -> int:
        """Control steps on the runway that decided whether the aircraft stays at its line."""
        return deciding_steps(self.cte_m[:self.steps_on_runway], self.t_s)

    @property
    def greatest_change(self) -> tuple[float, float]:
        """Greatest difference of the estimates from those in the bag, [m] and [rad].

        Infinite if only one of the two exists; 0 and 0 if they are bit-identical.
        """
        return (
            _greatest(self.est_cte_m, self.rec_cte_m), _greatest(self.est_he_rad, self.rec_he_rad)
        )

    def estimate(self, row: int) -> TrackingError:
        """The network's estimate at a row."""
        return _error(self.est_cte_m[row], self.est_he_rad[row])

    def truth(self, row: int) -> TrackingError:
        """The truth at a row."""
        return _error(self.cte_m[row], self.he_rad[row])


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """An examined frame.

    Attributes:
        row: row in the track.
        seq: control step.
        t_s: simulated time [s].
        x_m: distance along the track of the run [m].
        line: that the run follows.
        image: the frame, (height, width, 3) uint8 RGB.
        camera: the camera that took it.
        state: the aircraft's true state; None if the run cannot be rerun.
        shown: its state at the step whose picture the frame is, if the camera is frozen.
        held, shown_held: others on the ground that it held at these two.
        truth, estimate: tracking errors.
        misled_rad: see :attr:`Track.misled_rad`.
    """

    row: int
    seq: int
    t_s: float
    x_m: float
    line: Line
    image: Frame
    camera: CameraModel
    state: AircraftState | None
    truth: TrackingError
    estimate: TrackingError
    misled_rad: float
    shown: AircraftState | None = None
    held: Holds = field(default_factory=dict)
    shown_held: Holds = field(default_factory=dict)


def heading_asked_rad(
    cte_m: Floats | float, he_rad: Floats | float, gains: SteeringGains
) -> Floats:
    """Heading error that the steering law corrects, for given tracking errors."""
    limit = gains.max_intercept_rad
    return he_rad + np.asarray(
        np.clip(gains.cte_gain_rad_per_m * cte_m, -limit, limit), np.float64)


def misled_rad(estimate: TrackingError, truth: TrackingError, gains: SteeringGains) -> float:
    """:attr:`Track.misled_rad` for one estimate; NaN if it is not usable."""
    if not estimate.usable:
        return float('nan')
    seen, true = (
        heading_asked_rad(np.array([error.cte_m]), np.array([error.he_rad]), gains)
        for error in (estimate, truth)
    )
    return float((seen - true)[0])


def read_track(
    recording: Recording, look: Estimator,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Track:
    """Evaluate a network on every frame of a run, recorded or else rendered again.

    Args:
        recording: recording of the run.
        look: the network.
        on_progress: called with the number of frames done and their total.

    Raises:
        WorldDiffers: frames are missing and cannot be reproduced.
        BagError, UsageError: the bag cannot be read.
    """
    path, trace = recording.path, recording.columns
    total = len(trace['seq'])
    seen: dict[int, TrackingError] = {}
    states: dict[int, AircraftState] = {}
    held: dict[int, Holds] = {}
    differs = ''
    for frame in recording.frames(render=False):
        seen[frame.seq] = look(np.ascontiguousarray(frame.image))
        on_progress(len(seen), total)
    recorded = frozenset(seen)
    try:
        for now in recording.observations(lambda seq: seq not in recorded):
            states[now.seq], held[now.seq] = now.state, now.held
            if now.image is not None:
                seen[now.seq] = look(now.image)
                on_progress(len(seen), total)
    except WorldDiffers as error:
        if not recorded.issuperset(trace['seq'].tolist()):
            raise WorldDiffers(
                f'{error}; its frames were not recorded and cannot be re-rendered, so there is '
                'nothing to explain', path=path) from error
        states, held, differs = {}, {}, str(error)
    if not seen:
        raise BagEmpty(f'{path}: no camera frames available, so there is nothing to explain',
                       path=path)
    steps = trace['seq'].astype(np.int64)
    return Track(
        seq=steps, t_s=_float(trace['t_ns']) / NS_PER_S, x_m=_float(trace['distance_m']),
        cte_m=_float(trace['cte_m']), he_rad=_float(trace['he_rad']),
        est_cte_m=_estimates(steps, seen, 'cte_m'), est_he_rad=_estimates(steps, seen, 'he_rad'),
        rec_cte_m=_float(trace['est_cte_m']), rec_he_rad=_float(trace['est_he_rad']),
        gains=SteeringGains(**recording.run.gains), states=states, held=held, differs=differs,
        half_width_m=recording.scenario.line.half_width_m,
    )


def choose_rows(track: Track, frames: int) -> tuple[int, ...]:
    """Rows of the frames to examine: where the network misleads the aircraft most, and the start.

    Frames after the aircraft was last at its line are excluded (:func:`.deciding_steps`), since
    they do not explain why it left; so are those off the runway or turned away on it.

    Args:
        track: the estimates.
        frames: maximum number of rows; there are fewer if they would be less than a second apart.
    """
    misled = np.abs(track.misled_rad[:max(track.deciding_steps, 1)])
    stamps_ns = np.rint(track.t_s * NS_PER_S).astype(np.int64)
    chosen: list[int] = []
    # A stable sort: the earliest of equal ones first.
    for row in np.argsort(-np.nan_to_num(misled, nan=-1.0), kind='stable').tolist():
        if len(chosen) == frames:
            break
        if all(abs(stamps_ns[row] - stamps_ns[other]) >= APART_NS for other in chosen):
            chosen.append(row)
    if 0 not in chosen and frames > 1:
        # The start represents the requested scene, however good its estimate is.
        near = [row for row in chosen if stamps_ns[row] - stamps_ns[0] < APART_NS]
        chosen = [*[row for row in chosen if row not in near][:frames - 1], 0]
    return tuple(sorted(chosen))


def moments(recording: Recording, track: Track, rows: Sequence[int]) -> Iterator[Moment]:
    """Yield the moments of some rows.

    Raises:
        BagError: the bag cannot be read.
    """
    wanted = {int(track.seq[row]): row for row in rows}
    images = {
        frame.seq: np.ascontiguousarray(frame.image)
        for frame in recording.frames(wanted.__contains__, render=False)
    }
    scenario = recording.scenario
    world = recorded_world(recording.path, recording.run)

    @cache
    def camera() -> Camera | RunCamera:
        return Camera(scenario) if world.renderer is None else world.renderer.make(scenario)

    for seq, row in sorted(wanted.items()):
        state = track.states.get(seq)
        step = shown_step(scenario, seq, scenario.period_ns)
        shown = track.states.get(step)
        held, shown_held = (track.held.get(one, NOTHING_HELD) for one in (seq, step))
        image = images.get(seq)
        if image is None:
            if shown is None or world.again_words:
                continue  # a failed run may have a step without a state, or without a frame
            image = camera().render(
                shown, step_stamp_ns(step, scenario.period_ns), held=shown_held)
        yield Moment(
            row=row, seq=seq, t_s=float(track.t_s[row]), x_m=float(track.x_m[row]),
            line=scenario.line, image=image, camera=scenario.camera_model, state=state,
            truth=track.truth(row), estimate=track.estimate(row),
            misled_rad=float(track.misled_rad[row]), shown=shown, held=held,
            shown_held=shown_held,
        )


def _estimates(steps: NDArray[np.int64], seen: dict[int, TrackingError], name: str) -> Floats:
    return np.array([
        getattr(seen[seq], name) if seq in seen and seen[seq].usable else np.nan
        for seq in steps.tolist()
    ], dtype=np.float64)


def _error(cte_m: float, he_rad: float) -> TrackingError:
    known = bool(np.isfinite(cte_m) and np.isfinite(he_rad))
    return TrackingError(cte_m=float(cte_m), he_rad=float(he_rad), valid=known)


def _greatest(now: Floats, before: Floats) -> float:
    if (np.isnan(now) != np.isnan(before)).any():
        return float('inf')
    known = np.isfinite(now)
    return float(np.abs(now - before)[known].max(initial=0.0))


def _float(column: NDArray[np.generic]) -> Floats:
    return column.astype(np.float64)
