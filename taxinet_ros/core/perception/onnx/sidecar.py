"""Description of a third-party network: ``NAME.yaml`` next to ``NAME.onnx``.

An ONNX file does not define the meaning of its inputs and outputs; the description does, in YAML
(or JSON). Parsing is strict; every error is one line with file, key and correction. The keys, those
in brackets optional::

    input:                     the network's single input, made from a camera frame
      [name]                   name of the input, as a check
      layout                   nchw, nhwc, or flat: (1, height x width), row by row, grey only
      colour                   rgb, bgr or grey
      [view]                   virtual camera that it sees through, as in
                               :mod:`taxinet_ros.core.perception.eye`: grey, 64 high, 192 wide,
                               without crop, resize and brightest; by default it sees the frame
      [crop]                   [left, top, right, bottom] pixels of the 360 x 200 frame to keep
      height, width            size of the network's input image
      [resize]                 area (default), linear, cubic or nearest
      [brightest]              {block, keep}: resize to block times height and width, then replace
                               each block x block square by the mean of its keep brightest pixels
    scaling:                   from grey levels 0..255 to the network's input, in this order
      divide_by                1 if the network takes grey levels
      [per_image]              none (default), centre: subtract the image's mean, or standardise:
                               also divide by its deviation, at least one grey level
      [mean, std]              both or none, a list with a number per channel: (x - mean) / std
      [clip]                   [lowest, highest]
    outputs:                   a list with one entry per output number, in order
      - quantity               cte, heading_error (one of each), or ignore (without further keys)
        unit                   m; deg or rad
        positive               left or right: position of the aircraft, or direction of its nose,
                               at positive values
        scale                  value = scale x output + offset, in that unit
        [offset]               0 by default
    [domain]                   what it was trained in, as in a card
                               (:mod:`taxinet_ros.core.perception.domain`)

Anything else is rejected, because a wrong input image would not cause an error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.core.perception.domain import Domain, read_domain
from taxinet_ros.core.perception.eye import VIEWS
from taxinet_ros.core.perception.network import IMAGE_SHAPE, INPUT_SHAPE
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, expected, parse_yaml

_ABOUT = 'onnx: '


def file_error(path: Path, what: str) -> UsageError:
    """An error about a file of an ONNX network."""
    return UsageError(f'{_ABOUT}{path}: {what}')


CHANNELS = {'rgb': 3, 'bgr': 3, 'grey': 1}
LAYOUTS = ('nchw', 'nhwc', 'flat')
RESIZES = ('area', 'linear', 'cubic', 'nearest')
PER_IMAGE = ('none', 'centre', 'standardise')
QUANTITIES = ('cte', 'heading_error', 'ignore')
MAX_SIDE = 4096
"""Maximum side length of a resized frame [pixels]."""
MAX_SIDECAR_BYTES = 16 << 10
UNITS = {'cte': {'m': 1.0}, 'heading_error': {'deg': math.radians(1.0), 'rad': 1.0}}
"""Units of what the steering needs, in SI units, by quantity."""
_SIGNS = {'left': 1.0, 'right': -1.0}
_LEAST, _MOST = 1e-6, 1e6


@dataclass(frozen=True, kw_only=True, slots=True)
class Brightest:
    """Each square of ``block`` x ``block`` pixels becomes the mean of its ``keep`` brightest."""

    block: int
    keep: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Picture:
    """How the network's input image is made from a camera frame.

    Attributes:
        name: name of the model's input; None if not given.
        layout: one of :data:`LAYOUTS`.
        colour: key of :data:`CHANNELS`.
        crop: left, top, right and bottom [pixels], right and bottom excluded.
        height, width: size of the image [pixels].
        resize: one of :data:`RESIZES`.
        brightest: reduction after resizing, or None.
        view: virtual camera that it sees through, or None.
    """

    name: str | None
    layout: str
    colour: str
    crop: tuple[int, int, int, int]
    height: int
    width: int
    resize: str
    brightest: Brightest | None
    view: str | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the model's input with a batch of one."""
        channels = CHANNELS[self.colour]
        return {
            'nchw': (1, channels, self.height, self.width),
            'nhwc': (1, self.height, self.width, channels),
            'flat': (1, self.height * self.width),
        }[self.layout]


@dataclass(frozen=True, kw_only=True, slots=True)
class Scaling:
    """Scaling of the grey levels, applied in the order of the attributes; see the module."""

    divide_by: float
    per_image: str
    mean: tuple[float, ...]
    std: tuple[float, ...]
    clip: tuple[float, float] | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Output:
    """One output number: ``scale * number + offset`` is in m or rad, left positive."""

    quantity: str
    scale: float = 0.0
    offset: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Sidecar:
    """A checked description."""

    picture: Picture
    scaling: Scaling
    outputs: tuple[Output, ...]
    domain: Domain | None = None


def sidecar_path(path: Path) -> Path:
    """Path of the description of an ONNX file."""
    return path.with_suffix('.yaml')


