"""What a training learns and is measured on: rendered scenes, or folders of labelled images."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.model_card import Source
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.training.dataset import Dataset, Progress, draw_scenes, make_dataset
from taxinet_ros.training.images import load_folders
from taxinet_ros.training.options import TrainOptions
from taxinet_ros.training.portions import portion_seed, program_source

_SPLIT = 2
"""Tells the random numbers that hold rows back from those of the training."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Material:
    """What to learn and what to measure on, and where both come from.

    Attributes:
        training, validation: the pictures.
        training_data, validation_data: their origins, as a model card has them; the latter is
            empty where the validation pictures were held back from the others.
    """

    training: Dataset
    validation: Dataset
    training_data: tuple[Source, ...]
    validation_data: tuple[Source, ...] = ()


def get_material(options: TrainOptions, progress: Progress) -> Material:
    """Render or read what the options ask for.

    Raises:
        UsageError: a program, campaign or folder cannot be used, or has too little.
        InfraError: a worker process died, or the simulator failed.
    """
    if options.program is not None:
        return _rendered(options, options.program, progress)
    return _read(options, progress)


@dataclass(frozen=True, slots=True)
class _Lot:
    """Scenes that are trained on, or held back, together."""

    scenes: list[Scenario]
    held_back: bool


def _rendered(options: TrainOptions, program: str, progress: Progress) -> Material:
    other = options.validation_program
    sources = (program_source(program), *(portion.source() for portion in options.add))
    validation_data = () if other is None else (program_source(other),)
    # The program's own lots come first, so that nothing added changes their pictures.
    lots = [*_own(options, program, progress), *_added(options, progress)]
    dataset = make_dataset(
        list(itertools.chain.from_iterable(lot.scenes for lot in lots)),
        workers=options.workers, varied=options.varied, seed=options.seed, progress=progress,
    )
    held_back = np.repeat([lot.held_back for lot in lots], [len(lot.scenes) for lot in lots])
    return Material(
        training=dataset.take(~held_back), validation=dataset.take(held_back),
        training_data=sources, validation_data=validation_data,
    )


def _own(options: TrainOptions, program: str, progress: Progress) -> list[_Lot]:
    """The program's scenes, and those held back, of it or of the validation program."""
    images, total = options.images, options.images + options.validation
    other = options.validation_program
    scenes = draw_scenes(
        program, seed=options.seed, images=total if other is None else images,
        sampler=options.sampler, progress=progress,
    )
    if other is None:
        return [_Lot(scenes[:images], False), _Lot(scenes[images:], True)]
    others = draw_scenes(other, seed=options.seed, images=total, progress=progress)
    return [_Lot(scenes, False), _Lot(others[images:], True)]


def _added(options: TrainOptions, progress: Progress) -> list[_Lot]:
    lots = []
    for number, portion in enumerate(options.add):
        held_back = round(portion.count * options.validation / options.images)
        seed = portion_seed(options.seed, number)
        scenes = portion.scenes(portion.count + held_back, seed, progress)
        lots += [_Lot(scenes[: portion.count], False), _Lot(scenes[portion.count :], True)]
    return lots


def _read(options: TrainOptions, progress: Progress) -> Material:
    workers = options.workers
    training, sources = load_folders(options.data, workers=workers, progress=progress)
    if options.validation_data is None:
        kept, held_back = _split(options, training)
        return Material(training=kept, validation=held_back, training_data=sources)
    _check_batch(options, len(training))
    validation, others = load_folders(
        (options.validation_data,), workers=workers, stage='held back', progress=progress
    )
    return Material(
        training=training, validation=validation, training_data=sources, validation_data=others
    )


def _split(options: TrainOptions, dataset: Dataset) -> tuple[Dataset, Dataset]:
    """Rows to learn and rows held back, each in the order of the tables."""
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
