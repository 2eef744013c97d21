"""Score networks on recordings: errors with intervals, requirements, alarms, likely mistakes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from taxinet_ros.core import topics
from taxinet_ros.core.assurance.checks import Kinematics
from taxinet_ros.core.assurance.monitor import CalibratedMonitor, Seen, make_monitor
from taxinet_ros.core.assurance.switch import alarm_of
from taxinet_ros.core.control_step import rolling_on
from taxinet_ros.core.mtl import SIGNALS, Monitor, Spec, parse_spec, signal_names
from taxinet_ros.core.mtl.lint import formula_words
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.place.catalogue import typed_place
from taxinet_ros.core.place.track import RUNWAY_TRACK
from taxinet_ros.core.rig.catalogue import AIRCRAFT, CAMERAS, DEFAULT_AIRCRAFT
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CAMERA_OFFSETS
from taxinet_ros.core.topics import COMMAND as COMMAND_TOPIC
from taxinet_ros.core.trace import trace_signals
from taxinet_ros.core.types import NO_ESTIMATE, NS_PER_S, TaxiCommand, TrackingError, step_stamp_ns
from taxinet_ros.core.user_code import COMMAND
from taxinet_ros.errors import UsageError
from taxinet_ros.recordings.estimates import RecordedEstimates, names_topic
from taxinet_ros.recordings.frames import (
    AFTER_LEAP,
    ENDS,
    OUT_OF_ORDER,
    SCORED,
    STATUSES,
    Frames,
    NodeAnswers,
    Progress,
    Setup,
    estimates_of,
    frame_table,
    own_scenario,
    place_notes,
    prepared,
    read_frames,
    resolved_source,
    shown_pictures,
    time_notes,
)
from taxinet_ros.recordings.reader import IMAGES, Recording, picture, stamp_of
from taxinet_ros.recordings.statistics import (
    Latency,
    Mean,
    block_mean,
    blocks_of,
    estimate_latency,
)
from taxinet_ros.recordings.truth import TruthSource
from taxinet_ros.training.evaluation import mirrored_errors
from taxinet_ros.trials.requirements import read_specs

DEFAULT_SPECS = 'phi_always', 'phi_eventually'
ESTIMATED = 'estimated'
NO_IMAGE = 'none'
WORST = 8
QUANTITIES = {'cte': ('cross-track', 'm', 'cte_error_m'),
              'heading': ('heading', 'deg', 'he_error_deg')}

_LONGEST_GAP_S = 0.5
NOTABLE_LATENCY_S = 0.04
_WORST_APART_S = 1.0
_FLIPPED = 40
_SCALES = (
    ((1 / 0.3048, 'its cross-track error is in feet, expected m'),
     (0.3048, 'the truth, or its training, is in feet, not m')),
    ((math.degrees(1), 'its heading error is in degrees, expected rad'),
     (math.radians(1), 'its heading error is multiplied by pi/180 once too often')),
)
"""Of cross-track and heading error: what the scale of the estimates would be, and why."""
_SCALE_SHARE = 0.2
Picture = NDArray[np.uint8]
_CLEAR_CORRELATION = 0.8


@dataclass(frozen=True, kw_only=True, slots=True)
class ScoreOptions:
    """What to score, as given by a user; '' or () leaves a choice to the recording.

    Attributes:
        bags: recordings, each with its own truth.
        source: of the truth.
        perception, against: networks, or topics of recorded estimates (:mod:`.estimates`); the
            second may be ''.
        place, track: where; those of a run of ours by default.
        image: topic of the pictures, or :data:`NO_IMAGE`: recorded estimates count at their own
            stamps.
        camera, aircraft: the rig; '' is unknown, except for a run of ours.
        latency: [s], or :data:`ESTIMATED`, or ''.
        specs: requirements on the recorded path.
        monitor: run-time monitor, or ''.
        dataset: where labelled images are to be written; None for nowhere.
    """

    bags: tuple[Path, ...]
    source: TruthSource
    perception: str
    against: str = ''
    place: str = ''
    track: str = ''
    image: str = ''
    camera: str = ''
    aircraft: str = ''
    latency: str = ''
    specs: tuple[str, ...] = ()
    monitor: str = ''
    dataset: Path | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Slice:
    """Mean absolute errors on some of the frames.

    Attributes:
        kind, name: such as ``distance`` and ``0 to 200 m``.
        errors: by quantity of :data:`QUANTITIES`, one for each network.
        better: mean of the first network's absolute error less the second's, by quantity; empty
            for one network.
    """

    kind: str
    name: str
    errors: Mapping[str, tuple[Mean, ...]]
    better: Mapping[str, Mean]


@dataclass(frozen=True, kw_only=True, slots=True)
class PathVerdict:
    """A requirement on an uninterrupted stretch of the recorded path.

    Attributes:
        bag, start_s, duration_s: the stretch.
        spec: name of the formula.
        verdict: SATISFIED, VIOLATED, or UNCLEAR if the stretch does not decide it.
        lower, upper: robustness.
        words: what the formula asks.
    """

    bag: str
    start_s: float
    duration_s: float
    spec: str
    verdict: str
    lower: float
    upper: float
    words: str


@dataclass(kw_only=True, eq=False)
class Score:
    """The findings.

    Attributes:
        setup: what was scored.
        bags: frames by bag.
        table: one row a frame, of all bags.
        scored: mask of the rows that count.
        networks: words of the networks, with their fingerprints.
        slices: errors; the first row is of all frames.
        alike: frames that count as one independent one, for the first network.
        latency: estimated.
        applied_s: latency that was taken off.
        verdicts: of requirements.
        alarms: what the monitor says of the frames of control steps: their number, alarms by
            reason and the time of the first one; None without a monitor.
        mirrored: errors with the other sign, see :func:`.mirrored_errors`.
        notes: likely mistakes and limits, one line each.
        scenario: of a run of ours, or None.
        worst: rows of the largest errors of each network, the worst first.
        start: our scenario of how the recording began; None if it was not simulated.
        gap: errors on recorded and on rendered frames of the same poses, as of two networks; empty
            if it was not simulated.
        pairs: pictures by row, recorded and rendered, of some.
    """

    setup: Setup
    bags: list[Frames]
    table: pd.DataFrame
    networks: dict[str, str]
    slices: list[Slice]
    alike: float
    latency: Latency
    applied_s: float
    verdicts: list[PathVerdict]
    mirrored: Mapping[str, float]
    alarms: Mapping[str, Any] | None = None
    notes: list[str] = field(default_factory=list)
    scenario: Scenario | None = None
    worst: Sequence[Sequence[int]] = ()
    start: Scenario | None = None
    gap: Sequence[Slice] = ()
    pairs: Mapping[int, tuple[Picture, Picture]] = field(default_factory=dict)

    @property
    def scored(self) -> NDArray[np.bool_]:
        """Mask of the rows that are compared with the truth."""
        return np.asarray(self.table['status'] == SCORED, np.bool_)

    @property
    def counts(self) -> dict[str, int]:
        """Number of frames by what can be said of them."""
        found = Counter(self.table['status'])
        return {status: found[status] for status in STATUSES if found[status]}


Play = Callable[[str, Iterator[Picture], Scenario], Sequence[TrackingError]]
"""Plays pictures into the node of a command, and gives its answers."""


def score(
    options: ScoreOptions, progress: Progress = lambda *_: None, play: Play | None = None
) -> Score:
    """Score one or two networks on recordings.

    Args:
        options: what and where.
        progress: called after each frame.
        play: what plays pictures into a node, for a perception ``cmd:COMMAND``.

    Raises:
        UsageError: something cannot be used, or no frame can be compared with the truth; the line
            names the likely mistake.
    """
    recordings = [Recording(path) for path in options.bags]
    if len({one.path.resolve() for one in recordings}) < len(recordings):
        raise UsageError('score: a recording is named twice; leave one out')
    scenario = own_scenario(recordings[0])
    specs = [parse_spec(text) for text in read_specs(options.specs or DEFAULT_SPECS)]
    _check_read(specs)
    setup = make_setup(options, recordings[0], scenario)
    if options.dataset is not None:
        dataset_folders(options.dataset, recordings)
    perceptions: list[Perception] = []
    if play is not None and setup.networks[0].startswith(COMMAND):
        perceptions.append(NodeAnswers(play(
            setup.networks[0], shown_pictures(recordings, setup), _scene(scenario, setup.rig))))
    perceptions += prepared(setup.networks[len(perceptions):], setup.rig)
    bags = [read_frames(one, setup, perceptions, progress) for one in recordings]
    latency = estimate_latency([
        (one.truth, one.stamps_ns[:one.leap.number],
         one.seen[['est_cte_m', 'est_he_rad']].to_numpy()[:one.leap.number]) for one in bags
    ], setup.track)
    applied_s = _applied(options.latency, latency)
    table = pd.concat(
        [frame_table(one, setup, applied_s) for one in bags], ignore_index=True)
    notes = [note for one in bags for note in _bag_notes(one, table, setup)]
    kept = table[table['status'] == SCORED]
    if not len(kept):
        raise UsageError(_nothing(table, notes))
    slices, alike = sliced(table, len(perceptions))
    estimates, truth = _pairs(kept)
    mirrored = mirrored_errors(estimates, truth)
    found = Score(
        setup=setup, bags=bags, table=table, slices=slices, alike=alike, latency=latency,
        applied_s=applied_s, mirrored=mirrored, scenario=scenario,
        worst=[worst_rows(table, end) for end in ENDS[:len(perceptions)]],
        networks={word: one.fingerprint for word, one in zip(
            setup.networks, perceptions, strict=True)},
        verdicts=[one for spec in specs for one in path_verdicts(table, spec)],
        notes=notes + _scale_notes(estimates, truth, setup.networks[0]),
    )
    if mirrored:
        # On a path that weaves evenly, clocks half a period apart look alike.
        apart = '; or the clocks differ by seconds' if math.isnan(latency.value_s) else ''
        found.notes.append(_sign_note(found, perceptions[:1]) + apart)
    if options.monitor:
        found.alarms = _watch(found, options.monitor)
    return found


def make_setup(
    options: ScoreOptions, recording: Recording, scenario: Scenario | None
) -> Setup:
    """What is scored, from the options and, for a run of ours, its scenario.

    Raises:
        UsageError: the place is unknown, or a topic is missing or not the only one.
    """
    if not options.place and scenario is None:
        raise UsageError('score: place is missing: a name or file of `taxinet place`')
    place = typed_place(options.place or (scenario.place if scenario else ''))
    track = place.track(options.track or (
        scenario.track if scenario and not options.place else RUNWAY_TRACK))
    rig = scenario.rig if scenario else None
    if options.camera or options.aircraft:
        if not options.camera:
            raise UsageError('aircraft: without a camera it has no effect')
        rig = Rig(camera=CAMERAS.typed(options.camera), aircraft=AIRCRAFT.typed(
            options.aircraft or DEFAULT_AIRCRAFT))
    networks = (options.perception, *filter(None, (options.against,)))
    if len(set(networks)) < len(networks):
        raise UsageError(f'against {options.against}: is the perception itself; name another')
    without = all(map(names_topic, networks)) and (
        options.image == NO_IMAGE or not (options.image or recording.of_type(IMAGES)))
    both = [f'/{topic.name}' for topic in topics.FRAMES]  # of a run of ours: its first camera
    given = options.image or (both[0] if set(both) <= recording.counts.keys() else '')
    image = '' if without else recording.topic(given, IMAGES, 'image')
    if image == both[1] and scenario is not None and not options.camera:
        rig = replace(scenario.rig, camera=scenario.cameras[-1])
    for option in ('camera', 'monitor', 'dataset'):
        if without and getattr(options, option):
            raise UsageError(f'{option}: without pictures it has no effect')
    return Setup(
        place=place, track=track, rig=rig, networks=networks, image=image,
        source=resolved_source(options.source, recording, scenario is not None),
    )


def dataset_folders(out: Path, recordings: Sequence[Recording]) -> dict[Path, str]:
    """Path of the recording by its new folder of labelled images.

    Raises:
        UsageError: a folder exists, or two recordings have one name.
    """
    found = {out / one.path.stem: str(one.path) for one in recordings}
    if len(found) < len(recordings):
        raise UsageError(f'dataset {out}: two recordings have the same name; rename one')
    for folder in found:
        if folder.exists():
            raise UsageError(f'dataset {out}: {folder} exists; choose a new folder')
    return found


def _scene(scenario: Scenario | None, rig: Rig | None) -> Scenario:
    """A scenario that names camera and aircraft."""
    if rig is None:
        return scenario or Scenario()
    values: dict[str, Any] = {field.attribute: 0.0 for field in CAMERA_OFFSETS}
    values |= {'camera': rig.camera.text, 'aircraft': rig.aircraft.text}
    return replace(scenario or Scenario(), **values)


def _applied(given: str, latency: Latency) -> float:
    if given == ESTIMATED:
        if math.isnan(latency.value_s):
            raise UsageError(
                f'latency estimated: it cannot be estimated here: {latency.why}; give seconds')
        return latency.value_s
    try:
        seconds = float(given or 0)
    except ValueError:
        seconds = math.nan
    if not abs(seconds) <= 10:
        raise UsageError(f'latency {given!r:.40}: expected seconds, at most 10, or estimated')
    return seconds


def _bag_notes(frames: Frames, table: pd.DataFrame, setup: Setup) -> Iterator[str]:
    name = frames.recording.path.name
    own = table[table['bag'] == str(frames.recording.path)]
    notes = [*frames.truth.notes, *time_notes(frames, setup.source.topic_name)]
    notes += place_notes(own, setup) + frames.notes
    notes += [frames.recording.note] if frames.recording.note else []
    notes += [f'{setup.source.topic}: {count} samples left out: {why}' for why, count in
              frames.truth.left_out.items() if count]
    if frames.truth.spread_m > 0.25:
        notes.append(
            f'{setup.source.topic}: states a standard deviation of {frames.truth.spread_m:.2f} m; '
            'cross-track errors of that size are its own')
    return (f'{name}: {note}' for note in notes)


def _nothing(table: pd.DataFrame, notes: Sequence[str]) -> str:
    counts = ', '.join(f'{count} {status}' for status, count in Counter(table['status']).items())
    why = notes[0] if notes else 'check truth and place (taxinet score --topics)'
    return f'score: none of {len(table)} frames can be compared ({counts}): {why}'


def _check_read(specs: Sequence[Spec]) -> None:
    readable = {'cte', 'he', 'x', 'speed', 'cte_estimate', 'he_estimate', 'estimate_gap',
                'unusable_share'}
    for spec in specs:
        for name in signal_names(spec.formula):
            if name not in readable:
                raise UsageError(
                    f'spec {spec.name}: reads {name}, which a recording does not tell; it tells '
                    f'{", ".join(sorted(readable))}')


def stretches(table: pd.DataFrame) -> NDArray[np.int64]:
    """Number of the uninterrupted stretch of each row, ascending: of one bag, without a gap."""
    stamps = table['stamp_ns'].to_numpy(np.int64)
    apart = (np.diff(stamps) > _LONGEST_GAP_S * NS_PER_S) | (np.diff(stamps) < 0)
    apart |= table['bag'].to_numpy()[1:] != table['bag'].to_numpy()[:-1]
    return np.concatenate([[0], np.cumsum(apart)]) if len(stamps) else np.zeros(0, np.int64)


def sliced(table: pd.DataFrame, networks: int) -> tuple[list[Slice], float]:
    """Errors of all scored frames and by what they show; how many count as one for the first."""
    kept = table[table['status'] == SCORED].reset_index(drop=True)
    absolute = {
        name: np.stack([kept[f'{column}{end}'].abs().to_numpy(np.float64)
                        for end in ENDS[:networks]])
        for name, (_, _, column) in QUANTITIES.items()
    }
    groups = stretches(kept)
    # Each network's own, so that one whose errors hardly vary leaves the other its interval.
    own = [blocks_of(np.stack([columns[number] for columns in absolute.values()]), groups)
           for number in range(networks)]
    differences = {quantity: columns[0] - columns[1] for quantity, columns in absolute.items()
                   if networks > 1}
    # Errors that both networks share are not in the difference, which is less correlated.
    paired = {quantity: blocks_of(one[None], groups)[0] for quantity, one in differences.items()}
    rows = []
    for kind, name, mask in _masks(kept):
        errors = {
            quantity: tuple(block_mean(np.where(mask, one, np.nan), blocks)
                            for one, (blocks, _) in zip(columns, own, strict=True))
            for quantity, columns in absolute.items()
        }
        better = {
            quantity: block_mean(np.where(mask, one, np.nan), paired[quantity])
            for quantity, one in differences.items()
        }
        rows.append(Slice(kind=kind, name=name, errors=errors, better=better))
    return rows, own[0][1]


def _masks(kept: pd.DataFrame) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
    """Kind, name and mask of the parts with frames, all of them first."""
    yield 'all', 'all frames', np.ones(len(kept), np.bool_)
    distance = kept['distance_m']
    width = next((one for one in (50, 100, 200, 500) if np.ptp(distance) / one <= 8), 1000)
    edges = np.arange(math.floor(distance.min() / width), distance.max() / width + 1) * width
    parts = [
        ('distance', 'm', distance, edges),
        ('sun', 'deg high', kept['sun_elevation_deg'], np.array([-90, 0, 10, 30, 90])),
        ('picture', 'mean grey', kept['brightness'], np.array([0, 60, 120, 180, 256])),
        ('offset', 'm', kept['cte_m'].abs(), np.array([0, 1, 3, 6, 1000])),
        ('heading', 'deg', kept['heading_error_deg'].abs(), np.array([0, 2, 10, 180])),
    ]
    for kind, unit, values, limits in parts:
        for low, high in pairwise(limits):
            mask = ((values >= low) & (values < high)).to_numpy(np.bool_)
            if mask.any():
                yield kind, f'{low:g} to {high:g} {unit}', mask


def relative_errors(table: pd.DataFrame, end: str) -> pd.DataFrame:
    """Errors of a network's scored frames by quantity, as multiples of their mean."""
    kept = table[table['status'] == SCORED]
    return pd.DataFrame({
        quantity: kept[f'{column}{end}'].abs() / max(
            float(kept[f'{column}{end}'].abs().mean()), 1e-9)
        for quantity, (_, _, column) in QUANTITIES.items()})