def parse_sidecar(path: Path, data: bytes) -> Sidecar:
    """Parse a description.

    Args:
        path: its file.
        data: content of the file.

    Raises:
        UsageError: an invalid description; one line with file, key and correction.
    """
    content = parse_yaml(path, data, about=_ABOUT)
    top = Section(path, content, ('input', 'scaling', 'outputs', 'domain'), about=_ABOUT)
    picture = _picture(top.section('input', (
        'name', 'layout', 'colour', 'view', 'crop', 'height', 'width', 'resize', 'brightest')))
    scaling = _scaling(
        top.section('scaling', ('divide_by', 'per_image', 'mean', 'std', 'clip')),
        CHANNELS[picture.colour],
    )
    return Sidecar(
        picture=picture, scaling=scaling, outputs=_outputs(top), domain=read_domain(top),
    )


def _picture(section: Section) -> Picture:
    brightest = None
    if 'brightest' in section:
        reduction = section.section('brightest', ('block', 'keep'))
        block = reduction.whole('block', 1, 64)
        brightest = Brightest(block=block, keep=reduction.whole('keep', 1, block * block))
    most = MAX_SIDE // (brightest.block if brightest else 1)
    picture = Picture(
        name=section.text('name', kind='text') if 'name' in section else None,
        layout=section.word('layout', LAYOUTS),
        colour=section.word('colour', tuple(CHANNELS)),
        crop=_crop(section),
        height=section.whole('height', 1, most),
        width=section.whole('width', 1, most),
        resize=section.word('resize', RESIZES, 'area'),
        brightest=brightest,
        view=section.word('view', tuple(VIEWS)) if 'view' in section else None,
    )
    if picture.view is not None:
        _check_view(section, picture)
    if picture.layout == 'flat' and picture.colour != 'grey':
        raise section.wrong('is flat, which is only for grey images; write nchw or nhwc', 'layout')
    return picture


def _check_view(section: Section, picture: Picture) -> None:
    height, width = INPUT_SHAPE
    for key in ('crop', 'resize', 'brightest'):
        if key in section:
            raise section.wrong('has no effect with a view, whose picture is taken whole', key)
    if (picture.colour, picture.height, picture.width) != ('grey', height, width):
        raise section.wrong(
            f'is {picture.colour}, {picture.height} x {picture.width}; the picture of a view is '
            f'grey, {height} x {width}', 'view',
        )


def _crop(section: Section) -> tuple[int, int, int, int]:
    height, width, _ = IMAGE_SHAPE
    edges = section.numbers('crop', 4, 0, width, (0.0, 0.0, float(width), float(height)))
    left, top, right, bottom = map(int, edges)
    whole = all(edge.is_integer() for edge in edges)
    if not (whole and left < right and top < bottom <= height):
        kind = (
            f'[left, top, right, bottom] in whole pixels with left < right <= {width} and '
            f'top < bottom <= {height}'
        )
        raise section.wrong(expected(kind, list(edges)), 'crop')
    return left, top, right, bottom


def _scaling(section: Section, channels: int) -> Scaling:
    mean, std = (0.0,) * channels, (1.0,) * channels
    if 'mean' in section or 'std' in section:
        mean = section.numbers('mean', channels, -_MOST, _MOST)
        std = section.numbers('std', channels, _LEAST, _MOST)
    clip = None
    if 'clip' in section:
        lowest, highest = section.numbers('clip', 2, -_MOST, _MOST)
        if lowest >= highest:
            raise section.wrong('has its lowest value not below its highest; swap them', 'clip')
        clip = lowest, highest
    return Scaling(
        divide_by=section.number('divide_by', _LEAST, _MOST),
        per_image=section.word('per_image', PER_IMAGE, 'none'),
        mean=mean, std=std, clip=clip,
    )


def _outputs(top: Section) -> tuple[Output, ...]:
    entries = top.sections('outputs', ('quantity', 'unit', 'positive', 'scale', 'offset'))
    outputs = tuple(map(_output, entries))
    quantities = [output.quantity for output in outputs]
    for quantity in UNITS:
        if quantities.count(quantity) != 1:
            raise top.wrong(f'has {quantities.count(quantity)} entries with quantity {quantity}; '
                            'the steering needs one, write ignore for others', 'outputs')
    return outputs


def _output(entry: Section) -> Output:
    quantity = entry.word('quantity', QUANTITIES)
    if quantity == 'ignore':
        for key in ('unit', 'positive', 'scale', 'offset'):
            if key in entry:
                raise entry.wrong('has no meaning for an ignored output; leave it out', key)
        return Output(quantity=quantity)
    unit = UNITS[quantity][entry.word('unit', tuple(UNITS[quantity]))]
    sign = _SIGNS[entry.word('positive', tuple(_SIGNS))]
    scale = entry.number('scale', -_MOST, _MOST)
    if abs(scale) < _LEAST:
        raise entry.wrong('makes the output constant; write the value at an output of 1',
                          'scale')
    offset = entry.number('offset', -_MOST, _MOST, 0.0)
    return Output(quantity=quantity, scale=scale * unit * sign, offset=offset * unit * sign)
