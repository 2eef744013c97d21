"""A network on disk: weights ``NAME.safetensors`` and, beside them, the model card ``NAME.json``.

The format (https://github.com/huggingface/safetensors) holds arrays and nothing that runs, unlike
a pickle. The card says where the weights come from and what they are worth; its checksum ties the
two files together. Nothing is used that was not checked, and checking needs no torch.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray

from taxinet_ros import registry
from taxinet_ros.core.perception.network import ARCHITECTURES
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import Section, load_json

ERROR_STATISTICS = ('mae', 'p50', 'p90', 'p99', 'max')
ERROR_QUANTITIES = ('cte_m', 'he_deg')
SOURCE_KINDS = ('program', 'folder', 'runs')
"""Where pictures come from: rendered scenes of a Scenic program, a folder with a label table, or
the failed runs of a campaign."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Source:
    """Where pictures come from.

    Attributes:
        kind: one of :data:`SOURCE_KINDS`.
        name: of the program, folder or campaign.
        sha256: digest of the program's text, of the folder's labels and images, or of the
            campaign's ledger.
    """

    kind: str
    name: str
    sha256: str


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelCard:
    """Where a network comes from, and how well it sees in the world it was trained in.

    Attributes:
        architecture: word of :data:`~taxinet_ros.core.perception.network.ARCHITECTURES`.
        training_data: where the training pictures came from.
        validation_data: where the validation pictures came from; empty if they were held back
            from the training data.
        seed: of the scenes, the first weights and the order of training.
        images: pictures that were trained on.
        validation: others, that chose the epoch and that the errors were measured on.
        varied: whether the look of the rendered world varied.
        augment: whether pictures were changed a little each time they were seen.
        epochs, batch, learning_rate, patience: how it was trained.
        best_epoch: the one with the lowest validation loss, whose weights these are.
        errors: absolute errors on the validation pictures: for each of
            :data:`ERROR_QUANTITIES` the :data:`ERROR_STATISTICS`, [m] and [degrees].
        weights_sha256: digest of the weights file.
        package_version: of this package at the time.
        date: ISO date of the training (UTC).
        command_line: what makes these weights again.
        start_sha256: digest of the weights that the training began from; None for fresh ones.
    """

    architecture: str
    training_data: tuple[Source, ...]
    validation_data: tuple[Source, ...]
    seed: int
    images: int
    validation: int
    varied: bool
    augment: bool
    epochs: int
    batch: int
    learning_rate: float
    patience: int
    best_epoch: int
    errors: Mapping[str, Mapping[str, float]]
    weights_sha256: str
    package_version: str
    date: str
    command_line: str
    start_sha256: str | None = None


_ABOUT = 'weights: '


def card_error(path: Path, what: str) -> UsageError:
    """What is wrong with a file of weights, or with its card, in one line."""
    return UsageError(f'{_ABOUT}{path}: {what}')


def load_card(path: Path) -> ModelCard:
    """Read a card and check every entry.

    Raises:
        UsageError: one line on the first thing that is wrong.
    """
    try:
        values = load_json(path.read_text(encoding='utf-8'))
    except FileNotFoundError:
        raise card_error(
            path, 'no such file; a weights file needs its model card beside it'
        ) from None
    except OSError as error:
        raise card_error(path, f'cannot be read ({error.strerror})') from error
    except ValueError:
        raise card_error(path, 'is not JSON; copy it again') from None
    card = Section(path, values, [field.name for field in fields(ModelCard)], about=_ABOUT)
    return ModelCard(
        training_data=_sources(card, 'training_data'),
        validation_data=_sources(card, 'validation_data', least=0),
        varied=card.switch('varied'), augment=card.switch('augment'),
        learning_rate=card.number('learning_rate', 0),
        errors=_errors(card.section('errors', ERROR_QUANTITIES)),
        start_sha256=card.text('start_sha256') if values.get('start_sha256') is not None else None,
        seed=card.whole('seed', 0), images=card.whole('images', 0),
        validation=card.whole('validation', 0), epochs=card.whole('epochs', 0),
        batch=card.whole('batch', 0), patience=card.whole('patience', 0),
        best_epoch=card.whole('best_epoch', 0), architecture=card.text('architecture'),
        weights_sha256=card.text('weights_sha256'), date=card.text('date'),
        package_version=card.text('package_version'), command_line=card.text('command_line'),
    )


