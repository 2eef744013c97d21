"""From a camera frame to the array that a third party's network takes, as its sidecar says.

A third party's network in an ONNX file, run by onnxruntime as its sidecar says.

The file comes from elsewhere, so it is tried before anything relies on it, in a process that may
be lost: see :mod:`taxinet_ros.core.perception.onnx.trial`. Nothing but the two files is read: a
model whose weights lie in further files is refused.

onnxruntime is imported by the function that needs it, so that nobody else waits for it.
"""

from __future__ import annotations

import hashlib
import math
import reprlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.perception.network import IMAGE_SHAPE, open_session, usual_frame
from taxinet_ros.core.perception.onnx.sidecar import (
    MAX_SIDECAR_BYTES,
    Brightest,
    Picture,
    Scaling,
    Sidecar,
    file_error,
    parse_sidecar,
    sidecar_path,
)
from taxinet_ros.errors import UsageError

_COLOURS = {'bgr': cv2.COLOR_RGB2BGR, 'grey': cv2.COLOR_RGB2GRAY}
_RESIZES = {
    'area': cv2.INTER_AREA,
    'linear': cv2.INTER_LINEAR,
    'cubic': cv2.INTER_CUBIC,
    'nearest': cv2.INTER_NEAREST,
}


def prepare(image: NDArray[np.uint8], sidecar: Sidecar) -> NDArray[np.float32]:
    """The network's input of a camera frame, (height, width, 3) uint8 RGB.

    Returns:
        Array of the shape ``sidecar.picture.shape``.
    """
    levels = _scaled(_cut_out(image, sidecar.picture), sidecar.scaling)
    if sidecar.picture.layout == 'nchw':
        levels = levels.transpose(2, 0, 1)
    return np.ascontiguousarray(levels).reshape(sidecar.picture.shape)


def _cut_out(image: NDArray[np.uint8], wanted: Picture) -> NDArray[np.float32]:
    """Colour, crop, resize in whole grey levels, reduce; (height, width, channels)."""
    picture = np.ascontiguousarray(usual_frame(image))
    if wanted.colour in _COLOURS:
        picture = np.asarray(cv2.cvtColor(picture, _COLOURS[wanted.colour]), np.uint8)
    left, top, right, bottom = wanted.crop
    block = wanted.brightest.block if wanted.brightest else 1
    resized = cv2.resize(
        picture[top:bottom, left:right],
        (wanted.width * block, wanted.height * block),
        interpolation=_RESIZES[wanted.resize],
    )
    levels = np.asarray(resized, np.float32).reshape(*resized.shape[:2], -1)
    return _brightest(levels, wanted.brightest) if wanted.brightest else levels


