"""Aircraft as data: flight-dynamics model, limits and outline, from YAML files and scenarios.

The model is one of JSBSim's, by name, or the user's, by path. Scenarios contain all of its XML
files, so messages, bags and other machines need none.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.core.documents import NamedDocument, canonical, document_name
from taxinet_ros.core.rig.model_files import MODEL_NAME, check_model_files, collect_model_files
from taxinet_ros.core.rig.outline import Part, read_outline
from taxinet_ros.files.plain_values import Section, expected, read_yaml

_OWN_MODELS = Path(__file__).parent / 'models'
_BARE_MODELS = ('caravan', 'c172p')
"""Models used as installed; scenarios contain the files of all others."""
_KEYS = (
    'name', 'title', 'model', 'max_steering_deg', 'taxi_speed_mps', 'most_wind_mps', 'settled',
    'speed_hold', 'outline',
)
USUAL_SPEED_MPS, _SPEEDS_MPS = 5.0, (1.0, 10.0)
"""Default taxi speed of a scenario, and what scenarios may have."""
_SETTLED_KEYS = ('height_m', 'pitch_deg', 'roll_deg')
_HOLD_KEYS = ('lever_per_mps', 'lever_per_m', 'brake_per_lever', 'rolling_lever')
_MODEL_KEYS = ('name', 'files')


@dataclass(frozen=True, kw_only=True, slots=True)
class SpeedGains:
    """Speed-hold gains of one aircraft model.

    Attributes:
        lever_per_mps: proportional gain: power lever, 0..1, per m/s of speed error.
        lever_per_m: integral gain: lever per second and per m/s of speed error.
        brake_per_lever: brake, 0..1, per unit of lever below its stop.
        rolling_lever: lever that holds the taxi speed straight ahead; initial integral.
    """

    lever_per_mps: float
    lever_per_m: float
    brake_per_lever: float
    rolling_lever: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Attitude:
    """Trimmed attitude in straight taxiing at taxi speed.

    A run that starts with it has no vertical or pitch transient. Signs are those of
    :class:`~taxinet_ros.core.types.AircraftState`.

    Attributes:
        z_m: centre of gravity above the ground [m].
        pitch_rad, roll_rad: attitude [rad].
    """

    z_m: float
    pitch_rad: float
    roll_rad: float


@dataclass(frozen=True, kw_only=True)
class AircraftModel(NamedDocument):
    """A flight-dynamics model with its limits and its outline.

    Attributes:
        model: name of the model's folder and of the file in it.
        folder: folder of model folders, None for JSBSim's own.
        files: path and text of each file of the model; empty for the two shipped ones.
        max_steering_rad: largest nose-wheel angle [rad]; None for the model's.
        taxi_speed_mps: lowest and highest speed that it taxis at [m/s].
        most_wind_mps: limit of the wind and three standard deviations of the gusts [m/s].
        settled: trimmed attitude; None if it is to be measured.
        speed_gains: gains of the speed hold; None if they are to be measured.
        outline: convex parts.
    """

    model: str
    folder: Path | None
    files: tuple[tuple[str, str], ...]
    max_steering_rad: float | None
    taxi_speed_mps: tuple[float, float]
    most_wind_mps: float
    settled: Attitude | None
    speed_gains: SpeedGains | None
    outline: tuple[Part, ...]

    @property
    def nose_m(self) -> float:
        """How far the outline reaches ahead of the reference point [m]; NaN without one."""
        return max(
            (float(part.points[:, 0].max()) for part in self.outline if part.shades),
            default=math.nan,
        )


def read_aircraft(path: Path, shipped: bool = False) -> AircraftModel:
    """Read the aircraft of a YAML file, and the files of its model.

    Raises:
        UsageError: an unreadable file, or an invalid value.
    """
    values = read_yaml(path, option='aircraft')
    if isinstance(values, dict) and isinstance(values.get('model'), str):
        top = Section(path, values, _KEYS)
        word = values['model']
        if word not in _BARE_MODELS:
            name, files = collect_model_files(top, _model_path(top, word, path.parent))
            values = {**values, 'model': {'name': name, 'files': files}}
    return make_aircraft(values, path, shipped=shipped)


def make_aircraft(values: object, path: Path, *, shipped: bool = False) -> AircraftModel:
    """Build an aircraft from plain values.

    Args:
        values: content of an aircraft file, with the texts of the model's files.
        path: path of the file, for error messages.
        shipped: whether it is shipped with the package.

    Raises:
        UsageError: an invalid value.
    """
    top = Section(path, values, _KEYS)
    name = document_name(top, 'c172p')
    model, files = _model(top)
    own = not files and (_OWN_MODELS / model).is_dir()
    assert isinstance(values, Mapping)
    return AircraftModel(
        name=name,
        title=top.text('title', name, kind='a title'),
        model=model,
        folder=_OWN_MODELS if own else None,
        files=tuple(sorted(files.items())),
        max_steering_rad=(
            math.radians(top.number('max_steering_deg', 1.0, 80.0))
            if 'max_steering_deg' in top else None
        ),
        taxi_speed_mps=_speeds(top),
        most_wind_mps=top.number('most_wind_mps', 0.1, 60.0, math.inf),
        settled=_settled(top.section('settled', _SETTLED_KEYS)) if 'settled' in top else None,
        speed_gains=_hold(top.section('speed_hold', _HOLD_KEYS)) if 'speed_hold' in top else None,
        outline=read_outline(top) if 'outline' in top else (),
        document=canonical(values),
        shipped=shipped,
    )


def _model_path(top: Section, word: str, beside: Path) -> Path:
    if word.lower().endswith('.xml') or '/' in word:
        return beside / Path(word).expanduser()
    # Not imported: that would slow down commands that only look up an aircraft.
    found = importlib.util.find_spec('jsbsim')
    assert found is not None
    assert found.origin is not None
    folder = Path(found.origin).parent / 'aircraft' / word
    if not MODEL_NAME.fullmatch(word) or not (folder / f'{word}.xml').is_file():
        raise top.wrong(
            f"{word!r:.60} is none of JSBSim's models; for one of your own write its path, as "
            './mine.xml', 'model',
        )
    return folder


def _model(top: Section) -> tuple[str, dict[str, str]]:
    kind = "the name of one of JSBSim's models, or the path of a model's XML file"
    value = top.take('model', kind)
    if isinstance(value, dict):
        section = top.section('model', _MODEL_KEYS)
        files = section.section('files')
        texts = {name: files.text(name, kind='XML') for name in files}
        return check_model_files(section, section.text('name'), texts)
    if value not in _BARE_MODELS:
        raise top.wrong(expected(kind, value), 'model')
    return str(value), {}


def _speeds(top: Section) -> tuple[float, float]:
    low, high = top.numbers('taxi_speed_mps', 2, *_SPEEDS_MPS, _SPEEDS_MPS)
    if not low <= USUAL_SPEED_MPS <= high:
        raise top.wrong(
            f'expected the lowest and the highest, with the usual {USUAL_SPEED_MPS:g} between '
            f'them, got {low:g} and {high:g}', 'taxi_speed_mps',
        )
    return low, high


def _settled(section: Section) -> Attitude:
    return Attitude(
        z_m=section.number('height_m', 0.05, 30.0),
        pitch_rad=math.radians(section.number('pitch_deg', -30.0, 30.0, 0.0)),
        roll_rad=math.radians(section.number('roll_deg', -10.0, 10.0, 0.0)),
    )


def _hold(section: Section) -> SpeedGains:
    return SpeedGains(
        lever_per_mps=section.number('lever_per_mps', 0.0, 100.0),
        lever_per_m=section.number('lever_per_m', 0.0, 100.0),
        brake_per_lever=section.number('brake_per_lever', 0.0, 100.0),
        rolling_lever=section.number('rolling_lever', 0.0, 1.0),
    )
