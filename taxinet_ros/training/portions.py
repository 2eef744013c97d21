"""Pictures added to a training set, as people ask for them: ``crossing=2400``.

The paper's iterative retraining adds 20 % of one kind to a set (Appendix A): of a Scenic program,
handwritten or learned, or counterexamples of falsification.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from taxinet_ros.campaign.programs import find_program, program_digest
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.model_card import Source
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.training.counterexample_scenes import counterexample_scenes, ledger_digest
from taxinet_ros.training.dataset import Progress, draw_scenes

MOST = 1_000_000
"""Pictures of one portion."""

_PORTIONS = 3
"""Tells the random numbers of portions from others of the same seed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Portion:
    """So many pictures of one origin.

    Attributes:
        kind: ``program`` for scenes of a Scenic program, ``runs`` for places on the way of a
            campaign's failed runs.
        name: word or path of the program, or path of the campaign's folder.
        count: pictures to train on.
    """

    kind: Literal['program', 'runs']
    name: str
    count: int

    def __str__(self) -> str:
        return f'{self.name}={self.count}'

    def scenes(self, count: int, seed: int, progress: Progress) -> list[Scenario]:
        """As many scenes of this origin.

        Raises:
            UsageError: there is no such program or campaign, or it has nothing to give.
        """
        if self.kind == 'program':
            return draw_scenes(self.name, seed=seed, images=count, progress=progress)
        return counterexample_scenes(Path(self.name), count, seed, progress)

    def source(self) -> Source:
        """What a model card says of it."""
        if self.kind == 'program':
            return program_source(self.name)
        folder = Path(self.name)
        return Source(kind='runs', name=folder.resolve().name, sha256=ledger_digest(folder))


def program_source(program: str) -> Source:
    """What a model card says of a Scenic program, given by word or path."""
    path = find_program(program)
    return Source(kind='program', name=path.stem, sha256=program_digest(path))


def parse_portion(text: str, kind: Literal['program', 'runs']) -> Portion:
    """Read ``NAME=COUNT``.

    Raises:
        UsageError: it is not of that form, or the count is out of range.
    """
    option = '--add' if kind == 'program' else '--add-runs'
    name, equals, number = text.rpartition('=')
    if not (equals and name and number.isdecimal()):
        what = 'PROGRAM' if kind == 'program' else 'CAMPAIGN'
        raise UsageError(f'train: {option} {text!r}: not {what}=COUNT, such as crossing=2400')
    if not 1 <= int(number) <= MOST:
        raise UsageError(f'train: {option} {text!r}: the count is outside 1..{MOST}')
    return Portion(kind=kind, name=name, count=int(number))


def portion_seed(seed: int, number: int) -> int:
    """Seed of a portion's scenes: the program may be the one that the set itself is drawn from."""
    drawn = np.random.SeedSequence([seed, _PORTIONS, number]).generate_state(1, np.uint64)
    return int(drawn[0] >> 1)
