"""Networks in Stanford's .nnet text format, converted to ONNX.

The format (github.com/sisl/NNet) is a fully connected ReLU network, one line after the other, with
values separated by commas and, as a rule, a comma at the end of a line::

    // comments                          any number of them, first
    layers, inputs, outputs, largest     layers: of weights; largest: of all layer sizes
    inputs, hidden sizes..., outputs
    flag                                 0, or 1 in old files; no longer read by anybody
    minima, then maxima                  a line each with a value per input: inputs are clipped
    means, then ranges                   a line each with a value per input, and one for all outputs
    for each layer: a line per row of weights, then a line per bias

A network's answer is ``range * f((clip(x) - means) / ranges) + mean``, where the last of the means
and ranges are those of the outputs, and f has a ReLU after every layer but the last. What the
inputs and outputs mean is not in the file: :data:`DESCRIPTIONS` has it for the network that is
public, and for any other one writes it (:mod:`taxinet_ros.core.perception.onnx.sidecar`).
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.perception.onnx.network import NetworkFiles, OnnxNetwork
from taxinet_ros.core.perception.onnx.sidecar import (
    MAX_SIDECAR_BYTES,
    parse_sidecar,
    sidecar_path,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.reading import read_file

MAX_NNET_BYTES = 8 << 20
"""Size limit of a file; that of the public TinyTaxiNet has 50 KB, others' have less than 1 MB."""
_MOST_SIDE, _MOST_LAYERS = 65_536, 100
_OPSET, _IR = 17, 8
"""Versions of ONNX that onnxruntime has read since 2022."""
_TRIALS = 64
_TOLERANCE = 1e-4
"""Largest difference between ONNX in 32 bits and the same sums in 64, relative to the answers."""

TINYTAXINET = """\
# What the public TinyTaxiNet sees and says (github.com/sisl/VerifyGAN, models/TinyTaxiNet.nnet).
input:
  layout: flat
  colour: grey
  crop: [55, 5, 360, 135]          # without the nose, the sky and the foot of the picture
  height: 8
  width: 16
  brightest: {block: 16, keep: 16} # of each 16 x 16 square, the mean of its 16 brightest pixels
scaling:
  divide_by: 255
  per_image: centre                # every picture gets the mean 0.5
  mean: [-0.5]
  std: [1]
  clip: [0, 1]
outputs:
  - {quantity: cte, unit: m, positive: left, scale: 1}
  - {quantity: heading_error, unit: deg, positive: left, scale: 1}
"""
DESCRIPTIONS = {'tinytaxinet': TINYTAXINET}
"""Descriptions by the name of a public network."""

