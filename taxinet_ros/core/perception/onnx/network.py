"""Third-party network in an ONNX file: input preparation and inference as its sidecar describes.

The file is untrusted, so it is first tried in a separate process: see
:mod:`taxinet_ros.core.perception.onnx.trial`. Only the model and its sidecar are read; a model with
external weight files is rejected. onnxruntime is imported lazily.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import reprlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.perception.network import IMAGE_SHAPE, shrink, usual_frame
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
from taxinet_ros.files.reading import UnfitFileError, read_file

_COLOURS = {'bgr': cv2.COLOR_RGB2BGR, 'grey': cv2.COLOR_RGB2GRAY}
_RESIZES = {
    'area': cv2.INTER_AREA,
    'linear': cv2.INTER_LINEAR,
    'cubic': cv2.INTER_CUBIC,
    'nearest': cv2.INTER_NEAREST,
}

_FATAL = 4
"""Highest log severity level of onnxruntime; errors are raised as exceptions."""

def prepare(image: NDArray[np.uint8], sidecar: Sidecar) -> NDArray[np.float32]:
    """Convert a camera frame, (height, width, 3) uint8 RGB, to the network's input.

    For a network with a view: the picture of its eye, (64, 192) uint8.

    Returns:
        Array of the shape ``sidecar.picture.shape``.
    """
    levels = _scaled(_cut_out(image, sidecar.picture), sidecar.scaling)
    if sidecar.picture.layout == 'nchw':
        levels = levels.transpose(2, 0, 1)
    return np.ascontiguousarray(levels).reshape(sidecar.picture.shape)


def _cut_out(image: NDArray[np.uint8], wanted: Picture) -> NDArray[np.float32]:
    """Colour, crop, resize in whole grey levels, reduce; (height, width, channels)."""
    if wanted.view is not None:
        seen = image if image.ndim == 2 else shrink(image)  # a frame of a trial
        return seen[:, :, np.newaxis].astype(np.float32)
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
    """Apply the scaling steps in order."""
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
"""Maximum size of a model file."""
MEMORY_BYTES = 2 << 30
"""Address space limit of the trial process; Python and the runtime use a quarter of it."""
_DTYPES: dict[str, type[np.floating[Any]]] = {
    'tensor(float)': np.float32, 'tensor(double)': np.float64, 'tensor(float16)': np.float16,
}

_NEWER = {
    'IR version': re.compile(r'model IR version: (\d+), max supported IR version: (\d+)'),
    'opset': re.compile(r'Opset (\d+) .* is till opset (\d+)'),
}
"""Reports of onnxruntime about a newer model: what is newer, its version, and the newest known."""
_SOURCE = re.compile(r'^/\S+:\d+ .*?\)(?: const)? (?=[A-Z])')
"""File, line and signature with which it begins some of its messages."""


def trial_frames() -> dict[str, NDArray[np.uint8]]:
    """Camera frames for the trial, by their name in error messages."""
    noise = np.random.default_rng(0).integers(0, 256, IMAGE_SHAPE, np.uint8)
    plain = {'grey': 128, 'dark': 0, 'bright': 255}
    return {name: np.full(IMAGE_SHAPE, level, np.uint8) for name, level in plain.items()} | {
        'noisy': noise,
    }


@dataclass(frozen=True, kw_only=True, slots=True)
class NetworkFiles:
    """File contents of a network; the trial and the use are of the same bytes.

    Attributes:
        path: path of the model, ``NAME.onnx``.
        model: bytes of the model.
        description: bytes of ``NAME.yaml``.
    """

    path: Path
    model: bytes
    description: bytes

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read the two files of a network.

        Raises:
            UsageError: a file is missing, unreadable or too large.
        """
        return cls(
            path=path, model=_read(path, MAX_BYTES),
            description=_read(sidecar_path(path), MAX_SIDECAR_BYTES),
        )

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the model followed by the description."""
        return hashlib.sha256(self.model + self.description).hexdigest()


class OnnxNetwork:
    """A network ready for inference.

    It runs on one CPU thread: on one machine the same frame gives bit-identical results in any
    process.
    """

    def __init__(self, files: NetworkFiles) -> None:
        """Open the model and check that it matches its description.

        onnxruntime evaluates the constant parts of the model when opening it, so time and memory
        are unlimited.

        Raises:
            UsageError: an unusable model or description; one line on the first error.
        """
        path = self._path = files.path
        self._sidecar = parse_sidecar(sidecar_path(path), files.description)
        self._model = _open(path, files.model)
        self._name, self._dtype = self._input()
        for output in self._model.outputs:
            if output.kind not in _DTYPES:
                raise file_error(path, f'output {output} is {output.kind}; export the network with '
                                'outputs of floating point')

    @property
    def sidecar(self) -> Sidecar:
        """Its description."""
        return self._sidecar

    def look(self, image: NDArray[np.uint8]) -> tuple[float, float]:
        """Estimate cross-track [m] and heading error [rad] from a frame (200, 360, 3) uint8.

        Or from the picture of an eye, (64, 192) uint8.

        NaN if the network fails; not finite if its output is not.
        """
        try:
            return self._meaning(self._run(image))
        except Exception:  # onnxruntime's have no other base class; they must not end the run
            return math.nan, math.nan

    def _input(self) -> tuple[str, type[np.floating[Any]]]:
        """Check the model's input against the sidecar; return its name and number type."""
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
        if given.shape and not fits:  # without a shape the trial shows whether it fits
            sides = ', '.join('?' if side is None else str(side) for side in given.shape)
            raise self._disagrees(f'layout, colour, height and width say {wanted.shape}',
                                  f"the model's input {given} is ({sides[:80]})")
        return given.name, _DTYPES[given.kind]

    def trial(self) -> bytes:
        """Evaluate all of :func:`trial_frames`; return all outputs as bytes, for comparison.

        Raises:
            UsageError: the model needs too much memory, fails on the grey frame, or gives outputs
                for it that do not match the description. Failures on other frames are allowed;
                in a run they give no estimate.
        """
        return b'\n'.join(self._tried(*named) for named in trial_frames().items())

    def _tried(self, name: str, frame: NDArray[np.uint8]) -> bytes:
        try:
            numbers = self._run(frame)
        except Exception as error:  # onnxruntime's have no other base class
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
        """Check that the number of outputs matches the description and all are finite."""
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
        """All output numbers, in order."""
        return self.numbers(prepare(image, self._sidecar))

    def numbers(self, inputs: NDArray[np.float32]) -> NDArray[np.float64]:
        """All output numbers, in order, for the network's input as of :func:`prepare`.

        Raises:
            Exception: onnxruntime's exceptions have no other base class.
        """
        with np.errstate(over='ignore', invalid='ignore'):
            cast = inputs.astype(self._dtype)
        arrays = self._model.session.run(None, {self._name: cast})
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
    """Input or output of a model; None in its shape is a side of any length."""

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
    """An onnxruntime session with its inputs and outputs."""

    session: Any
    inputs: tuple[_Tensor, ...]
    outputs: tuple[_Tensor, ...]


