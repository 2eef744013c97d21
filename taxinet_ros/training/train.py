"""From a Scenic program to a weights file with its model card."""

from __future__ import annotations

import datetime
import math
import os
import shlex
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros import __version__
from taxinet_ros.campaign.programs import find_program, program_digest
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.network import ARCHITECTURES, DEFAULT_ARCHITECTURE
from taxinet_ros.core.weights import (
    SUFFIX,
    ModelCard,
    Weights,
    card_path,
    digest,
    save_model,
    to_bytes,
)
from taxinet_ros.training.dataset import Dataset, Progress, draw_scenes, make_dataset, silent

_LIMITS: dict[str, tuple[float, float]] = {
    'images': (1, 1_000_000),
    'validation': (1, 1_000_000),
    'epochs': (1, 10_000),
    'batch': (1, 65_536),
    'learning_rate': (1e-8, 1.0),
    'seed': (0, 2**63 - 1),
    'workers': (1, 256),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainOptions:
    """What to train on, how, and where the result goes; numbers are checked on construction.

    Attributes:
        program: word of a shipped Scenic program or path of one.
        out: weights file to write, ``NAME.safetensors``; its card becomes ``NAME.json``.
        images: pictures to train on, one per scene.
        validation: further scenes, held back to measure the errors on.
        epochs: times that every picture is seen.
        batch: pictures per step.
        learning_rate: the highest of the one-cycle schedule.
        seed: of everything random.
        workers: processes that render; the result does not depend on them.
        overwrite: whether existing files may be replaced.

    Raises:
        UsageError: a number is out of range.
    """

    program: str
    out: Path
    images: int = 12_000
    validation: int = 1_500
    epochs: int = 20
    batch: int = 64
    learning_rate: float = 3e-3
    seed: int = 1
    workers: int = 2
    overwrite: bool = False

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise UsageError(f'train: {name} is {value:g}, outside {low:g}..{high:g}')
        if self.batch > self.images:
            raise UsageError(f'train: a batch of {self.batch} is more than {self.images} images')

    @property
    def command_line(self) -> str:
        """The command that trains these weights, with every number that matters."""
        numbers = ('images', 'validation', 'epochs', 'batch', 'learning_rate', 'seed')
        words = ['taxinet', 'train', self.program]
        for name in numbers:
            words += [f'--{name.replace("_", "-")}', f'{getattr(self, name)}']
        return shlex.join([*words, '--out', self.out.name])


def train(options: TrainOptions, progress: Progress = silent) -> ModelCard:
    """Draw scenes, photograph them, fit a network, measure it, and write both files.

    Everything that can be wrong with the options is found before the work starts. Files appear
    at the end and whole; equal options give equal weights on one machine.

    Args:
        options: what to do.
        progress: told of the stages ``scenes``, ``images`` and ``epochs``.

    Returns:
        The card that was written.

    Raises:
        UsageError: options, program or folder cannot be used.
        InfraError: a worker process died, or the simulator failed.
    """
    check_out(options)
    program_sha256 = program_digest(find_program(options.program))
    dataset = _render(options, progress)
    weights = _fit(options, dataset.take(slice(options.images)), progress)
    data = to_bytes(weights)
    card = ModelCard(
        architecture=DEFAULT_ARCHITECTURE,
        program=Path(options.program).stem,
        program_sha256=program_sha256,
        seed=options.seed,
        images=options.images,
        validation=options.validation,
        epochs=options.epochs,
        batch=options.batch,
        learning_rate=options.learning_rate,
        errors=_measure(weights, dataset.take(slice(options.images, None))),
        weights_sha256=digest(data),
        package_version=__version__,
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        command_line=options.command_line,
    )
    save_model(options.out, data, card)
    return card


def check_out(options: TrainOptions) -> None:
    """See that the result can be written, before hours go into it.

    Raises:
        UsageError: wrong suffix, no such folder, not writable, or there already.
    """
    out = options.out
    if out.suffix != SUFFIX:
        raise UsageError(f'train: --out {out}: has to end in {SUFFIX}')
    if not out.parent.is_dir():
        raise UsageError(f'train: --out {out}: {out.parent} is no folder; make it first')
    if not os.access(out.parent, os.W_OK | os.X_OK):
        raise UsageError(f'train: --out {out}: {out.parent} cannot be written to')
    for path in (out, card_path(out)):
        if path.is_dir() or (path.exists() and not options.overwrite):
            raise UsageError(f'train: --out {path}: exists; name another file or say --overwrite')


def _render(options: TrainOptions, progress: Progress) -> Dataset:
    images = options.images + options.validation
    scenes = draw_scenes(options.program, seed=options.seed, images=images, progress=progress)
    return make_dataset(scenes, workers=options.workers, progress=progress)


def _fit(options: TrainOptions, training: Dataset, progress: Progress) -> Weights:
    from taxinet_ros.training.fit import fit  # imports torch, which bad options should not wait for

    return fit(
        ARCHITECTURES[DEFAULT_ARCHITECTURE],
        training,
        epochs=options.epochs,
        batch=options.batch,
        learning_rate=options.learning_rate,
        seed=options.seed,
        progress=progress,
    )


def _measure(weights: Weights, held_back: Dataset) -> dict[str, dict[str, float]]:
    from taxinet_ros.core.network import TaxiNet
    from taxinet_ros.training.evaluate import absolute_errors, statistics

    network = TaxiNet(ARCHITECTURES[DEFAULT_ARCHITECTURE], weights)
    return statistics(absolute_errors(network, held_back))
