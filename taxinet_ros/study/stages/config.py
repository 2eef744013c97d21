"""Configuration of a case study: validate, scale and read.

Every error message is one line with the file, the key, and the expected value.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, expected, is_number, read_yaml
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.scenes.programs import find_program, shipped_folder
from taxinet_ros.trials.experiment import find_experiment

LEAST_IMAGES, LEAST_VALIDATION, LEAST_EPOCHS = 128, 32, 2
LEAST_RUNS, LEAST_LOCALIZED, LEAST_PAIRS = 20, 5, 10
_ALL_EPOCHS_FROM = 0.1
"""Scale from which a network gets all its epochs; with fewer the training would differ."""
_LARGEST_SCALE = 100.0


@dataclass(frozen=True, kw_only=True)
class StudyConfig:
    """Configuration of a case study.

    Attributes:
        images, validation, epochs: values for every training.
        training_seed: seed of scenes, initial weights and order.
        original, generic, specialised: training programs of the networks of these names, each a
            shipped word or a path.
        program: program on whose scenes every network is evaluated.
        runs: number of these scenes.
        seed: seed of these scenes.
        localized: number of failed runs of the original network to rerun on the true state.
        experiments: number of scenes by word or file of the experiment.
        learning_program, learning_runs: values for every search for the distribution of the generic
            network's failures.
        samplers, learning_seeds: there is one search for each combination; further training adds
            scenes of the distribution learned by the first one by the paper's rule.
        further_epochs: epochs of the generic network's further training.
        share: share of images added in it.
        crossing: program of the images at the crossing.
        best: perception word or file of another network to evaluate, or ''.
        workers: number of concurrent processes; results do not depend on it.
        scale: factor by which the sizes were multiplied, for information.
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
        """Number of images added for further training."""
        return max(1, round(self.share * self.images))


def scaled(config: StudyConfig, scale: float) -> StudyConfig:
    """Scale the size of a study.

    Images and runs are multiplied, with the minimum that a smoke run needs. Epochs only change in
    the smallest studies.

    Raises:
        UsageError: the scale is out of range.
    """
    if not 0 < scale <= _LARGEST_SCALE:
        raise UsageError(f'scale {scale:g}: needs to be above 0, at most {_LARGEST_SCALE:g}')
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


SHIPPED = 'case_study.yaml'
_LEARNERS = ('ce', 'ce-verifai', 'mab')
"""Samplers that write a learned distribution as a program."""
_MOST_SHARE = 10
_MOST_SEED = 2**63 - 1


def shipped_config() -> Path:
    """Path of the shipped study: that of the paper, with its sizes."""
    return shipped_folder() / SHIPPED


def read_config(path: Path) -> StudyConfig:
    """Read a user's study file; the shipped one provides the default values.

    Raises:
        UsageError: a value is invalid; one line with the file, the key and the correction.
    """
    shipped, own = read_yaml(shipped_config()), read_yaml(path, option='config')
    config = StudyConfig(**{**_values(shipped_config(), shipped), **_values(path, own)})
    _check_seeds(Section(path, own), config)
    return config


def _values(path: Path, content: object) -> dict[str, Any]:
    """Values of a file, checked one by one, by attribute name of :class:`StudyConfig`."""
    places: dict[str, list[str]] = {}
    for place, _ in _READERS.values():
        group, _, key = place.rpartition('.')
        places.setdefault(group, []).append(key)
    top = Section(path, content, sorted({*places, *places['']} - {''}))
    sections = {'': top} | {
        group: top.section(group, sorted(keys)) for group, keys in places.items() if group in top
    }
    found: dict[str, Any] = {}
    for name, (place, read) in _READERS.items():
        group, _, key = place.rpartition('.')
        if key in sections.get(group, ()):
            found[name] = read(sections[group], key)
    return found


def _check_seeds(given: Section, config: StudyConfig) -> None:
    """Check that no network is evaluated, and no search starts, on its training scenes."""
    seeds = {
        'training.seed': (config.training_seed,), 'evaluation.seed': (config.seed,),
        'learning.seed': config.learning_seeds,
    }
    for place, own in seeds.items():
        for other, others in seeds.items():
            for seed in own if other < place else ():
                if seed in others:
                    raise given.wrong(
                        f'is {seed}, as {other} is; choose another, or a network is evaluated '
                        'on scenes it was trained on', place,
                    )


def _whole(low: int, high: int) -> Callable[[Section, str], int]:
    return lambda given, key: given.whole(key, low, high)


def _program(given: Section, key: str) -> str:
    word = _beside(given, given.text(key))
    given.check(key, partial(find_program, word))
    return word


def _experiments(given: Section, key: str) -> dict[str, int]:
    names = given.section(key, optional=True)
    found = {}
    for name in names:
        word = _beside(given, name)
        names.check(name, partial(find_experiment, word))
        found[word] = names.whole(name, 1, 1_000_000)
    stems = [Path(word).stem for word in found]
    if len(set(stems)) < len(stems):
        raise names.wrong('two experiments have the same name; rename one of the files')
    return found


def _best(given: Section, key: str) -> str:
    if given.take(key, 'a word') in ('', None):
        return ''
    word = _beside(given, given.text(key))
    given.check(key, partial(check_perception, word))
    return word


def _beside(given: Section, word: str) -> str:
    """Absolute path of a file next to the study's or in the current folder; else the word."""
    if Path(word).suffix:
        for path in (given.path.parent / word, Path(word)):
            if path.is_file():
                return str(path.resolve())
    return word


def _samplers(given: Section, key: str) -> tuple[str, ...]:
    words = tuple(one.text(key) for one in given.several(key))
    for word in words:
        if word not in _LEARNERS:
            what = f'expected a sampler that learns a distribution ({", ".join(_LEARNERS)})'
            raise given.wrong(f'{what}, got {word}', key)
    return words


def _learning_seeds(given: Section, key: str) -> tuple[int, ...]:
    return tuple(one.whole(key, 0, _MOST_SEED) for one in given.several(key))


def _share(given: Section, key: str) -> float:
    kind = f'a number above 0, at most {_MOST_SHARE}'
    value = given.take(key, kind)
    if not is_number(value, 0, _MOST_SHARE) or value == 0:
        raise given.wrong(expected(kind, value), key)
    return float(value)


_READERS: Mapping[str, tuple[str, Callable[[Section, str], object]]] = {
    'images': ('training.images', _whole(1, 1_000_000)),
    'validation': ('training.validation', _whole(1, 1_000_000)),
    'epochs': ('training.epochs', _whole(1, 10_000)),
    'training_seed': ('training.seed', _whole(0, _MOST_SEED)),
    'original': ('training.original', _program),
    'generic': ('training.generic', _program),
    'specialised': ('training.specialised', _program),
    'program': ('evaluation.program', _program),
    'runs': ('evaluation.runs', _whole(1, 10_000_000)),
    'seed': ('evaluation.seed', _whole(0, _MOST_SEED)),
    'localized': ('debugging.localize', _whole(1, 10_000_000)),
    'experiments': ('debugging.experiments', _experiments),
    'learning_program': ('learning.program', _program),
    'samplers': ('learning.sampler', _samplers),
    'learning_runs': ('learning.runs', _whole(1, 10_000_000)),
    'learning_seeds': ('learning.seed', _learning_seeds),
    'further_epochs': ('iteration.epochs', _whole(1, 10_000)),
    'share': ('iteration.share', _share),
    'crossing': ('iteration.crossing', _program),
    'best': ('best', _best),
    'workers': ('workers', _whole(1, LAG)),
}
"""Place in a file and reader of each value."""
