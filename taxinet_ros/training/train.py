"""From a Scenic program or folders of labelled images to a weights file with its model card."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from taxinet_ros import __version__
from taxinet_ros.campaign.programs import find_program, program_digest
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.network import ARCHITECTURES, DEFAULT_ARCHITECTURE
from taxinet_ros.core.weights import ModelCard, Source, Weights, digest, save_model, to_bytes
from taxinet_ros.training.dataset import Dataset, Progress, draw_scenes, make_dataset, silent
from taxinet_ros.training.history import history_csv
from taxinet_ros.training.images import load_folders
from taxinet_ros.training.options import TrainOptions

if TYPE_CHECKING:
    from taxinet_ros.training.fit import Fitted

_SPLIT = 2
"""Tells the random numbers that hold rows back from those of the training."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Material:
    """What to learn and what to measure on, and where both come from."""

    training: Dataset
    validation: Dataset
    training_data: tuple[Source, ...]
    validation_data: tuple[Source, ...] = ()


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
    material = _material(options, progress)
    fitted = _fit(options, material, progress)
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
    )
    save_model(options.out, data, card)
    _write_curves(options, fitted)
    return card


def _material(options: TrainOptions, progress: Progress) -> _Material:
    if options.program is not None:
        return _rendered(options, options.program, progress)
    workers = options.workers
    training, sources = load_folders(options.data, workers=workers, progress=progress)
    if options.validation_data is None:
        kept, held_back = _split(options, training)
        return _Material(training=kept, validation=held_back, training_data=sources)
    _check_batch(options, len(training))
    validation, others = load_folders(
        (options.validation_data,), workers=workers, stage='held back', progress=progress
    )
    return _Material(
        training=training, validation=validation, training_data=sources, validation_data=others
    )


def _rendered(options: TrainOptions, program: str, progress: Progress) -> _Material:
    sha256 = program_digest(find_program(program))
    images = options.images + options.validation
    scenes = draw_scenes(program, seed=options.seed, images=images, progress=progress)
    dataset = make_dataset(
        scenes, workers=options.workers, varied=options.varied, seed=options.seed,
        progress=progress,
    )
    return _Material(
        training=dataset.take(slice(options.images)),
        validation=dataset.take(slice(options.images, None)),
        training_data=(Source(kind='program', name=Path(program).stem, sha256=sha256),),
    )


def _split(options: TrainOptions, dataset: Dataset) -> tuple[Dataset, Dataset]:
    """Rows to learn and rows held back, each in the order of the tables."""
    import numpy as np

    left = len(dataset) - options.validation
    if left < 1:
        raise UsageError(
            f'train: --validation {options.validation} leaves nothing of {len(dataset)} images to '
            'train on; hold fewer back'
        )
    _check_batch(options, left)
    order = np.random.default_rng([options.seed, _SPLIT]).permutation(len(dataset))
    return dataset.take(np.sort(order[:left])), dataset.take(np.sort(order[left:]))


def _check_batch(options: TrainOptions, images: int) -> None:
    if options.batch > images:
        raise UsageError(f'train: a batch of {options.batch} is more than {images} images')


def _fit(options: TrainOptions, material: _Material, progress: Progress) -> Fitted:
    from taxinet_ros.training.fit import Recipe, fit  # torch: bad options should not wait for it

    recipe = Recipe(
        epochs=options.epochs, batch=options.batch, learning_rate=options.learning_rate,
        seed=options.seed, patience=options.patience, augmented=options.augment,
    )
    architecture = ARCHITECTURES[DEFAULT_ARCHITECTURE]
    return fit(architecture, material.training, material.validation, recipe, progress)


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