def _open_session(data: bytes) -> Any:
    """Open a session; on one machine equal inputs give equal outputs, in any process.

    On another processor the last bits may differ: onnxruntime chooses kernels by its features.

    Args:
        data: the ONNX model; weights in external files are not loaded.

    Raises:
        Exception: onnxruntime's exceptions have no other base class.
    """
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    options = onnxruntime.SessionOptions()
    options.log_severity_level = _FATAL
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.add_session_config_entry('session.load_model_format', 'ONNX')
    # External data files would be searched in the working directory; os.devnull has none.
    options.add_session_config_entry(
        'session.model_external_initializers_file_folder_path', os.devnull)
    return onnxruntime.InferenceSession(
        data, options, providers=['CPUExecutionProvider'], enable_fallback=0)


def _open(path: Path, data: bytes) -> _Model:
    import onnxruntime

    try:
        session = _open_session(data)
        return _Model(
            session=session,
            inputs=_Tensor.all_of(session.get_inputs()),
            outputs=_Tensor.all_of(session.get_outputs()),
        )
    except Exception as error:  # onnxruntime's have no other base class
        if 'external data' in str(error).lower():
            raise file_error(
                path, 'keeps weights in further files, which are not read; export it in one file'
            ) from None
        if short_of_memory(error):
            raise too_large(path) from None
        why = _too_new(error) or f'({_reason(error)}); copy or export it again'
        raise file_error(path, f'is not a model that onnxruntime {onnxruntime.__version__} can run '
                        f'{why}') from None


def _read(path: Path, most: int) -> bytes:
    try:
        if not path.exists():
            beside = '' if path.suffix == ONNX_SUFFIX else (
                '; an ONNX network needs its description beside it, which network describe '
                'writes, see docs/onnx.md')
            raise file_error(path, f'no such file{beside}')
        if path.is_dir():
            raise file_error(path, 'is not a file; name the file itself')
        data = read_file(path, most)
    except UnfitFileError as error:
        raise file_error(path, error.what) from None
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
    """Whether an error, also one of onnxruntime, reports lack of memory."""
    return isinstance(error, MemoryError) or 'alloc' in str(error).lower()


def too_large(path: Path) -> UsageError:
    """An error about a network that needs too much memory."""
    return file_error(
        path,
        f'needs more memory than allowed for a network, {MEMORY_BYTES >> 30} GiB; make it smaller',
    )


def _too_new(error: Exception) -> str | None:
    """Version of a model that onnxruntime does not know yet, and what to do."""
    for stamp, pattern in _NEWER.items():
        if found := pattern.search(' '.join(str(error).split())):
            given, most = found.groups()
            return (f'({stamp} {given}; it knows those up to {most}); export it with {stamp} '
                    f'{most} or older')
    return None


def _reason(error: Exception) -> str:
    """Message of onnxruntime in one line, without error codes and places in its source."""
    text = ' '.join(str(error).split()).rpartition(' : ')[2]
    return _SOURCE.sub('', text).rpartition(', Error ')[2][:160]
