"""Options of ``taxinet improve``, validated before any work."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from taxinet_ros import registry
from taxinet_ros.core.perception.weights import load_model, weights_path
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import SAMPLERS
from taxinet_ros.scenes.programs import find_program, known_programs
from taxinet_ros.training.data.portions import parse_portion

_LIMITS: dict[str, tuple[float, float]] = {
    'rounds': (1, 100), 'budget': (6, 10_000_000), 'images': (1, 1_000_000),
    'validation': (1, 1_000_000), 'counterexamples': (1, 1_000_000), 'epochs': (1, 10_000),
    'learning_rate': (1e-8, 1.0), 'alpha': (1e-6, 0.5), 'margin': (1e-4, 0.5),
    'place_margin': (1e-4, 0.5), 'seed': (0, 10**12), 'workers': (1, 64),
}

COMMAND = 'improve'
"""The command, by which a record names its study."""
FALSIFY, TRAIN, JUDGE = range(3)
"""Purposes of a seed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ImproveOptions:
    """Options of the improvement loop; checked on construction.

    Attributes:
        program: Scenic program on which the network is improved.
        start: word or weights file of the initial network.
        rounds: maximum number of rounds.
        budget: runs of all rounds together; one third each for searching failures and for judging
            the old and the new network.
        base: program whose pictures are learned with the counterexamples, to prevent forgetting.
        images: number of pictures of that program in every round.
        validation: number of held-out pictures, to choose the epoch.
        counterexamples: pictures along failed runs, per round so far.
        add: further pictures as ``PROGRAM=COUNT``.
        epochs, learning_rate: values for every training.
        varied: whether the look of the rendered world varies.
        sampler: sampler of the search for failures.
        alpha: probability, in each round, of accepting a network that is no better, or worse by a
            margin.
        margin: tolerated increase of the failure rate over all scenes.
        place_margin: the same in a part of them.
        seed: base seed; the seeds of different purposes never coincide.
        workers: number of processes; results do not depend on it.

    Raises:
        UsageError: a number is out of range, or a word is not known.
    """

    program: str = 's_falsif'
    start: str = 'taxinet'
    rounds: int = 3
    budget: int = 3600
    base: str = 'training_full'
    images: int = 12_000
    validation: int = 1_500
    counterexamples: int = 4_000
    add: tuple[str, ...] = ()
    epochs: int = 8
    learning_rate: float = 1e-3
    varied: bool = False
    sampler: str = 'ce'
    alpha: float = 0.05
    margin: float = 0.01
    place_margin: float = 0.05
    seed: int = 1
    workers: int = 2

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise UsageError(f'improve: {name} is {value:g}, outside {low:g}..{high:g}')
        if self.sampler not in SAMPLERS:
            known = registry.known(registry.SAMPLERS)
            raise UsageError(f'improve: sampler {self.sampler!r} is unknown; known: {known}')
        if self.runs < 2:
            raise UsageError(
                f'improve: --budget {self.budget} leaves {self.runs} runs for each of the three '
                f'campaigns of {self.rounds} rounds; ask for more runs or fewer rounds'
            )

    @property
    def runs(self) -> int:
        """Runs of each of the three campaigns of a round."""
        return self.budget // (3 * self.rounds)

    def checked(self) -> Self:
        """The same with absolute program paths, since the stages run in another folder.

        Raises:
            UsageError: a program or the network cannot be used.
        """
        load_model(self.start_path)
        added = [parse_portion(text, 'program') for text in self.add]
        return replace(
            self, program=_absolute_program(self.program), base=_absolute_program(self.base),
            add=tuple(str(replace(one, name=_absolute_program(one.name))) for one in added),
        )

    @property
    def start_path(self) -> Path:
        """The initial weights file."""
        return weights_path(self.start)

    def seed_of(self, number: int, purpose: int) -> int:
        """Seed for one purpose in a round."""
        return 100_000 * (self.seed + 1) + 10 * number + purpose


def _absolute_program(program: str) -> str:
    """A program's word, or its path made absolute."""
    path = find_program(program)
    return program if program in known_programs() else str(path.resolve())