def worst_rows(table: pd.DataFrame, end: str = '') -> list[int]:
    """Rows of the largest errors of a network, a second apart or more; ``end`` of :data:`ENDS`."""
    size = relative_errors(table, end).sum(axis=1, skipna=False)
    found: list[int] = []
    at = table[['bag', 'stamp_ns']].to_dict('index')
    for row in size.dropna().sort_values(ascending=False, kind='stable').index.tolist():
        if all(at[other]['bag'] != at[row]['bag'] or abs(
                at[other]['stamp_ns'] - at[row]['stamp_ns']) >= _WORST_APART_S * NS_PER_S
                for other in found):
            found.append(row)
        if len(found) == WORST:
            break
    return found


def path_verdicts(table: pd.DataFrame, spec: Spec) -> Iterator[PathVerdict]:
    """Judge a requirement on each uninterrupted stretch of the recorded path."""
    known = table[np.isfinite(table['cte_m']) & ~table['status'].isin([OUT_OF_ORDER, AFTER_LEAP])]
    known = known.reset_index(drop=True)
    for _, part in known.groupby(stretches(known), sort=True):
        stamps = part['stamp_ns'].to_numpy(np.int64)
        if len(stamps) < 2:
            continue
        times = stamps - stamps[0]
        radians = {f'{name}he_rad': np.radians(part[f'{name}heading_error_deg'])
                   for name in ('', 'est_')}
        signals = trace_signals(times, {
            **{name: part[name] for name in ('cte_m', 'speed_mps', 'distance_m', 'est_cte_m')},
            **radians,
        })
        monitor = Monitor(spec, int(times[-1]), max_gap_ns=round(_LONGEST_GAP_S * NS_PER_S))
        names = signal_names(spec.formula)
        for at, stamp in enumerate(times.tolist()):
            monitor.push(stamp, {name: float(signals[name][at]) for name in names})
        last = monitor.reading
        decided = last.final and last.valid and math.isfinite(last.lower)
        word = ('SATISFIED' if last.lower > 0 else 'VIOLATED') if decided else 'UNCLEAR'
        yield PathVerdict(
            bag=str(part['bag'].iloc[0]), start_s=float(part['t_s'].iloc[0]), spec=spec.name,
            duration_s=float(times[-1]) / NS_PER_S, verdict=word, lower=last.lower,
            upper=last.upper, words=formula_words(spec.formula, SIGNALS),
        )


