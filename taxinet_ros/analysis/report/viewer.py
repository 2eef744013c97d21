"""A recorded run as data for the page's viewer: facts, curves, camera frames, ground."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.analysis.report.values import plain_number, signs
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.facts import RunFacts
from taxinet_ros.bag.run.judging import judge_spec, signals_of_specs
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.samples import RunSamples, run_samples
from taxinet_ros.bag.run.trace import Column
from taxinet_ros.core.mtl import SIGNALS, Spec, ast, parse_spec
from taxinet_ros.core.mtl.interval import (
    lower_column,
    rho_text,
    specs_with_interval,
    upper_column,
)
from taxinet_ros.core.mtl.specs import (
    CENTRELINE_TOLERANCE_M,
    MOST_CLEARANCE_M,
    MOST_HOLD_DISTANCE_M,
)
from taxinet_ros.core.place.catalogue import DEFAULT_PLACE, typed_place
from taxinet_ros.core.place.markings import Polygon, markings
from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import RUNWAY_TRACK, Track, painted_line
from taxinet_ros.core.scenario_fields import BY_KEY
from taxinet_ros.core.traffic.traffic import GroundObject
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import InfraError, UsageError

_CROSSING_REACH_M = 400.0
"""Half length at which the crossing runway is drawn [m]; runs stay within."""


def ground_shapes(
    runway: Runway, track: Track | None = None, *, crossing: bool
) -> dict[str, Any]:
    """Polygons in ``map`` [m] as JSON values: pavement, paint, and half width of the band.

    With a track that leaves the runway, also its pavement, its yellow lines and the band along it.
    """
    length, half = runway.length_m, runway.half_width_m
    crossings = runway.crossings if crossing else ()
    pavement = (
        ((0.0, -half), (length, -half), (length, half), (0.0, half)),
        *(one.strip(_CROSSING_REACH_M) for one in crossings),
    )
    aside = {} if track is None or track.is_runway else {'track': {
        'pavement': _corners(track.strip(track.half_width_m)),
        'band': _corners(track.strip(CENTRELINE_TOLERANCE_M)),
        'lines': [_corners(line[::4]) for line in painted_line(track, runway)],
    }}
    return {
        **aside,
        'pavement': [_corners(polygon) for polygon in pavement],
        'paint': [_corners(marking.polygon) for marking in markings(runway, crossing=crossing)],
        'tolerance': CENTRELINE_TOLERANCE_M,
        'length': length,
        'halfWidth': half,
    }


def _corners(polygon: Polygon) -> list[list[Any]]:
    return [[plain_number(x, 2), plain_number(y, 2)] for x, y in polygon]


APART_NS = NS_PER_S // 2
"""Time between frames on the page."""
MOST_FRAMES = 120
"""Maximum number of frames; runs over a minute have them farther apart, for a small page."""
_QUALITY = 70
"""WebP quality: stripes stay sharp, and a frame has about 4 kB."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Frames:
    """Camera frames of a run.

    Attributes:
        steps: row of the trace of each frame, ascending.
        files: a WebP file for each.
        missing: reason why there are fewer than intended, or ''.
    """

    steps: tuple[int, ...]
    files: tuple[bytes, ...]
    missing: str

    def data(self) -> dict[str, Any]:
        """Frames as JSON values."""
        return {
            'steps': list(self.steps), 'missing': self.missing,
            'webp': [base64.b64encode(file).decode('ascii') for file in self.files],
        }


def read_frames(recording: Recording) -> Frames:
    """Frames of some of a run's control steps, as recorded or else rendered now.

    Raises:
        BagError: a recorded frame is damaged.
    """
    stamps_ns = [int(stamp) for stamp in recording.columns['t_ns']]
    apart = max(
        round(APART_NS / recording.period_ns), math.ceil(len(stamps_ns) / MOST_FRAMES)
    )
    wanted = {
        stamp // recording.period_ns: row for row, stamp in enumerate(stamps_ns) if row % apart == 0
    }
    files, missing = dict[int, bytes](), ''
    recorded = recording.recorded_steps
    for frame in recording.frames(wanted.__contains__, render=False):
        files[wanted[frame.seq]] = _webp(frame.image)
    if not recorded.issuperset(wanted):
        try:
            for frame in recording.frames(lambda seq: seq in wanted and seq not in recorded):
                files[wanted[frame.seq]] = _webp(frame.image)
        except (BagError, UsageError, InfraError) as error:
            missing = str(error)
    steps = tuple(sorted(files))
    return Frames(steps=steps, files=tuple(files[step] for step in steps), missing=missing)


def _webp(pixels: NDArray[np.uint8]) -> bytes:
    """One frame, (H, W, 3) uint8 RGB, as a WebP file."""
    parameters = [cv2.IMWRITE_WEBP_QUALITY, _QUALITY]
    _, data = cv2.imencode('.webp', cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), parameters)
    return data.tobytes()


