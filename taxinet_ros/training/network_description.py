"""Write the description of an ONNX network as far as its file and its answers tell.

The file has the shape of its input. What goes in and what comes out is found by asking: the network
sees labelled pictures, prepared in each usual way, and a line is fitted from each of its outputs to
each truth. The way that explains both truths best is taken if it explains them well; a network that
was trained for something else, or prepared in another way, is not described.
"""

from __future__ import annotations

import itertools
import math
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from taxinet_ros.core.perception.eye import VIEWS, find_eye
from taxinet_ros.core.perception.network import INPUT_SHAPE, usual_frame
from taxinet_ros.core.perception.onnx.network import NetworkFiles, OnnxNetwork, prepare
from taxinet_ros.core.perception.onnx.sidecar import CHANNELS, UNITS, file_error, sidecar_path
from taxinet_ros.core.perception.onnx.trial import tried_network
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError
from taxinet_ros.training.data.photographs import photograph

LEAST_EXPLAINED = 0.6
"""Share of the variance of each truth that an output has to explain."""
_IMAGENET = {'mean': [0.485, 0.456, 0.406], 'std': [0.229, 0.224, 0.225]}
_SNAP = 0.08
"""A fitted factor this near to a usual one is that one: no network is without error."""
_USUAL = (1.0, 2.0, 5.0, 8.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 90.0, 100.0, 180.0)
_NEGLIGIBLE = 0.1
"""An offset below this share of the truth's deviation is left out."""
_DOMAIN_HINT = """\
# What it was trained in, so that runs elsewhere say so; correct this, and uncomment it:
# domain: {place: [kmwh_04], time_of_day_h: [8.5, 12], rain_percent: [0, 0]}
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class Fit:
    """What an output of a network is.

    Attributes:
        output: its number, from 0.
        quantity: ``cte`` or ``heading_error``.
        factor, offset: of the line from the output to the truth [m or rad].
        explained: share of the truth's variance.
        aside: size of the offset, relative to the truth's deviation.
    """

    output: int
    quantity: str
    factor: float
    offset: float
    explained: float
    aside: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Way:
    """A way to prepare pictures, with what the outputs then are.

    Attributes:
        prepared: sections ``input`` and ``scaling`` of the description.
        fits: of cross-track and heading error.
    """

    prepared: Mapping[str, Any]
    fits: tuple[Fit, ...]

    @property
    def explained(self) -> float:
        """The smaller share of the two."""
        return min(fit.explained for fit in self.fits)

    def words(self) -> str:
        """Display text."""
        picture, scaling = self.prepared['input'], self.prepared['scaling']
        view = f'view {picture["view"]}' if 'view' in picture else ''
        parts = [picture['colour'], view, *(f'{key} {value}' for key, value in scaling.items())]
        shares = ', '.join(
            f'output {fit.output + 1} explains {100 * fit.explained:.0f} % of {fit.quantity}'
            for fit in self.fits
        )
        return f'{", ".join(filter(None, parts))}: {shares}'


class Shapes(NamedTuple):
    """What the file of a network says.

    Attributes:
        picture: shape of the input without the batch; 0 is a side of any length.
        outputs: number of output numbers.
    """

    picture: tuple[int, ...]
    outputs: int


def find_ways(path: Path, shapes: Shapes, scenes: Sequence[Scenario]) -> list[Way]:
    """The ways in which a network can be fed, best first.

    Args:
        path: ``NAME.onnx``.
        shapes: its shapes.
        scenes: scenes whose first frames it sees.

    Raises:
        UsageError: its input is no picture, or it cannot be used.
    """
    taken = [photograph(scene) for scene in scenes]
    truth = np.array([(label.cte_m, label.he_rad) for _, label in taken])
    frames = [usual_frame(frame) for frame, _ in taken]
    found: list[Way] = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        shutil.copyfile(path, copy)
        for number, prepared in enumerate(_prepared(path, shapes.picture)):
            content = {**prepared, 'outputs': _unknown(shapes.outputs)}
            sidecar_path(copy).write_text(yaml.safe_dump(content), encoding='utf-8')
            if number == 0:
                _try(path, copy)
            network = OnnxNetwork(NetworkFiles.read(copy))
            view = network.sidecar.picture.view
            seen = frames if view is None else [
                find_eye(view, scene.rig).see(frame)
                for scene, (frame, _) in zip(scenes, taken, strict=True)
            ]
            answers = np.array([
                network.numbers(prepare(one, network.sidecar)) for one in seen])
            found.append(Way(prepared=prepared, fits=_fits(answers, truth)))
    # Ways that explain as much differ by a line in the network's own numbers; the right one has
    # hardly an offset.
    return sorted(found, key=lambda way: (
        -round(way.explained, 2), sum(fit.aside for fit in way.fits)))


def description(way: Way, outputs: int, about: str) -> str:
    """Content of the description file.

    Args:
        way: how the network is fed, and what its outputs are.
        outputs: number of its outputs.
        about: first line, a comment.
    """
    entries = _unknown(outputs, way.fits)
    content = {**way.prepared, 'outputs': entries}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    return f'# {about}\n{text}{_DOMAIN_HINT}'


def read_shapes(path: Path) -> Shapes:
    """Read the shapes of a network.

    Raises:
        UsageError: the file is no ONNX model, or its outputs have no shape.
    """
    import onnx

    try:
        model = onnx.shape_inference.infer_shapes(
            onnx.load(path, load_external_data=False))
    except OSError as error:
        raise file_error(path, f'cannot be read ({error.strerror})') from error
    except Exception as error:  # of protobuf and onnx, which have no common class
        raise file_error(path, f'is no ONNX model ({str(error).splitlines()[0]:.60})') from error
    weights = {one.name for one in model.graph.initializer}
    inputs = [one for one in model.graph.input if one.name not in weights]
    if len(inputs) != 1:
        raise file_error(path, f'has {len(inputs)} inputs; a network that sees has one')
    sides = [dim.dim_value for dim in inputs[0].type.tensor_type.shape.dim][1:]
    numbers = 0
    for one in model.graph.output:
        dims = [dim.dim_value for dim in one.type.tensor_type.shape.dim]
        if not dims or 0 in dims[1:]:
            raise file_error(
                path, f'output {one.name} has no shape; write {sidecar_path(path).name} yourself')
        numbers += math.prod(dims[1:])
    if numbers < len(UNITS):
        raise file_error(path, f'has {numbers} output numbers; the steering needs two')
    return Shapes(tuple(sides), numbers)


def _prepared(path: Path, shape: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    """Sections ``input`` and ``scaling`` of all ways to be tried."""
    if len(shape) != 3 or 0 in shape or not {shape[0], shape[2]} & {1, 3}:
        raise file_error(
            path, f'input {shape} is no picture of one or three channels; write '
            f'{sidecar_path(path).name} yourself')
    layout = 'nchw' if shape[0] in (1, 3) else 'nhwc'
    channels, height, width = shape if layout == 'nchw' else (shape[2], *shape[:2])
    picture = {'layout': layout, 'height': height, 'width': width}
    colours = [word for word, count in CHANNELS.items() if count == channels]
    views: list[dict[str, str]] = [{}]
    if (channels, height, width) == (1, *INPUT_SHAPE):
        views += [{'view': view} for view in VIEWS]
    scalings: list[dict[str, Any]] = [
        {'divide_by': 255}, {'divide_by': 1}, {'divide_by': 127.5, 'mean': [1.0], 'std': [1.0]},
        {'divide_by': 255, 'per_image': 'centre'}, {'divide_by': 1, 'per_image': 'standardise'},
    ]
    scalings += [{'divide_by': 255, **_IMAGENET}] if channels == 3 else []
    for colour, view, scaling in itertools.product(colours, views, scalings):
        if len(scaling.get('mean', ())) == 1:
            scaling = {**scaling, 'mean': [1.0] * channels, 'std': [1.0] * channels}
        yield {'input': {**picture, 'colour': colour, **view}, 'scaling': scaling}


def _try(path: Path, copy: Path) -> None:
    try:
        tried_network(copy)
    except UsageError as error:
        raise UsageError(str(error).replace(str(copy.parent), str(path.parent))) from None


def _unknown(outputs: int, fits: Sequence[Fit] = ()) -> list[dict[str, Any]]:
    """Entries of the outputs; of those without a fit some that can be read."""
    known = {fit.output: _entry(fit) for fit in fits}
    missing = [key for key in UNITS if key not in {fit.quantity for fit in fits}]
    for key in missing:
        free = next(number for number in range(outputs) if number not in known)
        known[free] = {
            'quantity': key, 'unit': next(iter(UNITS[key])), 'positive': 'left', 'scale': 1.0}
    return [known.get(number, {'quantity': 'ignore'}) for number in range(outputs)]


def _entry(fit: Fit) -> dict[str, Any]:
    """A fit in the unit whose factor is a usual one, else in the first."""
    units = UNITS[fit.quantity]
    unit, factor = next(
        ((unit, _snapped(abs(fit.factor) / size)) for unit, size in units.items()
         if _snapped(abs(fit.factor) / size) in _USUAL),
        (next(iter(units)), _snapped(abs(fit.factor) / next(iter(units.values())))),
    )
    entry = {
        'quantity': fit.quantity, 'unit': unit, 'positive': 'left' if fit.factor > 0 else 'right',
        'scale': factor,
    }
    if fit.aside >= _NEGLIGIBLE:
        # Of a value that is positive to the right, so is the offset.
        offset = math.copysign(1.0, fit.factor) * fit.offset / units[unit]
        entry['offset'] = float(f'{offset:.3g}')
    return entry


def _snapped(factor: float) -> float:
    usual = min(_USUAL, key=lambda one: abs(math.log(one / factor)))
    return usual if abs(factor / usual - 1) <= _SNAP else float(f'{factor:.3g}')


def _fits(answers: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[Fit, ...]:
    """The pair of different outputs that explains the truths best."""
    table = [
        [_fit(output, quantity, answers[:, output], truth[:, column])
         for column, quantity in enumerate(UNITS)]
        for output in range(answers.shape[1])
    ]
    pairs = itertools.permutations(range(len(table)), 2)
    return max(
        ((table[one][0], table[other][1]) for one, other in pairs),
        key=lambda pair: min(fit.explained for fit in pair),
    )


def _fit(
    output: int, quantity: str, answers: NDArray[np.float64], truth: NDArray[np.float64]
) -> Fit:
    if not np.isfinite(answers).all() or np.ptp(answers) < 1e-12:
        return Fit(output=output, quantity=quantity, factor=1.0, offset=0.0, explained=0.0,
                   aside=math.inf)
    factor, offset = np.polyfit(answers, truth, 1)
    left = truth - factor * answers - offset
    explained = max(0.0, 1 - float(left.var() / truth.var()))
    return Fit(
        output=output, quantity=quantity, factor=float(factor) or 1.0, offset=float(offset),
        explained=explained, aside=abs(float(offset)) / float(truth.std()),
    )
