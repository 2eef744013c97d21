"""From a Scenic program or folders of labelled images to a weights file with its model card."""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING

from taxinet_ros import __version__
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.model_card import ModelCard
from taxinet_ros.core.network import ARCHITECTURES, DEFAULT_ARCHITECTURE
from taxinet_ros.core.weights import (
    Model,
    Weights,
    digest,
    load_model,
    save_model,
    to_bytes,
    weights_path,
)
from taxinet_ros.training.dataset import Dataset, Progress, silent
from taxinet_ros.training.history import history_csv
from taxinet_ros.training.material import Material, get_material
from taxinet_ros.training.options import TrainOptions

if TYPE_CHECKING:
    from taxinet_ros.training.fit import Fitted

def train(options: TrainOptions, progress: Progress = silent) -> ModelCard:
    """Get labelled pictures, fit a network, measure it, and write weights, card and curves.

    Everything that can be wrong with the options is found before the work starts. Files appear
    at the end and whole; equal options give equal weights on one machine.

    Args:
        options: what to do.
        progress: told of the stages ``scenes``, ``images``, ``held back`` (images of
            ``validation_data``) and ``epochs``.

    Returns:
        The card that was written. Its errors were measured on the pictures that also chose the
        epoch, one of a few dozen, which flatters them a little.

    Raises:
        UsageError: options, program, data or folder cannot be used.
        InfraError: a worker process died, or the simulator failed.
    """
    options.check_out()
    start = None if options.start is None else load_model(weights_path(options.start))
    material = get_material(options, progress)
    fitted = _fit(options, material, start, progress)
    data = to_bytes(fitted.weights)
    card = ModelCard(
        architecture=DEFAULT_ARCHITECTURE,
        training_data=material.training_data,
        validation_data=material.validation_data,
        seed=options.seed,
        images=len(material.training),
        validation=len(material.validation),
        varied=options.varied,
        augment=options.augment,
        epochs=options.epochs,
        batch=options.batch,
        learning_rate=options.learning_rate,
        patience=options.patience,
        best_epoch=fitted.best_epoch,
        errors=_measure(fitted.weights, material.validation),
        weights_sha256=digest(data),
        package_version=__version__,
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        command_line=options.command_line,
        start_sha256=None if start is None else start.card.weights_sha256,
    )
    save_model(options.out, data, card)
    _write_curves(options, fitted)
    return card


def _fit(
    options: TrainOptions, material: Material, start: Model | None, progress: Progress
) -> Fitted:
    from taxinet_ros.training.fit import Recipe, fit  # torch: bad options should not wait for it

    recipe = Recipe(
        epochs=options.epochs, batch=options.batch, learning_rate=options.learning_rate,
        seed=options.seed, patience=options.patience, augmented=options.augment,
    )
    architecture = ARCHITECTURES[DEFAULT_ARCHITECTURE]
    weights = None if start is None else start.weights
    return fit(architecture, material.training, material.validation, recipe, progress, weights)


def _measure(weights: Weights, held_back: Dataset) -> dict[str, dict[str, float]]:
    from taxinet_ros.core.network import TaxiNet
    from taxinet_ros.training.accuracy import absolute_errors, statistics

    network = TaxiNet(ARCHITECTURES[DEFAULT_ARCHITECTURE], weights)
    return statistics(absolute_errors(network, held_back))


def _write_curves(options: TrainOptions, fitted: Fitted) -> None:
    from taxinet_ros.training.curves import learning_curves

    picture = learning_curves(fitted.history, fitted.best_epoch, options.out.stem)
    try:
        options.curves_path.write_bytes(picture)
        options.history_path.write_text(history_csv(fitted.history), encoding='utf-8')
    except OSError as error:
        raise UsageError(
            f'train: {options.curves_path.parent}: cannot be written ({error.strerror})'
        ) from error
