"""Fitting the network's weights to a dataset."""

from __future__ import annotations

import io
import math
import os
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import smooth_l1_loss

from taxinet_ros.core.perception.network import Architecture, normalise, scaled, unscaled
from taxinet_ros.core.perception.weights import Weights
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.training.accuracy import Epoch
from taxinet_ros.training.data.augmentation import augment
from taxinet_ros.training.data.dataset import Dataset, Progress, no_progress
from taxinet_ros.training.torch_network import (
    build_with_batch_norm,
    fold_batch_norm,
    unfold_batch_norm,
)

_WARM_UP = 0.1
"""Share of all steps in which the learning rate rises, before it falls to zero."""

_ROUND_BELOW = 0.05
"""Huber threshold: larger errors count linearly, so that unusable pictures do not dominate."""

_MEASURED_AT_ONCE = 256
"""Validation pictures per pass through the network."""

_AHEAD = 4
"""Batches per thread that are made ahead."""

_Batch = tuple[torch.Tensor, torch.Tensor]
"""Inputs of the network and its targets."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Recipe:
    """Hyperparameters of a training.

    Attributes:
        epochs: number of passes over all pictures.
        batch: pictures per step; an incomplete last batch is skipped in that epoch.
        learning_rate: maximum learning rate.
        seed: seed of the initial weights, of the order of the pictures, and of their augmentation.
        augmented: whether every picture is augmented in each epoch.
        mirrored: whether half of the pictures are mirrored, with their errors, in each epoch; for
            pictures of an eye, which has no side.
        device: where to compute, a word of torch's that is available.
        workers: threads that augment; weights do not depend on it.
    """

    epochs: int
    batch: int
    learning_rate: float
    seed: int
    augmented: bool = False
    mirrored: bool = False
    device: str = 'cpu'
    workers: int = 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fitted:
    """Result of a training.

    Attributes:
        weights: weights by name, of the epoch with the lowest validation loss.
        history: all epochs in order.
        best_epoch: number of the epoch of these weights.
    """

    weights: dict[str, NDArray[np.float32]]
    history: tuple[Epoch, ...]
    best_epoch: int


def fit(
    architecture: Architecture,
    training: Dataset,
    validation: Dataset,
    recipe: Recipe,
    progress: Progress = no_progress,
    start: Weights | None = None,
    kept: Path | None = None,
) -> Fitted:
    """Train a network with AdamW and a one-cycle learning rate schedule.

    One thread of torch and seeded generators make it deterministic: on one machine and device, the
    same arguments give bit-identical weights. The number of torch's threads, and on a GPU the
    choice of deterministic kernels, are set in the whole process.

    Args:
        architecture: architecture of the network.
        training: training pictures and true errors.
        validation: other pictures, by which the epoch is chosen.
        recipe: hyperparameters.
        progress: called after every epoch.
        start: initial weights; None for random ones.
        kept: file of the state after the last epoch, from which the training goes on if it exists;
            written after every epoch. The result is the same to the bit.

    Raises:
        UsageError: the loss is not finite; a lower learning rate helps.
        OSError: ``kept`` cannot be read or written.
    """
    torch.set_num_threads(1)
    if recipe.device != 'cpu':
        os.environ.setdefault('CUBLAS_WORKSPACE_CONFIG', ':4096:8')  # asked for by the next line
        torch.use_deterministic_algorithms(True)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(recipe.seed)
        trainer = _Trainer(architecture, training, validation, recipe, start)
        history: list[Epoch] = []
        best = 0
        if kept is not None and kept.exists():
            # Plain values and tensors, no code.
            before = torch.load(kept, weights_only=True, map_location='cpu')
            history = [Epoch(**epoch) for epoch in before['history']]
            best, weights = before['best'], {k: v.numpy() for k, v in before['weights'].items()}
            trainer.restore(before['state'])
        while len(history) < recipe.epochs:
            number = len(history) + 1
            history.append(trainer.epoch(number))
            if number == 1 or history[-1].validation_loss < history[best - 1].validation_loss:
                best = number
                weights = trainer.weights()
            if kept is not None:
                data = io.BytesIO()
                torch.save({
                    'state': trainer.state(), 'history': [asdict(epoch) for epoch in history],
                    'best': best, 'weights': {k: torch.from_numpy(v) for k, v in weights.items()},
                }, data)
                write_atomically(kept, data.getvalue())
            progress('epochs', number, recipe.epochs)
    return Fitted(weights=weights, history=tuple(history), best_epoch=best)


class _Trainer:
    """A network in training, with all state."""

    def __init__(
        self, architecture: Architecture, training: Dataset, validation: Dataset, recipe: Recipe,
        start: Weights | None,
    ) -> None:
        network = build_with_batch_norm(architecture)
        if start is not None:
            some = np.linspace(0, len(training) - 1, min(len(training), _MEASURED_AT_ONCE))
            unfold_batch_norm(
                network, start, torch.from_numpy(normalise(training.pictures[some.astype(int)]))
            )
        # The annotations of Module.to omit the memory format.
        self._network = network.to(recipe.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._training = training
        self._targets = torch.from_numpy(scaled(training.cte_m, training.he_rad))
        self._validation = validation
        self._recipe = recipe
        self._steps = max(1, len(training) // recipe.batch)
        self._order = np.random.default_rng(recipe.seed)
        rate, steps = recipe.learning_rate, recipe.epochs * self._steps
        self._optimiser = torch.optim.AdamW(self._network.parameters(), lr=rate, weight_decay=0.01)
        self._schedule = torch.optim.lr_scheduler.OneCycleLR(
            self._optimiser, max_lr=rate, total_steps=steps,
            # torch divides by the steps of the rise less one, which of ten is zero.
            pct_start=_WARM_UP if steps != 10 else 2 * _WARM_UP,
        )

    def epoch(self, number: int) -> Epoch:
        """Train on every picture once, then validate."""
        self._network.train()
        losses = [self._step(*batch) for batch in self._batches(number)]
        validation_loss, cte_mae_m, he_mae_rad = self._measure()
        if not math.isfinite(validation_loss):
            raise UsageError(
                f'train: the loss is {validation_loss} after epoch {number}; lower the learning '
                f'rate from {self._recipe.learning_rate:g}'
            )
        return Epoch(
            number=number,
            learning_rate=self._rate,
            training_loss=sum(losses) / len(losses),
            validation_loss=validation_loss,
            cte_mae_m=cte_mae_m,
            he_mae_deg=math.degrees(he_mae_rad),
        )

    def state(self) -> dict[str, Any]:
        """All that changes from epoch to epoch, as plain values and tensors."""
        return {
            'network': self._network.state_dict(), 'optimiser': self._optimiser.state_dict(),
            'schedule': self._schedule.state_dict(), 'order': self._order.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a :meth:`state` of a trainer with the same arguments."""
        self._network.load_state_dict(state['network'])
        self._optimiser.load_state_dict(state['optimiser'])
        self._schedule.load_state_dict(state['schedule'])
        self._order.bit_generator.state = state['order']

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """The current weights, for the plain architecture."""
        return fold_batch_norm(self._network)

    def _batches(self, number: int) -> Iterator[_Batch]:
        """Batches of an epoch in its order; threads make some of them ahead."""
        kept = self._steps * self._recipe.batch
        order = self._order.permutation(len(self._training))[:kept]
        ahead: deque[Future[_Batch]] = deque()
        with ThreadPoolExecutor(self._recipe.workers) as threads:
            for step, rows in enumerate(np.array_split(order, self._steps)):
                # Of each batch its own: neither the order nor other batches depend on augmentation.
                chance = np.random.default_rng([self._recipe.seed, 1, number, step])
                ahead.append(threads.submit(self._batch, rows, chance))
                if len(ahead) > _AHEAD * self._recipe.workers:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()

    def _batch(self, rows: NDArray[np.int64], chance: np.random.Generator) -> _Batch:
        pictures, targets = self._training.pictures[rows], self._targets[rows]
        if self._recipe.augmented:
            pictures = augment(pictures, chance)
        if self._recipe.mirrored:
            other = chance.random(len(rows)) < 0.5
            pictures = np.where(other[:, np.newaxis, np.newaxis], pictures[:, :, ::-1], pictures)
            targets = torch.where(torch.from_numpy(other)[:, None], -targets, targets)
        return torch.from_numpy(normalise(pictures)), targets

    def _step(self, seen: torch.Tensor, targets: torch.Tensor) -> float:
        loss = _loss(self._answers(seen), targets.to(self._recipe.device))
        self._optimiser.zero_grad()
        loss.backward()
        self._rate = self._optimiser.param_groups[0]['lr']
        self._optimiser.step()
        self._schedule.step()
        return loss.item()

    def _answers(self, seen: torch.Tensor) -> torch.Tensor:
        seen = seen.to(self._recipe.device, memory_format=torch.channels_last)
        answers: torch.Tensor = self._network(seen)
        return answers

    def _measure(self) -> tuple[float, float, float]:
        """Loss on the validation pictures and mean absolute errors [m], [rad]."""
        pictures = self._validation.pictures
        starts = range(0, len(pictures), _MEASURED_AT_ONCE)
        self._network.eval()
        with torch.inference_mode():
            parts = [
                self._answers(torch.from_numpy(normalise(pictures[s : s + _MEASURED_AT_ONCE])))
                for s in starts
            ]
            answers = torch.cat(parts).cpu()
            truth = scaled(self._validation.cte_m, self._validation.he_rad)
            loss = _loss(answers, torch.from_numpy(truth)).item()
        cte_m, he_rad = np.abs(unscaled(answers.numpy()) - unscaled(truth)).mean(axis=0)
        return loss, float(cte_m), float(he_rad)


def _loss(answers: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    return smooth_l1_loss(answers, targets, beta=_ROUND_BELOW)
