"""Fitting the network's weights to a dataset."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import smooth_l1_loss

from taxinet_ros.core.network import Architecture, normalise, scaled
from taxinet_ros.training.dataset import Dataset, Progress, silent

_WARM_UP = 0.1
"""Share of all steps in which the learning rate rises, before it falls to nothing."""

_ROUND_BELOW = 0.05
"""Errors below it count squared, above it in proportion: hopeless pictures must not dominate."""


def fit(
    architecture: Architecture,
    dataset: Dataset,
    *,
    epochs: int,
    batch: int,
    learning_rate: float,
    seed: int,
    progress: Progress = silent,
    losses: list[float] | None = None,
) -> dict[str, NDArray[np.float32]]:
    """Train a fresh network, by AdamW under one cycle of the learning rate.

    One thread and seeded generators make it repeatable: on one machine, the same arguments give
    the same weights to the bit. The number of threads holds for all of torch in this process.

    Args:
        architecture: of the network.
        dataset: pictures and true errors to learn.
        epochs: times that every picture is seen.
        batch: pictures per step; a rest that does not fill one sits the epoch out.
        learning_rate: the highest.
        seed: of the first weights and of the order of the pictures.
        progress: told after every epoch.
        losses: gets the mean loss of each epoch appended.

    Returns:
        The weights by name.
    """
    torch.set_num_threads(1)
    order = np.random.default_rng(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = architecture.build().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    inputs = dataset.pictures
    targets = torch.from_numpy(scaled(dataset.cte_m, dataset.he_rad))
    steps = max(1, len(dataset) // batch)
    optimiser = torch.optim.AdamW(network.parameters(), lr=learning_rate, weight_decay=0.01)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, max_lr=learning_rate, total_steps=epochs * steps, pct_start=_WARM_UP
    )
    for epoch in range(epochs):
        total = 0.0
        for rows in np.array_split(order.permutation(len(dataset))[: steps * batch], steps):
            seen = torch.from_numpy(normalise(inputs[rows]))
            answers = network(seen.to(memory_format=torch.channels_last))
            loss = smooth_l1_loss(answers, targets[rows], beta=_ROUND_BELOW)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.item()
        if losses is not None:
            losses.append(total / steps)
        progress('epochs', epoch + 1, epochs)
    return {name: value.contiguous().numpy() for name, value in network.state_dict().items()}
