"""A run's estimates beside the truth, step by step, and the moments at which they are worst.

The steering law turns both errors into one heading to take (:mod:`taxinet_ros.core.controller`): a
metre of cross-track error is worth a few degrees of heading, and beyond a limit no more. How far
the heading that an estimate asks for lies from the one that the truth asks for, says how much the
estimate misleads the aircraft: errors that cancel each other do no harm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.errors import BagEmpty
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.bag.run.resimulation import WorldDiffers
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.controller import SteeringGains
from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.types import NS_PER_S, AircraftState, TrackingError

Floats = NDArray[np.float64]
Frame = NDArray[np.uint8]
Estimator = Callable[[Frame], TrackingError]
"""A network: a camera frame (200, 360, 3) uint8 RGB in, an estimate out."""

APART_NS = NS_PER_S
"""Least time between two moments that are looked into."""

_TURNED_AWAY_RAD = np.radians(45.0)
"""Led by the truth the aircraft turns no further than it approaches the centreline: 35 degrees."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Estimates and truth at every control step; NaN is not known, or declared invalid.

    Attributes:
        seq: control steps.
        t_s: simulated time [s].
        x_m: position along the runway [m].
        cte_m, he_rad: the truth, left positive [m], [rad].
        est_cte_m, est_he_rad: what the network sees on the frames.
        rec_cte_m, rec_he_rad: the estimates in the bag.
        gains: of the run's steering law.
        states: true states by control step; empty where the run cannot be driven again.
        differs: why it cannot, or ''.
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

    @property
    def misled_rad(self) -> Floats:
        """How far the estimates lead the steering law to the left of where it should head [rad]."""
        asked = heading_asked_rad(self.est_cte_m, self.est_he_rad, self.gains)
        return asked - heading_asked_rad(self.cte_m, self.he_rad, self.gains)

    @property
    def steps_on_runway(self) -> int:
        """Control steps before the aircraft first leaves the runway, or turns away on it."""
        beyond = np.abs(self.cte_m) > self.half_width_m
        away = beyond | (np.abs(self.he_rad) > _TURNED_AWAY_RAD)
        return int(away.argmax()) if away.any() else len(away)

    @property
    def greatest_change(self) -> tuple[float, float]:
        """How far estimates of now lie from those in the bag at most, [m] and [rad].

        Infinite where only one of the two could be made; 0 and 0 are equality to the bit.
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
    """A frame that is looked into.

    Attributes:
        row: its row in the track.
        seq: its control step.
        t_s: simulated time [s].
        x_m: position along the runway [m].
        image: the frame, (height, width, 3) uint8 RGB.
        camera: that has taken it.
        state: the aircraft's true state; None where the run cannot be driven again.
        truth, estimate: tracking errors.
        misled_rad: see :attr:`Track.misled_rad`.
    """

    row: int
    seq: int
    t_s: float
    x_m: float
    image: Frame
    camera: CameraModel
    state: AircraftState | None
    truth: TrackingError
    estimate: TrackingError
    misled_rad: float


def heading_asked_rad(cte_m: Floats, he_rad: Floats, gains: SteeringGains) -> Floats:
    """The heading error that the steering law wants to take away, for tracking errors."""
    limit = gains.max_intercept_rad
    return he_rad + np.asarray(
        np.clip(gains.cte_gain_rad_per_m * cte_m, -limit, limit), np.float64)


def misled_rad(estimate: TrackingError, truth: TrackingError, gains: SteeringGains) -> float:
    """As :attr:`Track.misled_rad` for one estimate; NaN where it is not usable."""
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
    """Let a network look at every frame of a run: as recorded, else rendered again.

    Args:
        recording: of the run.
        look: the network.
        on_progress: is told how many frames are done, of how many.

    Raises:
        WorldDiffers: frames are missing and cannot be rendered as they were.
        BagError, UsageError: the bag cannot be read.
    """
    path, trace = recording.path, recording.columns
    total = len(trace['seq'])
    seen: dict[int, TrackingError] = {}
    states: dict[int, AircraftState] = {}
    differs = ''
    for frame in recording.frames(render=False):
        seen[frame.seq] = look(np.ascontiguousarray(frame.image))
        on_progress(len(seen), total)
    recorded = frozenset(seen)
    try:
        for now in recording.observations(lambda seq: seq not in recorded):
            states[now.seq] = now.state
            if now.image is not None:
                seen[now.seq] = look(now.image)
                on_progress(len(seen), total)
    except WorldDiffers as error:
        if not recorded.issuperset(trace['seq'].tolist()):
            raise WorldDiffers(
                f'{error}; its frames were not recorded and cannot be re-rendered, so there is '
                'nothing to explain', path=path) from error
        states, differs = {}, str(error)
    if not seen:
        raise BagEmpty(f'{path}: no camera frames available, so there is nothing to explain',
                       path=path)
    steps = trace['seq'].astype(np.int64)
    return Track(
        seq=steps, t_s=_float(trace['t_ns']) / NS_PER_S, x_m=_float(trace['x_m']),
        cte_m=_float(trace['cte_m']), he_rad=_float(trace['he_rad']),
        est_cte_m=_estimates(steps, seen, 'cte_m'), est_he_rad=_estimates(steps, seen, 'he_rad'),
        rec_cte_m=_float(trace['est_cte_m']), rec_he_rad=_float(trace['est_he_rad']),
        gains=SteeringGains(**recording.run.gains), states=states, differs=differs,
        half_width_m=recording.scenario.runway.half_width_m,
    )


def choose_rows(track: Track, frames: int) -> tuple[int, ...]:
    """Rows of the frames to look into: where the network misleads the aircraft most, and the start.

    Those after the aircraft has left the runway or turned away say nothing of why it did, and are
    not taken.

    Args:
        track: the estimates.
        frames: how many; fewer come out where they would be less than a second apart.
    """
    misled = np.abs(track.misled_rad[:max(track.steps_on_runway, 1)])
    stamps_ns = track.seq * CONTROL_PERIOD_NS
    chosen: list[int] = []
    # A stable order: of equals the earliest.
    for row in np.argsort(-np.nan_to_num(misled, nan=-1.0), kind='stable').tolist():
        if len(chosen) == frames:
            break
        if all(abs(stamps_ns[row] - stamps_ns[other]) >= APART_NS for other in chosen):
            chosen.append(row)
    if 0 not in chosen and frames > 1:
        # The start stands for the scene as it was asked for, however well it was seen.
        near = [row for row in chosen if stamps_ns[row] - stamps_ns[0] < APART_NS]
        chosen = [*[row for row in chosen if row not in near][:frames - 1], 0]
    return tuple(sorted(chosen))


def moments(recording: Recording, track: Track, rows: Sequence[int]) -> Iterator[Moment]:
    """The frames of some rows, with all that is known of them.

    Raises:
        BagError: the bag cannot be read.
    """
    wanted = {int(track.seq[row]): row for row in rows}
    images = {
        frame.seq: np.ascontiguousarray(frame.image)
        for frame in recording.frames(wanted.__contains__, render=False)
    }
    camera = Camera(recording.scenario)
    for seq, row in sorted(wanted.items()):
        state = track.states.get(seq)
        image = images.get(seq)
        if image is None:
            if state is None:
                continue  # a run that broke down may have left a step without a state
            image = camera.render(state, seq * CONTROL_PERIOD_NS)
        yield Moment(
            row=row, seq=seq, t_s=float(track.t_s[row]), x_m=float(track.x_m[row]), image=image,
            camera=camera.model, state=state, truth=track.truth(row), estimate=track.estimate(row),
            misled_rad=float(track.misled_rad[row]),
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