_COLUMNS = {
    'x': ('x_m', 1.0), 'y': ('y_m', 1.0), 'speed': ('speed_mps', 1.0), 'cte': ('cte_m', 1.0),
    'cteEstimate': ('est_cte_m', 1.0), 'he': ('he_rad', 180 / math.pi),
    'heEstimate': ('est_he_rad', 180 / math.pi), 'steering': ('steering_rad', 180 / math.pi),
}
"""Curves by name on the page: column of the trace, and factor to metres or degrees."""
_DRAWN = frozenset({'cte', 'cte_estimate', 'he', 'he_estimate', 'steering'})
"""Signals among these curves."""
_NONE_LEFT = {'clearance': MOST_CLEARANCE_M, 'hold_distance': MOST_HOLD_DISTANCE_M}
"""Values of signals where there is nothing to be near."""
_DECIMALS = 3
_TELLING = ('cross track', 'heading', 'distance', 'clouds', 'rain', 'time of day')


@dataclass(frozen=True, kw_only=True, slots=True)
class Deciding:
    """The sample that decides the robustness of a requirement about another signal than pose.

    Attributes:
        row: of the trace.
        spec: name of the requirement.
        signal: that its deciding predicate reads.
        bound: number that this is compared with; NaN if it is not compared with one.
    """

    row: int
    spec: str
    signal: str
    bound: float

    @property
    def label(self) -> str:
        """The signal with its unit, as an axis names it."""
        unit = signal_unit(self.signal)
        return f'{self.signal} [{unit}]' if unit else self.signal


@dataclass(frozen=True, kw_only=True, slots=True)
class RunView:
    """Data of the viewer of one run.

    Attributes:
        run_id: id of the run.
        outcome: one of the five words, or ''.
        place: place of the run.
        track: track of the run.
        crossing: whether the crossing runway was present.
        facts: display text of the request and the result.
        t_s: time of each control step since the start [s].
        curves: by name, a value for each step: metres, m/s, degrees; left positive. ``yaw``, where
            it is not the heading error.
        intervals: robust satisfaction interval by formula: lower and upper end for each step.
        frames: a selection of the camera frames.
        signals: further signals that its requirements read, by name in their units; NaN where there
            is nothing to be near.
        hold_lines: corners of each hold line in ``map`` [m], and when it is cleared [s].
        deciding: what decides the first requirement that is violated, else the first; None if that
            is about pose, steering or estimates.
    """

    run_id: str
    outcome: str
    place: Place
    track: Track
    crossing: bool
    facts: Mapping[str, str]
    t_s: Column
    curves: Mapping[str, Column]
    intervals: Mapping[str, tuple[Column, Column]]
    frames: Frames
    signals: Mapping[str, Column] = field(default_factory=dict)
    hold_lines: tuple[tuple[Polygon, float], ...] = ()
    deciding: Deciding | None = None

    @property
    def summary(self) -> str:
        """Place and weather, on one line."""
        return ', '.join(f'{name} {self.facts[name]}' for name in _TELLING if name in self.facts)

    @property
    def half_width_m(self) -> float:
        """Distance of the pavement's edges from the line [m]."""
        return self.track.half_width_m

    @property
    def ground_name(self) -> str:
        """Name by which runs refer to their ground."""
        kind = 'crossed' if self.crossing else 'plain'
        kind = kind if self.track.is_runway else f'{self.track.name} {kind}'
        place = self.place.reference
        return kind if place == DEFAULT_PLACE else f'{place} {kind}'

    def ground_shapes(self) -> dict[str, Any]:
        """The ground that it took place on, see :func:`ground_shapes`."""
        return ground_shapes(self.place.runway, self.track, crossing=self.crossing)

    def data(self) -> dict[str, Any]:
        """Everything as rounded JSON values."""
        return {
            'id': self.run_id,
            'outcome': self.outcome,
            'ground': self.ground_name,
            'facts': list(self.facts.items()),
            't': _rounded(self.t_s),
            **{name: _rounded(values) for name, values in self.curves.items()},
            'formulas': [
                {'name': name, 'lower': _rounded(lower), 'upper': _rounded(upper)}
                for name, (lower, upper) in self.intervals.items()
            ],
            'signals': [
                {'name': name, 'unit': signal_unit(name), 'values': _rounded(values)}
                for name, values in self.signals.items()
            ],
            'holdLines': [
                {'corners': _corners(polygon), 'until': plain_number(until_s, _DECIMALS)}
                for polygon, until_s in self.hold_lines
            ],
            'frames': self.frames.data(),
        }


