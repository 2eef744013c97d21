"""What searches have learned: kept as ``learned.json``, read back, and put together.

One search says little of how sure it is. Several that differ in their seed alone do: the spread of
what they learned is the sampler's own noise.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.search_space import Choice
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.plain_values import load_json

LEARNED_NAME = 'learned.json'

_SAME = ('program', 'program_sha256', 'sampler', 'perception', 'perception_sha256', 'overrides')


@dataclass(frozen=True, kw_only=True, slots=True)
class LearnedResult:
    """What one search has learned.

    Attributes:
        facts: of the search: its program, sampler, perception, seed and number of runs.
        choices: that it made.
        probabilities: of their bins, by name of the dimension.
    """

    facts: Mapping[str, Any]
    choices: tuple[Choice, ...]
    probabilities: Probabilities

    def to_json(self) -> str:
        """Text of ``learned.json``."""
        dimensions = [
            {**choice.to_json(), 'probabilities': list(self.probabilities[name])}
            for choice in self.choices if (name := choice.dimension.name) in self.probabilities
        ]
        values = {'facts': dict(self.facts), 'dimensions': dimensions}
        return json.dumps(values, indent=2, default=str) + '\n'

    @classmethod
    def read(cls, folder: Path) -> Self:
        """What the search in ``folder`` has learned.

        Raises:
            UsageError: nothing, or it cannot be read.
        """
        path = folder / LEARNED_NAME
        try:
            values = load_json(path.read_bytes())
            dimensions = values['dimensions']
            choices = tuple(Choice.from_json(dimension) for dimension in dimensions)
            return cls(
                facts=dict(values['facts']), choices=choices,
                probabilities={
                    choice.dimension.name: tuple(map(float, dimension['probabilities']))
                    for choice, dimension in zip(choices, dimensions, strict=True)
                },
            )
        except FileNotFoundError as error:
            raise UsageError(
                f'{path}: no such file; name the --out of a search with ce, ce-verifai or mab'
            ) from error
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise UsageError(f'{path}: cannot be read; --resume writes it anew') from error


class Spread(NamedTuple):
    """One number as several searches have it."""

    mean: float
    low: float
    high: float


class LearnedTogether:
    """What searches that differ in their seed alone have learned."""

    def __init__(self, results: Sequence[LearnedResult], folders: Sequence[Path]) -> None:
        """Put them together.

        Args:
            results: one or more.
            folders: where they are from, for messages.

        Raises:
            UsageError: they are not alike, or one is named twice.
        """
        first = results[0]
        for result, folder in zip(results, folders, strict=True):
            for name in _SAME:
                if result.facts.get(name) != first.facts.get(name):
                    raise UsageError(
                        f'{folder}: has another {name.replace("_", " ")} than {folders[0]}; only '
                        'searches that differ in their seed can be put together'
                    )
        seeds = [result.facts.get('seed') for result in results]
        twice = [str(seed) for seed in seeds if seeds.count(seed) > 1]
        if twice:
            raise UsageError(f'seed {twice[0]} is there twice; name each search once')
        self.results = tuple(results)
        self.choices = first.choices

    def bins(self, choice: Choice) -> list[Spread]:
        """Probability of each of a choice's bins: mean, least and greatest over the searches."""
        columns = zip(*(result.probabilities[choice.dimension.name] for result in self.results),
                      strict=True)
        return [_spread(column) for column in columns]

    @property
    def mean(self) -> Probabilities:
        """Mean probabilities of the bins, by name of the dimension."""
        return {
            choice.dimension.name: tuple(spread.mean for spread in self.bins(choice))
            for choice in self.choices
        }

    def choice(self, name: str) -> Choice:
        """The choice of this name.

        Raises:
            UsageError: nothing was learned of any such.
        """
        choices = {choice.dimension.name: choice for choice in self.choices}
        if name not in choices:
            raise UsageError(f'--within {name}: nothing was learned of it; known: '
                             f'{", ".join(choices)}')
        return choices[name]

    def within(self, name: str, low: float, high: float) -> Spread:
        """How probable values in [low, high] are.

        Raises:
            UsageError: no choice has that name, or it has no values to compare.
        """
        choice = self.choice(name)
        return _spread([
            choice.probability_within(low, high, result.probabilities[name])
            for result in self.results
        ])


def _spread(values: Sequence[float]) -> Spread:
    return Spread(mean=statistics.fmean(values), low=min(values), high=max(values))