Numbers = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Nnet:
    """A network of a .nnet file.

    Attributes:
        sizes: number of inputs, of the neurons of each hidden layer, and of outputs.
        low, high: limits to which inputs are clipped, (inputs,).
        means, ranges: of the inputs, (inputs,).
        output_mean, output_range: of all outputs.
        weights: a matrix for each layer, (neurons, neurons before).
        biases: a vector for each layer, (neurons,).
        sha256: digest of the file.
    """

    sizes: tuple[int, ...]
    low: Numbers
    high: Numbers
    means: Numbers
    ranges: Numbers
    output_mean: float
    output_range: float
    weights: tuple[Numbers, ...]
    biases: tuple[Numbers, ...]
    sha256: str

    @classmethod
    def parse(cls, path: Path, data: bytes) -> Self:
        """Parse a file.

        Args:
            path: its path, for errors.
            data: its content.

        Raises:
            UsageError: the file is damaged or another one; one line on the first error.
        """
        lines = _Lines(path, data)
        layers, inputs, outputs, largest = lines.whole_numbers('header', 4)
        if layers > _MOST_LAYERS:
            raise lines.wrong(f'the header says {layers} layers; at most {_MOST_LAYERS} are read')
        sizes = lines.whole_numbers('layer sizes', layers + 1)
        _check_sizes(lines, sizes, inputs, outputs, largest)
        flag = lines.numbers('flag', 1)[0]
        if flag not in (0, 1):
            raise lines.wrong(f'the flag is {flag:g}, expected 0 or 1; is a line missing?')
        low, high = (lines.numbers(name, inputs) for name in ('minima', 'maxima'))
        if (low > high).any():
            at = int(np.argmax(low > high))
            raise lines.wrong(f'input {at + 1} has its maximum {high[at]:g} below its minimum '
                              f'{low[at]:g}')
        means = lines.numbers('means', inputs + 1)
        ranges = lines.numbers('ranges', inputs + 1)
        if (ranges == 0).any():
            raise lines.wrong(f'range {int(np.argmax(ranges == 0)) + 1} is 0, which divides by 0')
        weights, biases = [], []
        for number, (before, size) in enumerate(pairwise(sizes), 1):
            rows = [lines.numbers(f'weights of layer {number}, row {row}', before)
                    for row in range(1, size + 1)]
            weights.append(np.array(rows))
            biases.append(np.array([
                lines.numbers(f'bias {row} of layer {number}', 1)[0] for row in range(1, size + 1)
            ]))
        lines.check_end()
        return cls(
            sizes=sizes, low=low, high=high, means=means[:-1], ranges=ranges[:-1],
            output_mean=float(means[-1]), output_range=float(ranges[-1]),
            weights=tuple(weights), biases=tuple(biases), sha256=hashlib.sha256(data).hexdigest(),
        )

    def evaluate(self, inputs: Numbers) -> Numbers:
        """Answers (N, outputs) to inputs (N, inputs), in 64 bits."""
        layer = (np.clip(inputs, self.low, self.high) - self.means) / self.ranges
        for number, (weights, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            layer = layer if number == 0 else np.maximum(layer, 0.0)
            layer = layer @ weights.T + bias
        return np.asarray(layer * self.output_range + self.output_mean)

    def to_onnx(self) -> bytes:
        """The same network as an ONNX model in 32 bits: one input (1, inputs), one output."""
        from onnx import TensorProto, helper, numpy_helper

        nodes, constants = [], []

        def add(operator: str, before: str, name: str, **values: Numbers | float) -> str:
            for word, value in values.items():
                array = np.asarray(value, np.float32)
                constants.append(numpy_helper.from_array(array, f'{name}_{word}'))
            words = [before, *(f'{name}_{word}' for word in values)]
            nodes.append(helper.make_node(operator, words, [name]))
            return name

        last = add('Max', 'picture', 'not_below', low=self.low)
        last = add('Min', last, 'clipped', high=self.high)
        last = add('Sub', last, 'centred', mean=self.means)
        last = add('Div', last, 'normalised', range=self.ranges)
        for number, (weights, bias) in enumerate(zip(self.weights, self.biases, strict=True), 1):
            if number > 1:
                last = add('Relu', last, f'positive_{number - 1}')
            last = add('Gemm', last, f'layer_{number}', weights=weights.T, bias=bias)
        last = add('Mul', last, 'scaled', range=self.output_range)
        last = add('Add', last, 'answer', mean=self.output_mean)
        graph = helper.make_graph(
            nodes, 'nnet',
            [helper.make_tensor_value_info('picture', TensorProto.FLOAT, [1, self.sizes[0]])],
            [helper.make_tensor_value_info(last, TensorProto.FLOAT, [1, self.sizes[-1]])],
            constants,
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid('', _OPSET)], ir_version=_IR,
            producer_name='taxinet_ros', doc_string=f'from a .nnet file, SHA-256 {self.sha256}',
        )
        return bytes(model.SerializeToString())


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Converted:
    """A converted network, which has been tried but not been written.

    Attributes:
        nnet: what it was made of.
        files: model and description.
        difference: largest difference from :meth:`Nnet.evaluate`, over random inputs.
    """

    nnet: Nnet
    files: NetworkFiles
    difference: float


def read_nnet(path: Path) -> bytes:
    """Content of a .nnet file.

    Raises:
        UsageError: it is missing, unreadable, or far too large for one.
    """
    try:
        return read_file(path, MAX_NNET_BYTES)
    except OSError as error:
        raise UsageError(f'nnet: {path}: cannot be read ({error.strerror})') from error


def converted(
    path: Path, data: bytes, out: Path, description: bytes, source: Path
) -> Converted:
    """Convert a .nnet file, and try the result.

    Args:
        path: the .nnet file.
        data: its content.
        out: the ONNX file to be, for errors.
        description: content of the description.
        source: where the description is from, for errors.

    Raises:
        UsageError: the file is damaged, or the description is not of this network.
    """
    nnet = Nnet.parse(path, data)
    sidecar = parse_sidecar(source, description)
    shape, answers = sidecar.picture.shape, len(sidecar.outputs)
    if sidecar.picture.layout != 'flat' or shape[1] != nnet.sizes[0]:
        raise UsageError(
            f'nnet: {source}: input is {sidecar.picture.layout} {shape}, but {path} takes '
            f'{nnet.sizes[0]} numbers; write layout: flat, and height x width to match'
        )
    if answers != nnet.sizes[-1]:
        raise UsageError(
            f'nnet: {source}: outputs has {answers} entries, but {path} gives {nnet.sizes[-1]} '
            'numbers; correct the description'
        )
    files = NetworkFiles(path=out, model=nnet.to_onnx(), description=description)
    network = OnnxNetwork(files)
    network.trial()
    return Converted(nnet=nnet, files=files, difference=_difference(path, nnet, network))


def _difference(path: Path, nnet: Nnet, network: OnnxNetwork) -> float:
    """Largest difference between the ONNX model and the file's own sums, over random inputs.

    Raises:
        UsageError: it is more than 32 bits explain.
    """
    reach = nnet.high - nnet.low
    drawn = np.random.default_rng(0).uniform(-0.1, 1.1, (_TRIALS, nnet.sizes[0]))
    inputs = np.asarray(np.clip(nnet.low + drawn * reach, -_MOST, _MOST), np.float32)
    with np.errstate(all='ignore'):  # what is not finite is refused below
        expected = nnet.evaluate(inputs.astype(np.float64))
    found = np.array([network.numbers(row[None]) for row in inputs])
    if not (np.isfinite(found).all() and np.isfinite(expected).all()):
        raise UsageError(
            f'nnet: {path}: its answers are not finite for inputs within its limits, '
            f'{nnet.low.min():g} to {nnet.high.max():g}; correct minima, maxima, ranges or weights'
        )
    worst = float(np.abs(found - expected).max())
    if not worst <= _TOLERANCE * max(1.0, float(np.abs(expected).max())):
        raise UsageError(
            f'nnet: {path}: as ONNX, in 32 bits, its answers differ by up to {worst:.3g}; its '
            'weights need more digits than a network for onnxruntime has'
        )
    return worst


