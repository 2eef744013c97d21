"""The numbers of a case study, and how a smaller one is made of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

from taxinet_ros.core.errors import UsageError

LEAST_IMAGES, LEAST_VALIDATION, LEAST_EPOCHS = 128, 32, 2
LEAST_RUNS, LEAST_LOCALIZED, LEAST_PAIRS = 20, 5, 10

_ALL_EPOCHS_FROM = 0.1
"""Scale from which a network gets all its epochs: fewer would be another training, not less."""

_LARGEST_SCALE = 100.0


@dataclass(frozen=True, kw_only=True)
class StudyConfig:
    """One case study, as it is run.

    Attributes:
        images, validation, epochs: of every training.
        training_seed: of scenes, first weights and order.
        original, generic, specialised: programs that the networks of these names learn from; a
            shipped word or the path of one.
        program: whose scenes every network is evaluated on.
        runs: how many of them.
        seed: of these scenes.
        localized: failed runs of the original network that are run again on the true state.
        experiments: scenes by the word or file of the experiment.
        learning_program, learning_runs: of every search for the distribution of the generic
            network's failures.
        samplers, learning_seeds: there is a search for each two; further training adds what the
            first one has learned.
        further_epochs: of training the generic network on.
        share: of images that are added then.
        crossing: program of the images at the crossing.
        best: perception word or file of one more network to evaluate, or ''.
        workers: processes that work at once; results do not depend on them.
        scale: what the sizes were multiplied with, for people to read.
    """

    images: int
    validation: int
    epochs: int
    training_seed: int
    original: str
    generic: str
    specialised: str
    program: str
    runs: int
    seed: int
    localized: int
    learning_program: str
    samplers: tuple[str, ...]
    learning_runs: int
    learning_seeds: tuple[int, ...]
    further_epochs: int
    share: float
    crossing: str
    experiments: Mapping[str, int] = field(default_factory=dict)
    best: str = ''
    workers: int = 2
    scale: float = 1.0

    @property
    def added(self) -> int:
        """Images that are added for further training."""
        return max(1, round(self.share * self.images))


def scaled(config: StudyConfig, scale: float) -> StudyConfig:
    """A study of another size.

    Images and runs are multiplied, down to what a smoke run needs. Epochs stay as they are, but in
    the smallest studies.

    Raises:
        UsageError: no such scale.
    """
    if not 0 < scale <= _LARGEST_SCALE:
        raise UsageError(f'--scale {scale:g}: needs to be above 0, at most {_LARGEST_SCALE:g}')
    if scale == 1:
        return config

    def size(value: int, least: int) -> int:
        return max(round(scale * value), min(value, least))

    def epochs(value: int) -> int:
        part = min(1.0, scale / _ALL_EPOCHS_FROM)
        return max(round(part * value), min(value, LEAST_EPOCHS))

    return dataclasses.replace(
        config, scale=scale * config.scale,
        images=size(config.images, LEAST_IMAGES),
        validation=size(config.validation, LEAST_VALIDATION),
        epochs=epochs(config.epochs), further_epochs=epochs(config.further_epochs),
        runs=size(config.runs, LEAST_RUNS), learning_runs=size(config.learning_runs, LEAST_RUNS),
        localized=size(config.localized, LEAST_LOCALIZED),
        experiments={name: size(runs, LEAST_PAIRS) for name, runs in config.experiments.items()},
    )


def resized(
    config: StudyConfig, *, runs: int | None, images: int | None, workers: int | None
) -> StudyConfig:
    """The study with sizes that were asked for outright.

    Args:
        config: the study.
        runs: on which every network is evaluated, or None.
        images: of every training, or None; as large a share of them is held back as before.
        workers: processes that work at once, or None.
    """
    if runs is not None:
        config = dataclasses.replace(config, runs=runs)
    if images is not None:
        held_back = max(1, round(images * config.validation / config.images))
        config = dataclasses.replace(config, images=images, validation=held_back)
    if workers is not None:
        config = dataclasses.replace(config, workers=workers)
    return config
