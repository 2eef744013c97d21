"""The frames of recordings as a table: where each was taken, and what networks make of it."""

from __future__ import annotations

import contextlib
import datetime
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.core.camera.light import sun_position
from taxinet_ros.core.perception.network import usual_frame
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import Track
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.topics import ODOMETRY
from taxinet_ros.core.types import NO_ESTIMATE, NS_PER_S, TrackingError
from taxinet_ros.errors import UsageError
from taxinet_ros.recordings.estimates import (
    RecordedEstimates,
    match,
    names_topic,
    proposed_word,
)
from taxinet_ros.recordings.reader import (
    CAMERA_INFO,
    FIX,
    HEADINGS,
    IMAGES,
    SCENARIO,
    TRACKING_ERROR,
    TRUTHS,
    Recording,
    picture,
    stamp_of,
)
from taxinet_ros.recordings.truth import (
    RUNWAY,
    STANDING_MPS,
    Leap,
    Truth,
    TruthReader,
    TruthSource,
    find_leap,
    in_order,
)
from taxinet_ros.training.evaluation import image_perception

SCORED, NO_TRUTH, STANDING = 'scored', 'no truth', 'standing still'
NO_HEADING, OFF_PLACE = 'no heading', 'off the place'
OUT_OF_ORDER, NO_PICTURE = 'out of order', 'no picture'
AFTER_LEAP = 'after a leap of the clock'
STATUSES = (
    SCORED, NO_TRUTH, NO_HEADING, STANDING, OFF_PLACE, OUT_OF_ORDER, AFTER_LEAP, NO_PICTURE,
)
"""What can be said of a frame; only the first is compared with the truth."""

_BESIDE_M, _BEYOND_M = 10.0, 60.0
"""How far beside the pavement and beyond its ends an aircraft may be to be on the place."""
_DATED_NS = 946_684_800 * NS_PER_S
"""Stamps from the year 2000 on are dates; smaller ones are simulated or since the start."""
_BRIGHTNESS_EVERY = 8
_SLACK_PX = 1.0
_FOCAL_SHARE = 0.02

ENDS = '', '_2'
"""What the columns of the first and of the second network end in."""
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True, slots=True)
class Setup:
    """What is scored, where and with which camera.

    Attributes:
        place: where the aircraft was.
        track: line that errors are measured from.
        image: topic of the pictures; '' if recorded estimates themselves are the frames.
        source: of the truth.
        networks: words or files of one or two networks, or topics of recorded estimates.
        rig: camera and aircraft; None if unknown.
    """

    place: Place
    track: Track
    image: str
    source: TruthSource
    networks: tuple[str, ...]
    rig: Rig | None = None

    @property
    def frames_topic(self) -> str:
        """Topic of what is compared with the truth, frame by frame."""
        return self.image or RecordedEstimates(self.networks[0]).topic


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """Frames of one bag.

    Attributes:
        recording: the bag.
        topic: of the frames.
        seen: a row a frame: when it was taken and recorded, its mean grey level, NaN without a
            picture, and the networks' estimates [m], [rad], NaN where there is none.
        truth: of the bag.
        notes: likely mistakes.
    """

    recording: Recording
    topic: str
    seen: pd.DataFrame
    truth: Truth
    notes: list[str]

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """When each was taken."""
        return self.seen['stamp_ns'].to_numpy(np.int64)

    @cached_property
    def leap(self) -> Leap:
        """Leap of the clock of the frames."""
        return find_leap(self.topic, self.stamps_ns.tolist(), self.seen['logged_ns'].tolist())


def own_scenario(recording: Recording) -> Scenario | None:
    """The scenario of a bag that our recorder, or ``ros2 bag record`` beside our graph, made."""
    topics = recording.of_type((SCENARIO,))
    for _, _, message in recording.decoded(topics[:1]) if topics else ():
        return scenario_of(message)
    return None


def resolved_source(source: TruthSource, recording: Recording, own: bool) -> TruthSource:
    """The source with its topic, and the frame of its poses.

    Args:
        source: as given; the topic may be ''.
        recording: the bag.
        own: whether it is of a run of ours, whose poses are in the runway's frame.

    Raises:
        UsageError: a choice is left, or an option has no effect.
    """
    if not source.topic and own:
        odometry = [name for name in recording.types if name.endswith(ODOMETRY.name)]
        source = replace(source, topic=odometry[0] if len(odometry) == 1 else '')
    topic = recording.topic(source.topic, TRUTHS, 'truth')
    source, kind = replace(source, topic=source.topic or topic), recording.types[topic]
    if kind == FIX:
        if source.frame:
            raise UsageError(f'frame: {topic} has latitude and longitude; leave it out')
        return source
    if not source.frame and not own:
        raise UsageError(
            f'truth {topic}: poses of {kind} are in a frame that the bag does not place on the '
            'Earth; name their frame: runway, or LAT,LON of the origin of an east-north-up frame')
    source = replace(source, frame=source.frame or RUNWAY)
    if source.compass and source.frame == RUNWAY and not source.heading:
        raise UsageError(
            'heading_is: poses in the runway frame have no north; leave it out')
    return source