def _sources(card: Section, key: str, least: int = 1) -> tuple[Source, ...]:
    if not least and card.take(key, 'a list') == []:
        return ()
    return tuple(
        Source(kind=source.word('kind', SOURCE_KINDS), name=source.text('name'),
               sha256=source.text('sha256'))
        for source in card.sections(key, ('kind', 'name', 'sha256'))
    )


def _errors(given: Section) -> dict[str, dict[str, float]]:
    tables = {name: given.section(name, ERROR_STATISTICS) for name in ERROR_QUANTITIES}
    return {
        name: {one: table.number(one, 0) for one in ERROR_STATISTICS}
        for name, table in tables.items()
    }


SUFFIX = '.safetensors'
SHIPPED = {
    word: Path(__file__).parent / 'weights' / f'{word}{SUFFIX}'
    for word in registry.SHIPPED[registry.PERCEPTIONS] if word != 'truth'
}
"""Weights by the word that chooses them. ``original`` has learned in the part of S_falsif's world
that the paper's network may have been trained in, ``broad`` in all of it, and ``taxinet``, which
began as ``broad``, further where that one failed. The others are the paper's: retrained on scenes
of S_falsif, on those of a Halton sequence through it, and more where on the runway the original
failed (section 3.4); and ``generic`` trained further on a fifth more scenes: of S_falsif, of the
crossing, and of where it failed (appendix A.1)."""
(
    TAXINET, BROAD, ORIGINAL, GENERIC, HALTON, SPECIALISED, ITERATIVE_GENERIC, ITERATIVE_CROSSING,
    ITERATIVE_LEARNED,
) = SHIPPED.values()
MAX_BYTES = 64 << 20
"""Largest file that is read; the shipped one is below 1 MiB."""
Weights = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Model:
    """Checked weights and their card."""

    card: ModelCard
    weights: Weights

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the weights, by which bags and tables know the network."""
        return self.card.weights_sha256


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
        write_atomically(card_path(path), text)
        write_atomically(path, data)
    except OSError as error:
        raise card_error(
            path, f'cannot be written ({error.strerror}); choose another folder'
        ) from error


def load_model(path: Path) -> Model:
    """Read weights and card, and check everything about them.

    Raises:
        UsageError: one line on the first thing that is wrong.
    """
    data = _read(path)
    weights = _parse(path, data)
    card = load_card(card_path(path))
    if digest(data) != card.weights_sha256:
        raise card_error(
            path,
            f'is not the file that {card_path(path).name} describes (its SHA-256 '
            'differs); copy the two files together',
        )
    if card.architecture not in ARCHITECTURES:
        known = ', '.join(ARCHITECTURES)
        raise card_error(path, f'architecture {card.architecture!r} is unknown; known: {known}')
    _check_arrays(path, weights, ARCHITECTURES[card.architecture].shapes())
    return Model(card=card, weights=weights)


def _read(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise card_error(path, 'no such file')
        if path.stat().st_size > MAX_BYTES:
            raise card_error(path, f'is larger than {MAX_BYTES >> 20} MiB, too large for a TaxiNet')
        return path.read_bytes()
    except OSError as error:
        raise card_error(path, f'cannot be read ({error.strerror})') from error


def _parse(path: Path, data: bytes) -> dict[str, NDArray[Any]]:
    if data.startswith(b'version https://git-lfs'):
        raise card_error(
            path, 'is only a Git LFS pointer; get the file with: git lfs pull'
        )
    if data.startswith((b'PK', b'\x80')):
        raise card_error(
            path, 'is a pickle, which could run arbitrary code; only safetensors files are read'
        )
    try:
        return safetensors.numpy.load(data)
    except (safetensors.SafetensorError, KeyError, ValueError) as error:
        # A type of number that numpy lacks is a KeyError there.
        reason = ' '.join(str(error).split())
        raise card_error(
            path, f'is not a complete safetensors file ({reason}); copy it again'
        ) from None


def _check_arrays(
    path: Path, weights: Mapping[str, NDArray[Any]], shapes: Mapping[str, tuple[int, ...]]
) -> None:
    if weights.keys() != shapes.keys():
        name = min(weights.keys() ^ shapes.keys())
        what = 'is missing' if name in shapes else 'does not belong to the architecture'
        raise card_error(path, f'array {name} {what}; train it again')
    for name, shape in shapes.items():
        array = weights[name]
        if array.dtype != np.float32 or array.shape != shape:
            raise card_error(
                path, f'array {name} is {array.dtype} {array.shape}, not float32 {shape}'
            )
        if not np.isfinite(array).all():
            raise card_error(path, f'array {name} has values that are not finite; train it again')