def _check_sizes(
    lines: _Lines, sizes: tuple[int, ...], inputs: int, outputs: int, largest: int
) -> None:
    if max(sizes) > _MOST_SIDE:
        raise lines.wrong(f'a layer has {max(sizes)} neurons; at most {_MOST_SIDE} are read')
    told = {'inputs': (inputs, sizes[0]), 'outputs': (outputs, sizes[-1]),
            'neurons in the largest layer': (largest, max(sizes))}
    for name, (header, found) in told.items():
        if header != found:
            raise lines.wrong(f'the layer sizes have {found} {name}, the header says {header}')


class _Lines:
    """The lines of a file, read one by one."""

    def __init__(self, path: Path, data: bytes) -> None:
        self._path = path
        text = data.decode('latin-1')  # comments may be in any script
        if '\0' in text:
            raise self._error('is not text; a .nnet file is')
        if not text.strip():
            raise self._error('is empty; copy it again')
        if text.startswith('version https://git-lfs'):
            raise self._error('is only a Git LFS pointer; get the file with: git lfs pull')
        if text.lstrip()[:1] == '<':
            raise self._error('is a web page; download the raw file')
        # Not splitlines: a letter of a comment may have a byte that is a line end in latin-1.
        self._lines = re.split('\r\n|\r|\n', text)
        if not self._lines[-1]:
            self._lines.pop()
        self._at = 0
        while self._at < len(self._lines) and self._lines[self._at].startswith('//'):
            self._at += 1

    def wrong(self, what: str) -> UsageError:
        """An error on the line that was read last."""
        return self._error(f'line {self._at}: {what}')

    def whole_numbers(self, name: str, count: int) -> tuple[int, ...]:
        """Whole numbers of at least 1 on the next line."""
        found = self.numbers(name, count)
        for value in found:
            if not (value.is_integer() and value >= 1):
                raise self.wrong(f'{name}: {value:g} is not a whole number of at least 1')
        return tuple(map(int, found))

    def numbers(self, name: str, count: int) -> Numbers:
        """Exactly so many finite numbers on the next line."""
        if self._at >= len(self._lines):
            raise self._error(f'ends after line {self._at}, before its {name}; it is cut off')
        line = self._lines[self._at]
        words = line.strip().removesuffix(',').split(',')
        self._at += 1
        if len(words) != count:
            many = f'{count} number' if count == 1 else f'{count} numbers'
            raise self.wrong(f'{name}: expected {many}, got {len(words)}')
        if _PLAIN.fullmatch(line):  # float() reads the same numbers then, an order faster
            with contextlib.suppress(ValueError):
                values = np.array(list(map(float, words)))
                if (np.abs(values) <= _MOST).all():
                    return values
        return np.array([self._number(name, word.strip()) for word in words])

    def check_end(self) -> None:
        """Refuse anything but blank lines after the last bias."""
        for line in self._lines[self._at:]:
            self._at += 1
            if line.strip():
                raise self.wrong('more numbers than the layer sizes say; is it two files in one?')

    def _number(self, name: str, word: str) -> float:
        if not _NUMBER.fullmatch(word):
            raise self.wrong(f'{name}: expected a number, got {word[:20]!r}')
        value = float(word)
        if not abs(value) <= _MOST:
            raise self.wrong(f'{name}: {word[:20]} is beyond the range of 32 bits')
        return value

    def _error(self, what: str) -> UsageError:
        return UsageError(f'nnet: {self._path}: {what}')


_MOST = float(np.finfo(np.float32).max)
_PLAIN = re.compile(r'[-+0-9.eE, \t]*')
_NUMBER = re.compile(r'[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?')
"""Python also reads ``1_0``, ``nan`` and ``infinity``."""


def description_of(word: str) -> tuple[bytes, Path]:
    """A description by the name of a public network, or of a file; and where it is from.

    Raises:
        UsageError: there is neither.
    """
    if word in DESCRIPTIONS:
        return DESCRIPTIONS[word].encode(), Path(word)
    path = Path(word)
    try:
        return read_file(path, MAX_SIDECAR_BYTES), path
    except OSError as error:
        raise UsageError(
            f'description {word}: neither {", ".join(DESCRIPTIONS)} nor a readable file '
            f'({error.strerror})'
        ) from error


def write_converted(found: Converted) -> None:
    """Write model and description, the description first: a model without one is refused.

    Raises:
        OSError: one cannot be written.
    """
    write_atomically(sidecar_path(found.files.path), found.files.description)
    write_atomically(found.files.path, found.files.model)