def read_frames(
    recording: Recording, setup: Setup, perceptions: Sequence[Perception], progress: Progress
) -> Frames:
    """Show every picture of a bag to the networks, and collect truth and recorded estimates.

    Raises:
        UsageError: there is no truth, the pictures do not fit the camera, or estimates no picture.
    """
    by_log = setup.source.by_log
    reader = TruthReader(setup.source, recording, setup.place.runway)
    if setup.image:
        recording.topic(setup.image, IMAGES, 'image')
    recorded = {
        number: one.read(recording, bool(setup.image), by_log)
        for number, one in enumerate(perceptions) if isinstance(one, RecordedEstimates)
    }
    infos = set(recording.of_type((CAMERA_INFO,)))
    unread, cameras, notes = Counter[str](), Counter[str](), dict[str, None]()
    rows: list[tuple[float, ...]] = []
    headers: list[int] = []
    every = slice(None, None, _BRIGHTNESS_EVERY)
    for topic, log_ns, message in recording.decoded({setup.image, *reader.topics, *infos}):
        if topic in reader.topics:
            reader.add(topic, log_ns, message)
        elif topic in infos:
            notes |= dict.fromkeys(_info_notes(topic, message, setup.rig))
        else:
            cameras[message.header.frame_id] += 1
            headers.append(stamp_of(message))
            bright, estimates = math.nan, [math.nan] * (2 * len(perceptions))
            try:
                pixels = picture(message)
            except ValueError as error:
                unread[f'{setup.image}: {{}} pictures: {error}'] += 1
            else:
                bright = float(pixels[every, every].mean())
                estimates = list(estimates_of(pixels, perceptions, setup.rig))
            rows.append((log_ns if by_log else headers[-1], log_ns, bright, *estimates))
            progress('frames', len(rows), recording.counts[setup.image])
    if len(cameras) > 1:
        listed = ', '.join(
            f'{one or "no name"} ({count})' for one, count in cameras.most_common(4))
        notes[f'{setup.image}: pictures of two cameras on one topic: {listed}'] = None
    columns = [f'{name}{end}' for end in ENDS[:len(perceptions)]
               for name in ('est_cte_m', 'est_he_rad')]
    if not setup.image:
        headers = recorded[0]['stamp_ns'].tolist()
        logged = recorded[0]['logged_ns'].tolist()
        nothing = [math.nan] * (1 + len(columns))
        rows = [(stamp_ns, log_ns, *nothing) for stamp_ns, log_ns in zip(
            logged if by_log else headers, logged, strict=True)]
    seen = pd.DataFrame(rows, columns=['stamp_ns', 'logged_ns', 'brightness', *columns])
    for number, found in recorded.items():
        values, lines = match(
            found, np.array(headers, np.int64), setup.networks[number].partition(':')[0],
            setup.image)
        seen[columns[2 * number:2 * number + 2]] = values
        notes |= dict.fromkeys(lines)
    aside = '; image none does without pictures' if len(recorded) == len(perceptions) else ''
    return Frames(
        recording=recording, topic=setup.frames_topic, truth=reader.finish(),
        seen=seen.astype({'stamp_ns': np.int64, 'logged_ns': np.int64}),
        notes=[*notes, *(note.format(count) + aside for note, count in unread.most_common(3))],
    )


def prepared(networks: Sequence[str], rig: Rig | None) -> list[Perception]:
    """The networks, ready for pictures of a rig, and recorded estimates.

    Raises:
        UsageError: one uses no pictures, or needs to know the camera.
    """
    perceptions: list[Perception] = []
    for word in networks:
        if names_topic(word):
            perceptions.append(RecordedEstimates(word))
            continue
        one = image_perception(word)
        if rig is None and getattr(one, 'view', None) is not None:
            raise UsageError(
                f'perception {word}: sees through a virtual camera, for which the real one has '
                'to be known; describe it in a camera file (docs/world.md)')
        one.begin(rig)
        perceptions.append(one)
    return perceptions


def shown(pixels: NDArray[np.uint8], rig: Rig | None) -> NDArray[np.uint8]:
    """A picture as networks get it: of the rig's camera as it is, else in their usual size.

    Raises:
        UsageError: it has not the size of the rig's camera.
    """
    if rig is None:
        return usual_frame(pixels)
    if pixels.shape != rig.camera.shape:
        (height, width), camera = pixels.shape[:2], rig.camera
        raise UsageError(
            f'the pictures are {width} x {height}, camera {camera.name} has {camera.width_px} x '
            f'{camera.height_px}; describe theirs in a camera file (docs/world.md)')
    return pixels