def _pairs(kept: pd.DataFrame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Estimates of the first network and truth, (n, 2) each [m], [rad]."""
    found = [
        np.stack([kept[f'{name}cte_m'], np.radians(kept[f'{name}heading_error_deg'])], axis=1)
        for name in ('est_', '')
    ]
    return found[0], found[1]


def _scale_notes(
    estimates: NDArray[np.float64], truth: NDArray[np.float64], network: str
) -> list[str]:
    """A line for each quantity whose scale is that of another unit."""
    known = np.isfinite(estimates).all(axis=1)
    notes = []
    for column, reasons in enumerate(_SCALES):
        seen, real = estimates[known, column], truth[known, column]
        if len(seen) < WORST or seen.std() == 0 or real.std() == 0:
            continue
        if abs(np.corrcoef(seen, real)[0, 1]) < _CLEAR_CORRELATION:
            continue
        scale = float(seen.std() / real.std())
        notes += [
            f'{network}: estimates are {scale:.3g} times the truth: {why}'
            for factor, why in reasons if abs(scale / factor - 1) < _SCALE_SHARE
        ]
    return notes


def _sign_note(found: Score, perceptions: Sequence[Perception]) -> str:
    """Which sign is wrong: that of the pictures, or that of one quantity."""
    names = {'cte_m': 'cross-track', 'he_deg': 'heading'}
    turned = ' and '.join(names[one] for one in found.mirrored)
    begun = f'{turned}: the estimates fall where the truth rises'
    if isinstance(perceptions[0], RecordedEstimates):
        return (f'{begun}: the signs of estimates or truth (left is positive, and a minus before '
                f'a field of {perceptions[0].topic} turns it), or they are as wrong as that')
    if len(found.mirrored) < len(names):
        return f'{begun}: the signs of truth or network; left is positive'
    if isinstance(perceptions[0], NodeAnswers):
        return f'{begun}: mirrored pictures, or the signs of the truth; left is positive'
    errors: list[tuple[float, float]] = []
    true_m = found.table['cte_m'].tolist()
    for row, pixels in row_pictures(found, spread(found, _FLIPPED)):
        seen = [next(estimates_of(one, perceptions, found.setup.rig))
                for one in (pixels, np.ascontiguousarray(pixels[:, ::-1]))]
        errors.append((abs(seen[0] - true_m[row]), abs(seen[1] - true_m[row])))
    kept, flipped = np.nanmean(np.array(errors), axis=0) if errors else (math.nan, math.nan)
    if flipped < 0.6 * kept:
        return (f'{begun}, and in pictures turned left to right the cross-track error is '
                f'{flipped:.2f} m instead of {kept:.2f} m: the pictures are mirrored')
    return f'{begun}: the truth is right positive, or its heading is turned; left is positive'


def spread(found: Score, count: int) -> list[int]:
    """Rows of up to ``count`` scored frames, evenly spread."""
    rows = np.flatnonzero(found.scored)
    return rows[np.linspace(0, len(rows) - 1, min(count, len(rows))).astype(int)].tolist()


def row_pictures(found: Score, rows: Sequence[int]) -> Iterator[tuple[int, Picture]]:
    """Row and picture of some rows, in the order of the table, by another pass through the bags."""
    chosen = found.table.loc[sorted(rows)]
    for frames in found.bags:
        own = chosen.index[chosen['bag'] == str(frames.recording.path)].tolist()
        wanted = dict(zip(chosen.loc[own, 'number'].tolist(), own, strict=True))
        messages = frames.recording.decoded((found.setup.image,)) if own else ()
        for number, (_, _, message) in enumerate(messages):
            if number in wanted:
                yield wanted[number], picture(message)
            if number >= max(wanted):
                break


def _watch(found: Score, word: str) -> dict[str, Any]:
    """Show the frames to a run-time monitor: to each control step, the nearest."""
    rig, table = found.setup.rig, found.table
    if rig is None:
        raise UsageError(
            f'monitor {word}: needs to know the camera; describe it in a camera file')
    monitor = make_monitor(word)
    kinematics = monitor.calibration.fitted.kinematics if isinstance(
        monitor, CalibratedMonitor) else None
    scenario = _scene(found.scenario, rig)
    stamps = table['stamp_ns'][found.scored]
    steps = np.rint(stamps / scenario.period_ns)
    off = (stamps - steps * scenario.period_ns).abs()
    rows = sorted(off.groupby([table['bag'][found.scored], steps]).idxmin().tolist())
    reasons, first_s, largest = Counter[str](), math.nan, dict[str, float]()
    bag, own = '', dict[int, TaxiCommand]()
    for row, pixels in row_pictures(found, rows):
        at: Any = table.loc[row]
        if at['bag'] != bag:
            bag, own = at['bag'], _own_commands(found, at['bag'])
            monitor.begin(scenario)
        estimate = NO_ESTIMATE if math.isnan(at['est_cte_m']) else TrackingError(
            cte_m=at['est_cte_m'], he_rad=math.radians(at['est_heading_error_deg']))
        command = own.get(step_stamp_ns(int(steps[row]) - 1, scenario.period_ns), rolling_on(
            scenario.speed_mps)) if own else _command(at, kinematics)
        scores = monitor.scores(Seen(image=pixels, estimate=estimate, command=command))
        largest |= {name: max(score, largest.get(name, score)) for name, score in scores.items()}
        alarm = alarm_of(scores, row)
        if alarm is not None:
            reasons[alarm.reason] += 1
            first_s = first_s if math.isfinite(first_s) else float(at['t_s'])
    return {'monitor': word, 'frames': len(rows), 'alarms': reasons.total(), 'largest': largest,
            'reasons': dict(reasons), 'first_s': first_s, 'derived': not own}


def _own_commands(found: Score, bag: str) -> dict[int, TaxiCommand]:
    """Commands of a run of ours by their stamps; none of other recordings."""
    if found.scenario is None:
        return {}
    [recording] = [one.recording for one in found.bags if str(one.recording.path) == bag]
    topics = [name for name in recording.types if name.endswith(f'/{COMMAND_TOPIC.name}')]
    return {
        stamp_of(message): TaxiCommand(
            steering_rad=message.steering_angle, speed_mps=message.speed)
        for _, _, message in recording.decoded(topics)
    }


def _command(row: Any, kinematics: Kinematics | None) -> TaxiCommand:
    """The command that explains the recorded motion, as recordings of others have none."""
    speed_mps = max(float(row['speed_mps']), 0.0)
    per_m = kinematics.turn_per_m if kinematics is not None else 0.0
    turned = float(row['yaw_rate_radps'])
    path = speed_mps * per_m
    steering = math.atan(turned / path) if path and math.isfinite(turned) else 0.0
    return TaxiCommand(steering_rad=steering, speed_mps=speed_mps)
