"""Train a network on a Scenic program, places or folders of labelled images; write its files."""

from __future__ import annotations

import contextlib
import datetime
import itertools
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taxinet_ros.core.perception.domain import Domain, domain_of_scenes, joined_domains
from taxinet_ros.core.perception.network import ARCHITECTURES
from taxinet_ros.core.perception.weights import (
    Model,
    ModelCard,
    Source,
    Weights,
    digest,
    load_model,
    save_model,
    to_bytes,
    weights_path,
)
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CAMERA, PLACE
from taxinet_ros.errors import RecordError, UsageError, warn_once
from taxinet_ros.files.atomic import disk_words
from taxinet_ros.training.accuracy import history_csv
from taxinet_ros.training.data.dataset import (
    Dataset,
    Progress,
    draw_scenes,
    make_dataset,
    no_progress,
)
from taxinet_ros.training.data.image_folder import folders_domain, load_folders
from taxinet_ros.training.data.places import named_places, places_scenes, places_source
from taxinet_ros.training.data.portions import portion_seed, program_source
from taxinet_ros.training.data.unfinished import Unfinished
from taxinet_ros.training.options import TrainOptions
from taxinet_ros.version import __version__

if TYPE_CHECKING:
    from taxinet_ros.training.fit import Fitted


IMAGES = 'training and validation images'
"""The stage in which scenes are rendered, those added and those held out included."""
VALIDATION_PLACES = 'random:validation'
"""Places whose pictures choose the epoch of a training on places."""
_PLACE_CHUNK = 512
"""Pictures that a process makes at one place."""
_SPLIT = 2
"""Stream key that separates the random numbers of the split from those of the training."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TrainingData:
    """Training and validation pictures with their origins.

    Attributes:
        training, validation: the pictures.
        training_data, validation_data: their origins, as in a model card; the latter is empty if
            the validation pictures were held out from the others.
        domain: what the training pictures show, as in a card.
    """

    training: Dataset
    validation: Dataset
    training_data: tuple[Source, ...]
    validation_data: tuple[Source, ...] = ()
    domain: Domain | None = None


def get_training_data(
    options: TrainOptions, progress: Progress,
    begin: Callable[[Sequence[Source]], Unfinished | None] = lambda sources: None,
) -> TrainingData:
    """Render or read the pictures requested by the options.

    Args:
        options: options of the training.
        progress: as in :func:`train`.
        begin: called with the origins of the pictures; returns the record to keep rendered ones in.

    Raises:
        UsageError: a program, campaign or folder cannot be used, or has too few pictures.
        InfraError: a worker process died, or the simulator failed.
    """
    if not options.data:
        return _render_scenes(options, progress, begin)
    material = _read_folders(options, progress)
    begin((*material.training_data, *material.validation_data))
    return material


@dataclass(frozen=True, slots=True)
class _SceneGroup:
    """Scenes of one origin, for training or held out."""

    scenes: list[Scenario]
    held_back: bool


def _render_scenes(
    options: TrainOptions, progress: Progress,
    begin: Callable[[Sequence[Source]], Unfinished | None],
) -> TrainingData:
    other, program = options.validation_program, options.program
    validation_data: tuple[Source, ...] = ()
    if program is None:
        own = tuple(map(places_source, options.places))
        validation_data = (places_source(VALIDATION_PLACES),)
        lots = _place_scenes(options, progress)
    else:
        own = (program_source(program),)
        validation_data = () if other is None else (program_source(other),)
        lots = _program_scenes(options, program, progress)
    added, folders = load_folders(
        options.add_data, workers=options.workers, view=options.view, stage='added images',
        progress=progress,
    )
    sources = (*own, *(portion.source() for portion in options.add), *folders)
    # The program's own groups come first, so that additions do not change their pictures.
    lots += _added_scenes(options, progress)
    # Only now: a bad program leaves nothing behind.
    unfinished = begin((*sources, *validation_data))
    dataset = make_dataset(
        list(itertools.chain.from_iterable(lot.scenes for lot in lots)),
        workers=options.workers, varied=options.varied, seed=options.seed, view=options.view,
        chunk=_PLACE_CHUNK if options.places else 0, progress=progress, stage=IMAGES,
        unfinished=unfinished,
    )
    held_back = np.repeat([lot.held_back for lot in lots], [len(lot.scenes) for lot in lots])
    return TrainingData(
        training=dataset.take(~held_back).joined(added), validation=dataset.take(held_back),
        training_data=sources, validation_data=validation_data,
        domain=joined_domains([
            _domain(options, [lot.scenes for lot in lots if not lot.held_back]),
            *([folders_domain(options.add_data)] if options.add_data else []),
        ]),
    )


def _domain(options: TrainOptions, groups: Sequence[Sequence[Scenario]]) -> Domain:
    """What scenes show; of a world of places and cameras no names, but their numbers."""
    unnamed = (PLACE.key, *([CAMERA.key] if options.view else [])) if options.places else ()
    return domain_of_scenes(
        (scene.to_human() for scenes in groups for scene in scenes), unnamed=unnamed)


def _place_scenes(options: TrainOptions, progress: Progress) -> list[_SceneGroup]:
    """Scenes of the places, and those of others that are held out."""
    def scenes(places: Sequence[str], count: int) -> list[Scenario]:
        cameras = options.view is not None
        return places_scenes(places, count, options.seed, cameras=cameras, progress=progress)

    others = named_places([VALIDATION_PLACES])[:options.validation]
    return [
        _SceneGroup(scenes(named_places(options.places), options.images), False),
        _SceneGroup(scenes(others, options.validation), True),
    ]


def _program_scenes(options: TrainOptions, program: str, progress: Progress) -> list[_SceneGroup]:
    """The program's scenes, and the held-out ones, of it or of the validation program."""
    images, total = options.images, options.images + options.validation
    other = options.validation_program
    scenes = draw_scenes(
        program, seed=options.seed, images=total if other is None else images,
        sampler=options.sampler, progress=progress,
    )
    if other is None:
        return [_SceneGroup(scenes[:images], False), _SceneGroup(scenes[images:], True)]
    others = draw_scenes(other, seed=options.seed, images=total, progress=progress)
    return [_SceneGroup(scenes, False), _SceneGroup(others[images:], True)]