def _brightest(levels: NDArray[np.float32], reduction: Brightest) -> NDArray[np.float32]:
    """The reduction of the published TinyTaxiNet, which keeps thin bright lines."""
    block = reduction.block
    height, width, channels = levels.shape
    tiles = levels.reshape(height // block, block, width // block, block, channels)
    tiles = tiles.transpose(0, 2, 4, 1, 3)
    tiles = tiles.reshape(*tiles.shape[:3], block * block)
    kept = np.partition(tiles, -reduction.keep, axis=-1)[..., -reduction.keep:]
    return np.asarray(kept.mean(axis=-1), np.float32)


def _scaled(levels: NDArray[np.float32], scaling: Scaling) -> NDArray[np.float32]:
    """Every step of the scaling, in its order."""
    levels = levels / np.float32(scaling.divide_by)
    if scaling.per_image != 'none':
        levels -= levels.mean()
    if scaling.per_image == 'standardise':
        levels /= np.maximum(levels.std(), np.float32(1 / scaling.divide_by))
    levels -= np.asarray(scaling.mean, np.float32)
    levels /= np.asarray(scaling.std, np.float32)
    return levels if scaling.clip is None else np.asarray(levels.clip(*scaling.clip), np.float32)


ONNX_SUFFIX = '.onnx'
MAX_BYTES = 256 << 20
"""Largest model that is read."""
MEMORY_BYTES = 2 << 30
"""Address space of the process that tries a network; Python and the runtime take a quarter."""
_DTYPES: dict[str, type[np.floating[Any]]] = {
    'tensor(float)': np.float32, 'tensor(double)': np.float64, 'tensor(float16)': np.float16,
}


def trial_frames() -> dict[str, NDArray[np.uint8]]:
    """What a network is tried on: camera frames, by what they are called in a complaint."""
    noise = np.random.default_rng(0).integers(0, 256, IMAGE_SHAPE, np.uint8)
    plain = {'grey': 128, 'dark': 0, 'bright': 255}
    return {name: np.full(IMAGE_SHAPE, level, np.uint8) for name, level in plain.items()} | {
        'noisy': noise,
    }


@dataclass(frozen=True, kw_only=True, slots=True)
class NetworkFiles:
    """A network as it was read, so that what is tried and what is used are the same bytes.

    Attributes:
        path: of the model, ``NAME.onnx``.
        model: its bytes.
        description: those of ``NAME.yaml``.
    """

    path: Path
    model: bytes
    description: bytes

    @classmethod
    def read(cls, path: Path) -> Self:
        """The two files of a network.

        Raises:
            UsageError: one is not there, cannot be read, or is too large.
        """
        return cls(
            path=path, model=_read(path, MAX_BYTES),
            description=_read(sidecar_path(path), MAX_SIDECAR_BYTES),
        )

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the model's bytes with the description's after them."""
        return hashlib.sha256(self.model + self.description).hexdigest()


class OnnxNetwork:
    """A network ready to look.

    It runs on one thread of the processor: on one machine the same frame gives the same answer to
    the bit, in any process.
    """

    def __init__(self, files: NetworkFiles) -> None:
        """Open the model and see that the two files agree.

        Opening runs part of the model, for onnxruntime computes what is constant in it; so it
        takes what time and memory the model wants.

        Raises:
            UsageError: one line on the first thing that is wrong.
        """
        path = self._path = files.path
        self._sidecar = parse_sidecar(sidecar_path(path), files.description)
        self._model = _open(path, files.model)
        self._name, self._dtype = self._input()
        for output in self._model.outputs:
            if output.kind not in _DTYPES:
                raise file_error(path, f'output {output} is {output.kind}; export the network with '
                                'outputs of floating point')

    def look(self, image: NDArray[np.uint8]) -> tuple[float, float]:
        """Cross-track [m] and heading error [rad] seen on a camera frame (200, 360, 3) uint8.

        Not finite where the network's answer is not, or where it fails.
        """
        try:
            return self._meaning(self._run(image))
        except Exception:  # onnxruntime's have no other base, and a run must not end for one
            return math.nan, math.nan

    def _input(self) -> tuple[str, type[np.floating[Any]]]:
        """Name and number type of the model's input, once it is as the sidecar says."""
        if len(self._model.inputs) != 1:
            raise file_error(
                self._path, f'has {len(self._model.inputs)} inputs; a network that sees has one'
            )
        given, wanted = self._model.inputs[0], self._sidecar.picture
        if wanted.name not in (None, given.name):
            raise self._disagrees(f'input.name is {reprlib.repr(wanted.name)}',
                                  f"the model's input is {given}")
        if given.kind not in _DTYPES:
            raise file_error(
                self._path,
                f'input {given} is {given.kind}; export the network with an '
                'input of floating point',
            )
        fits = len(given.shape) == len(wanted.shape) and all(
            side in (None, asked) for side, asked in zip(given.shape, wanted.shape, strict=True)
        )
        if not fits:
            sides = ', '.join('?' if side is None else str(side) for side in given.shape)
            raise self._disagrees(f'layout, colour, height and width say {wanted.shape}',
                                  f"the model's input {given} is ({sides[:80]})")
        return given.name, _DTYPES[given.kind]

    def trial(self) -> bytes:
        """Look at each of :func:`trial_frames`; every number that came out, to be compared.

        Raises:
            UsageError: it needs too much memory; or it fails on the grey frame, or does not answer
                it as described. Where it fails on others, it has no answer there in a run, either.
        """
        return b'\n'.join(self._tried(*named) for named in trial_frames().items())

    def _tried(self, name: str, frame: NDArray[np.uint8]) -> bytes:
        try:
            numbers = self._run(frame)
        except Exception as error:  # onnxruntime's have no other base
            if short_of_memory(error):
                raise too_large(self._path) from None
            if name != 'grey':
                return b'none'
            raise file_error(self._path, f'fails on a grey frame ({_reason(error)}); try it with '
                                  'onnxruntime alone, and export it again') from None
        if name == 'grey':
            self._check(numbers)
        return numbers.tobytes()

    def _check(self, numbers: NDArray[np.float64]) -> None:
        """See that these numbers are as many as are described, and finite."""
        entries = len(self._sidecar.outputs)
        if len(numbers) != entries:
            raise self._disagrees(f'outputs has {entries} entries',
                                  f'the model gives {len(numbers)} numbers')
        if not all(map(math.isfinite, self._meaning(numbers))):
            raise file_error(
                self._path,
                'answers a grey frame with numbers that are not finite; look at '
                'its weights, and at the scaling in the description',
            )

    def _run(self, image: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Every number that comes out, in order."""
        with np.errstate(over='ignore', invalid='ignore'):
            inputs = prepare(image, self._sidecar).astype(self._dtype)
        arrays = self._model.session.run(None, {self._name: inputs})
        return np.concatenate([np.asarray(array, np.float64).ravel() for array in arrays])

    def _meaning(self, numbers: NDArray[np.float64]) -> tuple[float, float]:
        """Cross-track [m] and heading error [rad] among the numbers."""
        outputs = zip(self._sidecar.outputs, numbers.tolist(), strict=True)
        values = {
            output.quantity: output.scale * number + output.offset for output, number in outputs
        }
        return values['cte'], values['heading_error']

    def _disagrees(self, description: str, model: str) -> UsageError:
        return file_error(
            sidecar_path(self._path), f'{description}, but {model}; correct the description'
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Tensor:
    """What goes in or out of a model; None in its shape is a side of any length."""

    name: str
    kind: str
    shape: tuple[int | None, ...]

    @classmethod
    def all_of(cls, tensors: Iterable[Any]) -> tuple[Self, ...]:
        return tuple(
            cls(
                name=tensor.name, kind=tensor.type,
                shape=tuple(side if isinstance(side, int) else None for side in tensor.shape),
            )
            for tensor in tensors
        )

    def __str__(self) -> str:
        return reprlib.repr(self.name)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Model:
    """onnxruntime's session with a model."""

    session: Any
    inputs: tuple[_Tensor, ...]
    outputs: tuple[_Tensor, ...]


def _open(path: Path, data: bytes) -> _Model:
    import onnxruntime

    try:
        session = open_session(data)
        return _Model(
            session=session,
            inputs=_Tensor.all_of(session.get_inputs()),
            outputs=_Tensor.all_of(session.get_outputs()),
        )
    except Exception as error:  # onnxruntime's have no other base
        if 'external data' in str(error).lower():
            raise file_error(
                path, 'keeps weights in further files, which are not read; export it in one file'
            ) from None
        if short_of_memory(error):
            raise too_large(path) from None
        raise file_error(path, f'is not a model that onnxruntime {onnxruntime.__version__} can run '
                        f'({_reason(error)}); copy or export it again') from None


def _read(path: Path, most: int) -> bytes:
    try:
        if not path.exists():
            beside = '' if path.suffix == ONNX_SUFFIX else (
                '; an ONNX network needs its description beside it, see docs/onnx.md')
            raise file_error(path, f'no such file{beside}')
        if not path.is_file():
            raise file_error(path, 'is not a file; name the file itself')
        if path.stat().st_size > most:
            raise file_error(path, f'has more than {most >> 10} KiB; is it the right file?')
        data = path.read_bytes()
    except OSError as error:
        raise file_error(path, f'cannot be read ({error.strerror})') from error
    if not data:
        raise file_error(path, 'is empty; copy it again')
    if data.startswith(b'version https://git-lfs'):
        raise file_error(
            path, 'is only a Git LFS pointer; get the file with: git lfs pull'
        )
    return data


def short_of_memory(error: Exception) -> bool:
    """Whether an error, be it onnxruntime's, says that there was no more memory."""
    return isinstance(error, MemoryError) or 'alloc' in str(error).lower()


def too_large(path: Path) -> UsageError:
    """An error about a network that needs too much memory."""
    return file_error(
        path,
        f'needs more memory than allowed for a network, {MEMORY_BYTES >> 30} GiB; make it smaller',
    )


def _reason(error: Exception) -> str:
    """What onnxruntime says, in one line, without its code numbers."""
    return ' '.join(str(error).split()).rpartition(' : ')[2][:160]
