"""Networks in the .nnet format, made here, and their sums in the plainest words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

TINY = (128, 16, 8, 8, 2)
"""Sizes of the public TinyTaxiNet."""


@dataclass
class Sample:
    """What a file says; change it, then write it."""

    sizes: tuple[int, ...]
    low: list[float]
    high: list[float]
    means: list[float]
    ranges: list[float]
    weights: list[np.ndarray]
    biases: list[np.ndarray]

    def text(self, comments: Sequence[str] = ('// a sample', '// in two lines')) -> str:
        def line(values: Any) -> str:
            return ','.join(repr(float(value)) for value in values) + ','

        header = (len(self.sizes) - 1, self.sizes[0], self.sizes[-1], max(self.sizes))
        lines = [
            *comments, ','.join(map(str, header)) + ',', ','.join(map(str, self.sizes)) + ',', '0,',
            line(self.low), line(self.high), line(self.means), line(self.ranges),
        ]
        for weights, biases in zip(self.weights, self.biases, strict=True):
            lines += [line(row) for row in weights] + [line([bias]) for bias in biases]
        return '\n'.join(lines) + '\n'

    def answer(self, inputs: Sequence[float]) -> list[float]:
        """One answer, a number at a time, as the format's description has it."""
        layer = []
        for value, low, high, mean, reach in zip(
            inputs, self.low, self.high, self.means, self.ranges, strict=False
        ):
            layer.append((min(max(value, low), high) - mean) / reach)
        for number, (weights, biases) in enumerate(zip(self.weights, self.biases, strict=True)):
            sums = [
                sum(float(weight) * value for weight, value in zip(row, layer, strict=True)) + bias
                for row, bias in zip(weights.tolist(), biases.tolist(), strict=True)
            ]
            last = number == len(self.weights) - 1
            layer = sums if last else [max(value, 0.0) for value in sums]
        return [value * self.ranges[-1] + self.means[-1] for value in layer]


def sample(sizes: tuple[int, ...] = TINY, seed: int = 0, *, plain: bool = False) -> Sample:
    """A network with random weights; ``plain``: without normalisation, as the public one."""
    rng = np.random.default_rng(seed)
    inputs = sizes[0]
    pairs = list(zip(sizes[1:], sizes[:-1], strict=True))
    return Sample(
        sizes=sizes,
        low=[0.0] * inputs if plain else rng.uniform(-1.0, 0.1, inputs).tolist(),
        high=[1.0] * inputs if plain else rng.uniform(0.6, 2.0, inputs).tolist(),
        means=[0.0] * (inputs + 1) if plain else rng.normal(0.3, 0.2, inputs + 1).tolist(),
        ranges=[1.0] * (inputs + 1) if plain else rng.uniform(0.5, 3.0, inputs + 1).tolist(),
        weights=[rng.normal(0, 1.5 / np.sqrt(before), (size, before)) for size, before in pairs],
        biases=[rng.normal(0, 0.5, size) for size, _ in pairs],
    )