def _added_scenes(options: TrainOptions, progress: Progress) -> list[_SceneGroup]:
    lots = []
    for number, portion in enumerate(options.add):
        held_back = round(portion.count * options.validation / options.images)
        seed = portion_seed(options.seed, number)
        scenes = portion.scenes(portion.count + held_back, seed, progress)
        lots += [
            _SceneGroup(scenes[: portion.count], False),
            _SceneGroup(scenes[portion.count :], True),
        ]
    return lots


def _read_folders(options: TrainOptions, progress: Progress) -> TrainingData:
    workers, domain = options.workers, folders_domain(options.data)
    training, sources = load_folders(
        options.data, workers=workers, view=options.view, progress=progress)
    if options.validation_data is None:
        kept, held_back = _split(options, training)
        return TrainingData(
            training=kept, validation=held_back, training_data=sources, domain=domain,
        )
    options.check_batch(len(training))
    validation, others = load_folders(
        (options.validation_data,), workers=workers, view=options.view, stage='held back',
        progress=progress,
    )
    return TrainingData(
        training=training, validation=validation, training_data=sources, validation_data=others,
        domain=domain,
    )


def _split(options: TrainOptions, dataset: Dataset) -> tuple[Dataset, Dataset]:
    """Split into training and held-out rows, each in the order of the tables."""
    left = len(dataset) - options.validation
    if left < 1:
        held = len(dataset) // 5 or 1
        left = len(dataset) - held
        batch = f', with a batch of {left} or less' if options.batch > left else ''
        raise UsageError(
            f'train: {len(dataset)} images are too few to hold out {options.validation} of them, '
            f'as asked or by default; use a validation of {held}{batch}, or a folder as '
            'validation_data'
        )
    options.check_batch(left)
    order = np.random.default_rng([options.seed, _SPLIT]).permutation(len(dataset))
    return dataset.take(np.sort(order[:left])), dataset.take(np.sort(order[left:]))


def _check_device(device: str) -> None:
    if device != 'cpu':
        import torch

        if not torch.cuda.is_available():
            raise UsageError(
                f'train: device {device}: torch finds no GPU here; leave it out to use the CPU'
            )


