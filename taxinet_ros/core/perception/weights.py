"""Network files: weights ``NAME.safetensors`` with a model card ``NAME.json`` next to them.

The format (https://github.com/huggingface/safetensors) contains arrays only and, unlike a pickle,
no code. The card records the origin and accuracy of the weights, and their checksum. Both files are
fully checked before use; torch is not needed.
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
from taxinet_ros.core.perception.domain import Domain, read_domain
from taxinet_ros.core.perception.eye import VIEWS
from taxinet_ros.core.perception.network import ARCHITECTURES
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import Section, load_json
from taxinet_ros.files.reading import MAX_TEXT_BYTES, UnfitFileError, read_file

ERROR_STATISTICS = ('mae', 'p50', 'p90', 'p99', 'max')
ERROR_QUANTITIES = ('cte_m', 'he_deg')
SOURCE_KINDS = ('program', 'folder', 'runs', 'places')
"""Sources of images: rendered scenes of a Scenic program, a folder with a label table, the failed
runs of a campaign, or scenes place by place."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Source:
    """Source of images.

    Attributes:
        kind: one of :data:`SOURCE_KINDS`.
        name: name of the program, folder, campaign or places.
        sha256: digest of the program's text, of the folder's labels and images, or of the
            campaign's record.
    """

    kind: str
    name: str
    sha256: str


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelCard:
    """Origin of a network and its accuracy on validation data.

    Attributes:
        architecture: key of :data:`~taxinet_ros.core.perception.network.ARCHITECTURES`.
        training_data: sources of the training images.
        validation_data: sources of the validation images; empty if they were held out of the
            training data.
        seed: seed of the scenes, the initial weights and the training order.
        images: number of training images.
        validation: number of validation images; used to select the epoch and measure the errors.
        varied: whether the appearance of the rendered world was randomized.
        augment: whether images were augmented.
        epochs, batch, learning_rate: training parameters.
        patience: epochs without improvement after which older versions could stop; 0: never.
        best_epoch: epoch with the lowest validation loss; the weights are from it.
        errors: absolute errors on the validation images: for each of
            :data:`ERROR_QUANTITIES` the :data:`ERROR_STATISTICS`, [m] and [degrees].
        weights_sha256: digest of the weights file.
        package_version: version of this package at the time of training.
        date: ISO date of the training (UTC).
        command_line: command that reproduces the weights.
        start_sha256: digest of the weights that training started from; None for random ones.
        view: virtual camera that it sees through, a name of
            :data:`~taxinet_ros.core.perception.eye.VIEWS`; None if it sees the frames as they are.
        domain: what is in the training pictures, with those that the first weights were trained
            on; None if unknown.
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
    view: str | None = None
    domain: Domain | None = None


_ABOUT = 'weights: '


def card_error(path: Path, what: str) -> UsageError:
    """One-line error about a weights file or its card."""
    return UsageError(f'{_ABOUT}{path}: {what}')


def load_card(path: Path) -> ModelCard:
    """Read a card and check every entry.

    Raises:
        UsageError: an invalid card; one line on the first error.
    """
    try:
        values = load_json(read_file(path, MAX_TEXT_BYTES).decode())
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
        view=card.word('view', tuple(VIEWS)) if values.get('view') is not None else None,
        seed=card.whole('seed', 0), images=card.whole('images', 0),
        validation=card.whole('validation', 0), epochs=card.whole('epochs', 0),
        batch=card.whole('batch', 0), patience=card.whole('patience', 0),
        best_epoch=card.whole('best_epoch', 0), architecture=card.text('architecture'),
        weights_sha256=card.text('weights_sha256'), date=card.text('date'),
        package_version=card.text('package_version'), command_line=card.text('command_line'),
        domain=read_domain(card),
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
"""Shipped weights by name. ``original`` was trained in the part of S_falsif's world that the
paper's network may have been trained in, ``broad`` in all of it; ``taxinet`` is ``broad`` trained
further where that one failed. ``anywhere`` was trained at random places with random cameras, which
it sees through the eye. The others follow the paper: retrained on scenes of S_falsif, on a
Halton sequence through it, and with more scenes where on the runway the original failed (section
3.4); and ``generic`` trained further on a fifth more scenes: of S_falsif, of the crossing, and of
where it failed as VerifAI's rule learned it (appendix A.1), and as our ``ce`` did."""
(
    TAXINET, ANYWHERE, BROAD, ORIGINAL, GENERIC, HALTON, SPECIALISED, ITERATIVE_GENERIC,
    ITERATIVE_CROSSING, ITERATIVE_VERIFAI, ITERATIVE_LEARNED,
) = SHIPPED.values()
MAX_BYTES = 64 << 20
"""Maximum size of a weights file; shipped files are below 2 MiB."""
Weights = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Model:
    """Checked weights and their card."""

    card: ModelCard
    weights: Weights

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the weights; identifies the network in bags and tables."""
        return self.card.weights_sha256


def weights_path(word_or_file: str | Path) -> Path:
    """Path of a shipped network's weights, or the given file."""
    return SHIPPED.get(str(word_or_file), Path(word_or_file))


def card_path(path: Path) -> Path:
    """Path of the model card of a weights file."""
    return path.with_suffix('.json')


def to_bytes(weights: Weights) -> bytes:
    """Serialize weights as safetensors; equal weights give equal bytes."""
    return safetensors.numpy.save(dict(weights))


def digest(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def save_model(path: Path, data: bytes, card: ModelCard) -> None:
    """Write the weights file and its card, each atomically.

    An interruption between the two leaves a pair that :func:`load_model` rejects.

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
    """Read weights and card, and check both completely.

    Raises:
        UsageError: invalid weights or card; one line on the first error.
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
        if not path.exists() or path.is_dir():
            raise card_error(path, 'no such file')
        return read_file(path, MAX_BYTES)
    except UnfitFileError as error:
        raise card_error(path, error.what) from None
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
        # safetensors raises KeyError for a number type that numpy lacks.
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
