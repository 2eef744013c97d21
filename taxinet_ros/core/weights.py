"""Weights of a network on disk: ``NAME.safetensors`` and, beside it, the model card ``NAME.json``.

The format (https://github.com/huggingface/safetensors) holds arrays and nothing that runs, unlike
a pickle. The card says where the weights come from and what they are worth; its checksum ties the
two files together. Nothing is used that was not checked, and checking needs no torch.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray

from taxinet_ros.core.model_card import ModelCard, flaw, load_card
from taxinet_ros.core.network import ARCHITECTURES

SUFFIX = '.safetensors'
SHIPPED = {
    word: Path(__file__).parent / 'weights' / f'{word}{SUFFIX}'
    for word in (
        'taxinet', 'broad', 'original', 'generic', 'halton', 'specialised', 'iterative-generic',
        'iterative-crossing', 'iterative-learned',
    )
}
"""Weights by the word that chooses them. ``original`` has learned in the part of S_falsif's world
that the paper's network may have been trained in, ``broad`` in all of it, and ``taxinet``, which
began as ``broad``, further where that one failed. The others are the paper's: retrained on scenes
of S_falsif, on those of a Halton sequence through it, and more where on the runway the original
failed (section 3.4); and ``generic`` trained further on a fifth more scenes: of S_falsif, of the
crossing, and of where it failed (appendix A.1)."""

MAX_BYTES = 64 << 20
"""Largest file that is read; the shipped one is below 1 MiB."""

Weights = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Model:
    """Checked weights and their card."""

    card: ModelCard
    weights: Weights


def weights_path(word_or_file: str | Path) -> Path:
    """The file of a shipped network's word, or the file itself."""
    return SHIPPED.get(str(word_or_file), Path(word_or_file))


def card_path(path: Path) -> Path:
    """The model card that belongs to a weights file."""
    return path.with_suffix('.json')


def to_bytes(weights: Weights) -> bytes:
    """The weights file of ``weights``; equal weights give equal bytes."""
    return safetensors.numpy.save(dict(weights))


def digest(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def save_model(path: Path, data: bytes, card: ModelCard) -> None:
    """Write the weights file's bytes and their card, each complete or not at all.

    A stop between the two leaves a pair that :func:`load_model` refuses.

    Raises:
        UsageError: the folder cannot be written to.
    """
    text = json.dumps(asdict(card), indent=2) + '\n'
    try:
        _replace(card_path(path), text.encode())
        _replace(path, data)
    except OSError as error:
        raise flaw(path, f'cannot be written ({error.strerror}); choose another folder') from error


def load_model(path: Path) -> Model:
    """Read weights and card, and check everything about them.

    Raises:
        UsageError: one line on the first thing that is wrong.
    """
    data = _read(path)
    weights = _parse(path, data)
    card = load_card(card_path(path))
    if digest(data) != card.weights_sha256:
        raise flaw(path, f'is not the file that {card_path(path).name} describes (its SHA-256 '
                         'differs); copy the two files together')
    if card.architecture not in ARCHITECTURES:
        known = ', '.join(ARCHITECTURES)
        raise flaw(path, f'architecture {card.architecture!r} is unknown; known: {known}')
    _check_arrays(path, weights, ARCHITECTURES[card.architecture].shapes())
    return Model(card=card, weights=weights)


def _read(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise flaw(path, 'no such file')
        if path.stat().st_size > MAX_BYTES:
            raise flaw(path, f'has more than {MAX_BYTES >> 20} MiB, too many for a TaxiNet')
        return path.read_bytes()
    except OSError as error:
        raise flaw(path, f'cannot be read ({error.strerror})') from error


def _parse(path: Path, data: bytes) -> dict[str, NDArray[Any]]:
    if data.startswith(b'version https://git-lfs'):
        raise flaw(path, 'is only the pointer to a Git LFS file; get the file with: git lfs pull')
    if data.startswith((b'PK', b'\x80')):
        raise flaw(path, 'is a pickle, which may run anything; only safetensors files are read')
    try:
        return safetensors.numpy.load(data)
    except (safetensors.SafetensorError, KeyError, ValueError) as error:
        # A type of number that numpy lacks is a KeyError there.
        reason = ' '.join(str(error).split())
        raise flaw(path, f'is no whole safetensors file ({reason}); copy it again') from None


def _check_arrays(
    path: Path, weights: Mapping[str, NDArray[Any]], shapes: Mapping[str, tuple[int, ...]]
) -> None:
    if weights.keys() != shapes.keys():
        name = min(weights.keys() ^ shapes.keys())
        what = 'is missing' if name in shapes else 'does not belong to the architecture'
        raise flaw(path, f'array {name} {what}; train it again')
    for name, shape in shapes.items():
        array = weights[name]
        if array.dtype != np.float32 or array.shape != shape:
            raise flaw(path, f'array {name} is {array.dtype} {array.shape}, not float32 {shape}')
        if not np.isfinite(array).all():
            raise flaw(path, f'array {name} has values that are not finite; train it again')


def _replace(path: Path, data: bytes) -> None:
    """Put a whole file in place at once, through one of another name in the same folder."""
    descriptor, name = tempfile.mkstemp(prefix=f'.{path.name}.', dir=path.parent)
    try:
        with os.fdopen(descriptor, 'wb') as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(name).chmod(0o644)  # a temporary file is its owner's only
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