def read_run_view(run_id: str, bag: Path) -> RunView:
    """Read a run for its viewer.

    Args:
        run_id: id of the run on the page.
        bag: a run folder or an ``.mcap`` file.

    Raises:
        BagError, UsageError: the bag cannot be read; frames that cannot be rendered are no error.
    """
    recording = open_recording(bag)
    trace, facts = recording.columns, recording.facts
    place = typed_place(DEFAULT_PLACE if facts is None else facts.scene['place'])
    track = place.track(RUNWAY_TRACK if facts is None else facts.scene['track'])
    curves = {
        name: np.asarray(trace[column], dtype=np.float64) * factor
        for name, (column, factor) in _COLUMNS.items()
    }
    if not track.is_runway:
        directions = [track.pose(at)[2] for at in np.nan_to_num(trace['distance_m']).tolist()]
        curves['yaw'] = curves['he'] + np.degrees(directions)
    t_s = np.asarray(trace['t_ns'], dtype=np.int64) / NS_PER_S
    signals, deciding = further_signals(recording, t_s)
    return RunView(
        run_id=run_id, outcome='' if facts is None else facts.outcome,
        place=place, track=track,
        crossing=facts is None or bool(facts.scene.get('crossing', True)),
        facts={} if facts is None else _words(facts),
        t_s=t_s, curves=curves, signals=signals, deciding=deciding,
        hold_lines=() if facts is None else tuple(
            (_outline(one), one.until_s) for one in recording.scenario.others.hold_lines),
        intervals={
            spec: (trace[lower_column(spec)], trace[upper_column(spec)])
            for spec in specs_with_interval(trace)
        },
        frames=read_frames(recording),
    )


def signal_unit(name: str) -> str:
    """Unit of a signal as it is shown; '' for a number."""
    return SIGNALS[name].removeprefix('1')


def further_signals(
    recording: Recording, t_s: Column
) -> tuple[dict[str, Column], Deciding | None]:
    """Signals that a run's requirements read beside the curves of its viewer, and what decides.

    Args:
        recording: of the run.
        t_s: time of each step of its trace [s].

    Returns:
        As :attr:`RunView.signals` and :attr:`RunView.deciding`.
    """
    if recording.facts is None:
        return {}, None
    samples = run_samples(recording)[0]
    specs = [parse_spec(text) for text in samples.specs]
    rows = np.searchsorted(t_s, np.array(samples.stamps_ns, dtype=np.int64) / NS_PER_S)
    found: dict[str, Column] = {}
    for name in sorted(signals_of_specs(specs) - _DRAWN):
        values = np.array([sample[name] for sample in samples.samples], dtype=np.float64)
        values[values >= _NONE_LEFT.get(name, np.inf)] = np.nan
        found[name] = np.full(len(t_s), np.nan)
        found[name][rows] = values
    return found, _deciding(samples, specs, t_s) if found else None


def _deciding(samples: RunSamples, specs: Sequence[Spec], t_s: Column) -> Deciding | None:
    judged = [judge_spec(samples, spec, explained=True)[0] for spec in specs]
    chosen = next((one for one in judged if one.verdict.failed), judged[0])
    found = chosen.explanation
    witness = None if found is None else found.witness
    if found is None or witness is None:
        return None
    atom = next(one for one in ast.atoms(chosen.spec.formula) if str(one) == witness.text)
    names = [name for name in ast.signal_names(atom) if name not in _DRAWN]
    if not names:
        return None
    numbers = [side.value for side in (atom.left, atom.right) if isinstance(side, ast.Number)]
    return Deciding(
        row=int(np.searchsorted(t_s, found.witness_s)), spec=chosen.spec.name,
        signal=names[0], bound=next(iter(numbers), math.nan),
    )


def _outline(one: GroundObject) -> Polygon:
    """Corners of an object that does not move, in ``map`` [m]."""
    pose = one.pose_at(0)
    ahead = np.array([math.cos(pose.heading_rad), math.sin(pose.heading_rad)])
    left = np.array([-ahead[1], ahead[0]])
    corners = (
        (pose.x_m, pose.y_m) + x * one.size.length_m / 2 * ahead + y * one.size.width_m / 2 * left
        for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1))
    )
    return tuple((float(x), float(y)) for x, y in corners)


def _rounded(values: Column) -> list[float | int | str | None]:
    return [plain_number(float(value), _DECIMALS) for value in values]


def _words(facts: RunFacts) -> dict[str, str]:
    """Display text of the facts of a run, the most important first."""
    words = {'outcome': ' '.join(w for w in (facts.outcome, facts.kind, facts.detail) if w)}
    for name, judged in facts.judged.items():
        lower, upper = judged.interval
        ends = [rho_text(end).replace('-', '−') for end in (lower, upper)]
        words[f'ρ of {name}'] = ends[0] if judged.final else ' … '.join(ends)
    if (perception := facts.nodes.get('perception')) is not None:
        words['perception'] = perception.implementation
    words['program'] = f'{facts.program}, seed {facts.seed}, run {facts.index}'
    for name, value in facts.scene.items():
        words[BY_KEY[name].label] = signs(BY_KEY[name].value_words(value))
    return {name: word for name, word in words.items() if word}
