"""Pictures added to a training set: of a program (``crossing=2400``) or of failed runs.

The paper's iterative retraining adds 20 % of one kind to a set (Appendix A): pictures of a Scenic
program, handwritten or learned, or counterexamples of falsification.

The pictures that misled the network lie along the path of a failed run, not only at its start.
Training on places along the path, labelled with the truth, is counterexample-guided data
augmentation (Dreossi et al., IJCAI 2018); since the network's own steering led there, it is also
dataset aggregation (Ross et al., AISTATS 2011).
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.perception.weights import Source
from taxinet_ros.core.place.track import Track
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.scenes.source import program_digest
from taxinet_ros.training.data.dataset import Progress, draw_scenes, no_progress
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign, open_failed_campaign

SPREAD_M = 0.5
"""Standard deviation [m] of the lateral offset from the path: consecutive steps look alike, and the
next network will take another path."""
SPREAD_RAD = math.radians(2.0)
"""Standard deviation of the heading offset [rad]."""
MAX_CROSS_TRACK_M = 14.0
"""Maximum cross-track error of a place [m]: an aircraft on the grass is of no use for training."""
MAX_HEADING_RAD = math.radians(60.0)
_Path = tuple[Scenario, NDArray[np.float64]]
"""The scene of a run, and distance [m], cross-track [m] and heading error [rad] along it."""


def counterexample_scenes(
    folder: Path, count: int, seed: int, progress: Progress = no_progress
) -> list[Scenario]:
    """Scenes that start at places of failed runs, drawn evenly over runs and steps.

    Args:
        folder: folder of the campaign with the runs' bags; their pictures are not needed.
        count: number of scenes; several may be at one step if there are few runs.
        seed: seed of the draws.
        progress: called with stage ``runs`` after every bag.

    Raises:
        UsageError: there is no campaign, no failed run, or none whose bag can be read.
    """
    paths = _paths(open_failed_campaign(folder), progress)
    rng = np.random.default_rng(seed)
    return [_scene_on_path(*paths[rng.integers(len(paths))], rng) for _ in range(count)]


def record_digest(folder: Path) -> str:
    """SHA-256 of a campaign's record, which contains its runs and results.

    Raises:
        UsageError: it cannot be read.
    """
    try:
        return hashlib.sha256((folder / RECORD_NAME).read_bytes()).hexdigest()
    except OSError as error:
        raise UsageError(f'{folder / RECORD_NAME}: {error.strerror}') from error


def _paths(campaign: RecordedCampaign, progress: Progress) -> list[_Path]:
    found: list[_Path] = []
    for number, row in enumerate(campaign.counterexamples, 1):
        try:
            trace = open_recording(campaign.folder / row.run_id).columns
        except (BagError, UsageError):
            continue  # skip a deleted or damaged bag
        scene, _ = campaign.scenario(row)
        columns = np.stack([trace['distance_m'], trace['cte_m'], trace['he_rad']], axis=1)
        way = columns.astype(np.float64)[_useful_places(columns, scene.line)]
        if len(way):
            found.append((scene, way))
        progress('runs', number, len(campaign.counterexamples))
    if not found:
        raise UsageError(
            f'{campaign.folder}: no bag of its {len(campaign.counterexamples)} failed runs can be '
            'read; run the campaign again'
        )
    return found


def _useful_places(columns: NDArray[np.generic], track: Track) -> NDArray[np.bool_]:
    distance, cte, heading = columns.astype(np.float64).T
    return (
        (distance >= 0) & (distance <= min(2600, track.last_start_m))
        & (np.abs(cte) <= _most_aside_m(track)) & (np.abs(heading) <= MAX_HEADING_RAD)
    )


def _most_aside_m(track: Track) -> float:
    return min(MAX_CROSS_TRACK_M, track.farthest_start_m)


def _scene_on_path(scene: Scenario, way: NDArray[np.float64], rng: np.random.Generator) -> Scenario:
    distance, cte, heading = way[rng.integers(len(way))]
    most_m = _most_aside_m(scene.line)
    aside, turned = rng.normal(0, SPREAD_M), rng.normal(0, SPREAD_RAD)
    return dataclasses.replace(
        scene,
        distance_m=float(distance),
        cross_track_m=float(np.clip(cte + aside, -most_m, most_m)),
        heading_rad=float(heading + turned),
    )


MAX_PICTURES = 1_000_000
"""Maximum number of pictures of one portion."""
_PORTIONS = 3
"""Stream key that separates the random numbers of portions from others of the same seed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Portion:
    """A number of pictures of one origin.

    Attributes:
        kind: ``program`` for scenes of a Scenic program, ``runs`` for places along a campaign's
            failed runs.
        name: word or path of the program, or path of the campaign's folder.
        count: number of training pictures.
    """

    kind: Literal['program', 'runs']
    name: str
    count: int

    def __str__(self) -> str:
        return f'{self.name}={self.count}'

    def scenes(self, count: int, seed: int, progress: Progress) -> list[Scenario]:
        """Draw ``count`` scenes of this origin.

        Raises:
            UsageError: there is no such program or campaign, or it has no scenes.
        """
        if self.kind == 'program':
            return draw_scenes(self.name, seed=seed, images=count, progress=progress)
        return counterexample_scenes(Path(self.name), count, seed, progress)

    def source(self) -> Source:
        """Its entry in a model card."""
        if self.kind == 'program':
            return program_source(self.name)
        folder = Path(self.name)
        return Source(kind='runs', name=folder.resolve().name, sha256=record_digest(folder))


def program_source(program: str) -> Source:
    """Model card entry of a Scenic program, given by word or path."""
    path = find_program(program)
    return Source(kind='program', name=path.stem, sha256=program_digest(path))


def parse_portion(text: str, kind: Literal['program', 'runs']) -> Portion:
    """Read ``NAME=COUNT``.

    Raises:
        UsageError: it is not of that form, or the count is out of range.
    """
    option = 'add' if kind == 'program' else 'add_runs'
    name, equals, number = text.rpartition('=')
    if not (equals and name and number.isdecimal()):
        what = 'PROGRAM' if kind == 'program' else 'CAMPAIGN'
        raise UsageError(f'train: {option} {text!r}: not {what}=COUNT, such as crossing=2400')
    if not 1 <= int(number) <= MAX_PICTURES:
        raise UsageError(f'train: {option} {text!r}: the count is outside 1..{MAX_PICTURES}')
    return Portion(kind=kind, name=name, count=int(number))


def portion_seed(seed: int, number: int) -> int:
    """Seed of a portion's scenes, distinct since the main set may use the same program."""
    drawn = np.random.SeedSequence([seed, _PORTIONS, number]).generate_state(1, np.uint64)
    return int(drawn[0]) >> 1