def estimates_of(
    pixels: NDArray[np.uint8], perceptions: Sequence[Perception], rig: Rig | None
) -> Iterator[float]:
    """Cross-track [m] and heading error [rad] of each network; NaN where it has none.

    Raises:
        UsageError: as :func:`shown`.
    """
    pixels = shown(pixels, rig)
    for perception in perceptions:
        seen = perception.estimate(pixels, None)
        yield from (seen.cte_m, seen.he_rad) if seen.usable else (math.nan, math.nan)


def shown_pictures(recordings: Sequence[Recording], setup: Setup) -> Iterator[NDArray[np.uint8]]:
    """All pictures that can be read, as :func:`shown`, in the order of :func:`read_frames`."""
    for recording in recordings:
        for _, _, message in recording.decoded((setup.image,)):
            with contextlib.suppress(ValueError):
                yield shown(picture(message), setup.rig)


class NodeAnswers(Perception):
    """Answers that a node has given to :func:`shown_pictures`, one after the other."""

    word, fingerprint, needs_image = 'node', '', True

    def __init__(self, answers: Sequence[TrackingError]) -> None:
        """Take the answers."""
        self._answers = iter(answers)

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """The next answer."""
        return next(self._answers, NO_ESTIMATE)


def frame_table(frames: Frames, setup: Setup, latency_s: float = 0.0) -> pd.DataFrame:
    """One row a frame: truth at the time of its stamp less the latency, estimates and errors."""
    stamps = frames.stamps_ns
    poses = frames.truth.at(stamps - round(latency_s * NS_PER_S))
    measured = np.array([
        setup.track.measure(x, y, yaw) for x, y, yaw in zip(
            *(column.tolist() for column in poses[:3]), strict=True)
    ], np.float64).reshape(-1, 3)
    heading = np.remainder(measured[:, 2] + math.pi, math.tau) - math.pi
    seen = frames.seen
    table = pd.DataFrame({
        'bag': str(frames.recording.path), 'number': np.arange(len(stamps)),
        't_s': (stamps - (stamps[0] if len(stamps) else 0)) / NS_PER_S,
        'stamp_ns': stamps, 'logged_ns': seen['logged_ns'],
        'status': _statuses(frames, setup, measured, poses.speed_mps),
        'x_m': poses.x_m, 'y_m': poses.y_m, 'yaw_rad': poses.yaw_rad, 'distance_m': measured[:, 0],
        'speed_mps': poses.speed_mps, 'yaw_rate_radps': poses.yaw_rate_radps,
        'cte_m': measured[:, 1], 'heading_error_deg': np.degrees(heading),
        'brightness': seen['brightness'],
        'sun_elevation_deg': _sun_elevations(stamps, setup.place.runway),
    })
    for end in ENDS[:len(setup.networks)]:
        seen_deg = np.degrees(seen[f'est_he_rad{end}'])
        table[f'est_cte_m{end}'] = seen[f'est_cte_m{end}']
        table[f'est_heading_error_deg{end}'] = seen_deg
        table[f'cte_error_m{end}'] = seen[f'est_cte_m{end}'] - table['cte_m']
        table[f'he_error_deg{end}'] = np.remainder(
            seen_deg - table['heading_error_deg'] + 180, 360) - 180
    return table


def _statuses(
    frames: Frames, setup: Setup, measured: NDArray[np.float64], speed: NDArray[np.float64]
) -> NDArray[np.str_]:
    """What can be said of each frame; of several the first one below."""
    distance, cte, heading = measured.T
    track = setup.track
    off = (np.abs(cte) > track.half_width_m + _BESIDE_M) | (distance < -_BEYOND_M) | (
        distance > track.length_m + _BEYOND_M)
    cases = {
        NO_PICTURE: np.isnan(frames.seen['brightness']) & bool(setup.image),
        AFTER_LEAP: np.arange(len(cte)) >= frames.leap.number,
        OUT_OF_ORDER: ~in_order(frames.stamps_ns), NO_TRUTH: np.isnan(cte), OFF_PLACE: off,
        STANDING: speed < STANDING_MPS, NO_HEADING: np.isnan(heading),
    }
    return np.select(list(cases.values()), list(cases), SCORED)


def _sun_elevations(stamps_ns: NDArray[np.int64], runway: Runway) -> NDArray[np.float64]:
    """Elevation of the sun [deg], minute by minute; NaN if the stamps are no dates."""
    found = np.full(len(stamps_ns), np.nan)
    minutes = stamps_ns // (60 * NS_PER_S)
    for minute in np.unique(minutes[stamps_ns >= _DATED_NS]):
        date, time_s = local_time(int(minute) * 60 * NS_PER_S, runway)
        found[minutes == minute] = math.degrees(sun_position(date, time_s, runway)[1])
    return found


