"""Models, frames and files for the tests of network, weights, perception and training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.perception.network import ARCHITECTURES, DEFAULT_ARCHITECTURE, IMAGE_SHAPE
from taxinet_ros.core.perception.weights import (
    ERROR_STATISTICS,
    ModelCard,
    Source,
    digest,
    save_model,
    to_bytes,
)


def random_weights(seed: int = 0) -> dict[str, NDArray[np.float32]]:
    rng = np.random.default_rng(seed)
    shapes = ARCHITECTURES[DEFAULT_ARCHITECTURE].shapes()
    return {
        name: rng.normal(0, 0.05, shape).astype(np.float32) for name, shape in shapes.items()
    }


def frame(seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, IMAGE_SHAPE, np.uint8)


def card_of(data: bytes) -> ModelCard:
    row = dict.fromkeys(ERROR_STATISTICS, 0.25)
    return ModelCard(
        architecture=DEFAULT_ARCHITECTURE,
        training_data=(Source(kind='program', name='nominal', sha256='0' * 64),),
        validation_data=(),
        seed=1,
        images=10,
        validation=5,
        varied=False,
        augment=False,
        epochs=2,
        batch=4,
        learning_rate=1e-3,
        patience=0,
        best_epoch=2,
        errors={'cte_m': row, 'he_deg': row},
        weights_sha256=digest(data),
        package_version='0.1.0',
        date='2026-01-31',
        command_line='taxinet train nominal',
    )


def save_sample(folder: Path, weights: dict[str, NDArray[np.float32]] | None = None) -> Path:
    data = to_bytes(random_weights() if weights is None else weights)
    path = folder / 'net.safetensors'
    save_model(path, data, card_of(data))
    return path
