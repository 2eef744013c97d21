"""Model cards: where a network's weights come from, and what they are worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.plain_values import load_json

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
        architecture: word of :data:`~taxinet_ros.core.network.ARCHITECTURES`.
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


def flaw(path: Path, what: str) -> UsageError:
    """What is wrong with a file of weights, or with its card, in one line."""
    return UsageError(f'weights: {path}: {what}')


def load_card(path: Path) -> ModelCard:
    """Read a card and check every entry.

    Raises:
        UsageError: one line on the first thing that is wrong.
    """
    try:
        values = load_json(path.read_text(encoding='utf-8'))
    except FileNotFoundError:
        raise flaw(path, 'no such file; a weights file needs its model card beside it') from None
    except OSError as error:
        raise flaw(path, f'cannot be read ({error.strerror})') from error
    except ValueError:
        raise flaw(path, 'is not JSON; copy it again') from None
    if not isinstance(values, dict):
        raise flaw(path, 'is no model card: not a JSON object')
    names = [field.name for field in fields(ModelCard)]
    values = {'start_sha256': None, **values}  # cards from before it have none
    if values.keys() != set(names):
        name = min(values.keys() ^ set(names))
        raise flaw(path, f'{name!r} {"is missing" if name in names else "is unknown"} in the card')
    for name in names:
        if not _CHECKS.get(name, _is_text)(values[name]):
            raise flaw(path, f'{name} in the card is {str(values[name])[:40]!r}, which cannot be')
    for name in ('training_data', 'validation_data'):
        values[name] = tuple(Source(**source) for source in values[name])
    return ModelCard(**values)


def _is_text(value: object) -> bool:
    return isinstance(value, str) and value != ''


def _is_switch(value: object) -> bool:
    return isinstance(value, bool)


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_magnitude(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return 0 <= value < math.inf


def _are_sources(value: object) -> bool:
    names = {field.name for field in fields(Source)}
    return isinstance(value, list) and all(
        isinstance(source, dict)
        and set(source) == names
        and all(map(_is_text, source.values()))
        and source['kind'] in SOURCE_KINDS
        for source in value
    )


def _are_errors(value: object) -> bool:
    if not isinstance(value, dict) or set(value) != set(ERROR_QUANTITIES):
        return False
    return all(
        isinstance(row, dict)
        and set(row) == set(ERROR_STATISTICS)
        and all(map(_is_magnitude, row.values()))
        for row in value.values()
    )


_CHECKS: dict[str, Callable[[object], bool]] = {
    'training_data': lambda value: value != [] and _are_sources(value),
    'validation_data': _are_sources,
    'start_sha256': lambda value: value is None or _is_text(value),
    'varied': _is_switch,
    'augment': _is_switch,
    'errors': _are_errors,
    'learning_rate': _is_magnitude,
    **dict.fromkeys(
        ('seed', 'images', 'validation', 'epochs', 'batch', 'patience', 'best_epoch'), _is_count
    ),
}
"""What the entries of a card have to be, where they are no texts."""