def local_time(stamp_ns: int, runway: Runway) -> tuple[str, float]:
    """Local date and time of day [s] of a stamp, which is UTC."""
    moment = datetime.datetime.fromtimestamp(stamp_ns / NS_PER_S, runway.zone)
    midnight = moment.replace(hour=0, minute=0, second=0, microsecond=0)
    return moment.date().isoformat(), (moment - midnight).total_seconds()


def dated(stamps_ns: NDArray[np.int64]) -> bool:
    """Whether stamps are dates, not seconds since some start."""
    return len(stamps_ns) > 0 and bool(stamps_ns[0] >= _DATED_NS)


def time_notes(frames: Frames, truth: str) -> list[str]:
    """Likely mistakes in the times of frames and truth, a topic, one line each."""
    notes = [frames.leap.note] if frames.leap.note else []
    own, stamps = frames.truth.stamps_ns, frames.stamps_ns
    if not len(stamps) or not len(own):
        return notes
    if not stamps.any():
        return [*notes, f'{frames.topic}: its headers have no stamps; use the times of recording '
                '(stamps log)']
    apart_s = max(int(own[0] - stamps[-1]), int(stamps[0] - own[-1])) / NS_PER_S
    if apart_s <= 0:
        return notes
    shift_s = (stamps[0] - own[0]) / NS_PER_S
    hours = round(shift_s / 1800) / 2
    if dated(stamps) != dated(own):
        why = 'one counts from the start of a computer, the other from 1970'
    elif hours and abs(shift_s - 3600 * hours) < 120:
        why = f'{hours:+g} h: a time zone in one of the clocks'
    else:
        why = f'{shift_s:+.1f} s between their beginnings: clocks that were not synchronised'
    return [*notes, f'{frames.topic} and {truth} do not overlap in time ({why}); use the '
            'times of recording (stamps log)']


def place_notes(table: pd.DataFrame, setup: Setup) -> list[str]:
    """Likely mistakes about the place, one line each."""
    known = table[np.isfinite(table['cte_m'])]
    if not len(known):
        return []
    off = known[known['status'] == OFF_PLACE]
    notes = []
    if len(off) > len(known) / 2:
        distance, cte = float(off['distance_m'].median()), float(off['cte_m'].median())
        beyond = max(0.0, -distance, distance - setup.track.length_m)
        far = math.hypot(beyond, cte)
        notes.append(
            f'{len(off)} of {len(known)} frames are off {setup.track.name} of {setup.place.name}, '
            f'by {far:,.0f} m: another place, another runway (track), or '
            + ('another frame' if setup.source.frame else 'latitude and longitude swapped'))
    turned = known['heading_error_deg'].abs()
    if len(known) and float(turned.median()) > 150:
        notes.append(
            f'the aircraft taxies against the direction of {setup.track.name} of '
            f'{setup.place.name}; describe the place from the other end')
    return notes


def _info_notes(topic: str, message: Any, rig: Rig | None) -> Iterator[str]:
    """A line if the calibration in the bag is not that of the rig's camera."""
    if rig is None or not (message.k[0] > 0):
        return
    camera = rig.camera
    fx, fy, cx, cy = (float(message.k[index]) for index in (0, 4, 2, 5))
    size = int(message.width), int(message.height)
    focal = np.abs(np.array([fx, fy]) / camera.focal_px - 1).max()
    centre = np.abs(np.array([cx, cy]) - camera.centre_px).max()
    if size != (camera.width_px, camera.height_px) or focal >= _FOCAL_SHARE or centre >= _SLACK_PX:
        yield (
            f'{topic}: {size[0]} x {size[1]}, focal lengths {fx:.1f}, {fy:.1f}, centre {cx:.1f}, '
            f'{cy:.1f}; camera {camera.name} has other values: calibrate the camera to the bag')


def proposals(path: Path) -> list[dict[str, Any]]:
    """Topic, type, number of messages and use of all topics of a bag, the most frequent first."""
    recording = Recording(path)
    uses = {'image': IMAGES, 'truth': TRUTHS, 'heading': HEADINGS,
            'perception': (TRACKING_ERROR,), 'checks camera': (CAMERA_INFO,)}
    found = []
    for name, count in recording.counts.most_common():
        kind = recording.types[name]
        use = ', '.join(use for use, types in uses.items() if kind in types)
        if not use and not kind.startswith('taxinet_msgs/'):
            word = proposed_word(recording, name)
            use = f'perception {word}' if word else ''
        found.append({'topic': name, 'type': kind, 'messages': count, 'use': use})
    return found