def train(options: TrainOptions, progress: Progress = no_progress) -> ModelCard:
    """Get labelled pictures, train and evaluate a network, and write weights, card and curves.

    All errors in the options are found before the work starts. Files are written atomically at the
    end; equal options give equal weights on one machine. Until then, pictures and the last epoch
    are in the folder ``options.unfinished``, with which ``options.resume`` goes on.

    Args:
        options: options of the training.
        progress: called in the stages ``scenes``, :data:`IMAGES`, ``held back`` (images of
            ``validation_data``) and ``epochs``.

    Returns:
        The written card. Its errors are slightly optimistic, since they were measured on the
        pictures that also chose the epoch, one of a few dozen.

    Raises:
        UsageError: options, program, data or folder cannot be used.
        RecordError: the disk is full, or the folder was moved or deleted meanwhile.
        InfraError: a worker process died, or the simulator failed.
    """
    options.check_out()
    _check_device(options.device)
    named_places(options.places)
    start = None if options.start is None else load_model(weights_path(options.start))
    if start is not None:
        options = replace(
            options, view=options.view or start.card.view,
            architecture=options.architecture or start.card.architecture)
        if options.architecture != start.card.architecture:
            raise UsageError(
                f'train: start {options.start}: is of architecture {start.card.architecture}, '
                f'not {options.architecture}'
            )
    if start is not None and start.card.view != options.view:
        raise UsageError(
            f'train: start {options.start}: sees through the view {start.card.view or "none"}, '
            f'not {options.view or "none"}'
        )
    with contextlib.ExitStack() as opened:
        def begin(sources: Sequence[Source]) -> Unfinished:
            request = options.request(sources, '' if start is None else start.fingerprint)
            return opened.enter_context(_pictures_so_far(options, request))

        material = get_training_data(options, progress, begin)
        fitted = _fit(options, material, start, progress)
        card = _write(options, material, fitted, start)
    shutil.rmtree(options.unfinished)
    return card


@contextlib.contextmanager
def _pictures_so_far(options: TrainOptions, request: Mapping[str, Any]) -> Iterator[Unfinished]:
    """The open record of rendered pictures; write errors within say how to go on."""
    folder = options.unfinished
    if not options.resume:
        shutil.rmtree(folder, ignore_errors=True)
    try:
        with Unfinished('train', folder, request, resume=options.resume) as pictures:
            yield pictures
    except OSError as error:
        raise RecordError(
            f'train: {error.filename or folder}: {disk_words(error)}; fix that, then resume it'
        ) from error


def _write(
    options: TrainOptions, material: TrainingData, fitted: Fitted, start: Model | None
) -> ModelCard:
    """Write weights, card and curves."""
    data = to_bytes(fitted.weights)
    card = ModelCard(
        architecture=options.architecture_name,
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
        patience=0,
        best_epoch=fitted.best_epoch,
        errors=_measure(options, fitted.weights, material.validation),
        weights_sha256=digest(data),
        package_version=__version__,
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        command_line=options.command_line,
        start_sha256=None if start is None else start.fingerprint,
        view=options.view,
        domain=joined_domains(
            [material.domain, *([] if start is None else [start.card.domain])]
        ),
    )
    save_model(options.out, data, card)
    _write_curves(options, fitted)
    if start is not None:
        _warn_if_worse(options, card, _measure(options, start.weights, material.validation))
    return card


def _warn_if_worse(
    options: TrainOptions, card: ModelCard, before: Mapping[str, Mapping[str, float]]
) -> None:
    """Warn if the network that the training began with errs less on the validation images."""
    worse = [
        f'{quantity} {before[quantity]["mae"]:.3g} before, {errors["mae"]:.3g} now'
        for quantity, errors in card.errors.items() if errors['mae'] > before[quantity]['mae']
    ]
    if worse:
        warn_once(
            f'train: on the validation images {options.start} errs less ({"; ".join(worse)}); take '
            'more images, or a lower learning rate'
        )


def _fit(
    options: TrainOptions, material: TrainingData, start: Model | None, progress: Progress
) -> Fitted:
    from taxinet_ros.training.fit import Recipe, fit  # imports torch, after checking options

    recipe = Recipe(
        epochs=options.epochs, batch=options.batch, learning_rate=options.learning_rate,
        seed=options.seed, augmented=options.augment,
        mirrored=options.augment and options.view is not None, device=options.device,
        workers=options.workers,
    )
    architecture = ARCHITECTURES[options.architecture_name]
    return fit(
        architecture, material.training, material.validation, recipe, progress,
        None if start is None else start.weights, options.unfinished / 'epochs.pt',
    )


def _measure(
    options: TrainOptions, weights: Weights, held_back: Dataset
) -> dict[str, dict[str, float]]:
    from taxinet_ros.core.perception.network import TaxiNet
    from taxinet_ros.training.accuracy import absolute_errors, error_statistics

    network = TaxiNet(ARCHITECTURES[options.architecture_name], weights)
    return error_statistics(absolute_errors(network, held_back))


def _write_curves(options: TrainOptions, fitted: Fitted) -> None:
    from taxinet_ros.training.learning_curves import learning_curves

    picture = learning_curves(fitted.history, fitted.best_epoch, options.out.stem)
    try:
        options.curves_path.write_bytes(picture)
        options.history_path.write_text(history_csv(fitted.history), encoding='utf-8')
    except OSError as error:
        raise UsageError(
            f'train: {options.curves_path.parent}: cannot be written ({error.strerror})'
        ) from error
