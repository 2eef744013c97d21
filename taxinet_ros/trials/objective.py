"""What a search minimises if it has several requirements: a rulebook, or the least of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import BY_SIZE, SAMPLERS

_BELOW = 0.1
"""Weight of a level of a rulebook, relative to the level above it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Objective:
    """Requirements in the order of their importance (a rulebook; Censi et al., ICRA 2019).

    Attributes:
        text: as given, such as ``no_collision > on_runway, usable``.
        levels: names of the requirements, the most important first; those of one level are equal.
    """

    text: str
    levels: tuple[tuple[str, ...], ...]

    @property
    def rules(self) -> tuple[str, ...]:
        """Names of the requirements, the most important first."""
        return sum(self.levels, ())

    def value(self, robustness: Mapping[str, RobustnessInterval]) -> float | None:
        """One number to minimise; None if it is not known, as of a run that was stopped.

        Of one level it is the least robustness of its requirements, so 0 or less if one is broken.
        Of several, these least ones are squashed to -1..1, as they may have different units, and
        added: each counts a tenth of the one above. So it is also worth while to come near to an
        important requirement, which would not be so if only broken ones were ranked.
        """
        known = [[robustness[name].nearest_to_zero for name in level] for level in self.levels]
        least = [min((rho for rho in level if rho is not None), default=math.inf)
                 for level in known]
        if len(least) == 1:
            return least[0] if least[0] <= 0 or None not in known[0] else None
        if any(None in level for level in known):
            return None
        return sum(rho / (1 + abs(rho)) * _BELOW**at for at, rho in enumerate(least))

    def check(self, sampler: str) -> None:
        """Check that a sampler can use it.

        Raises:
            UsageError: the sampler does not learn, or only from whether a run failed.
        """
        if not SAMPLERS[sampler].learns:
            raise UsageError(
                f'objective {self.text}: has no effect on sampler {sampler}, which does not '
                'learn from results; leave it out'
            )
        if len(self.levels) > 1 and sampler not in BY_SIZE:
            raise UsageError(
                f'objective {self.text}: sampler {sampler} learns only whether a run failed, '
                f'not how important that is; write them with commas, or use one of '
                f'{", ".join(BY_SIZE)}'
            )


def parse_objective(text: str, names: Sequence[str]) -> Objective:
    """Parse an objective: requirements, the more important before ``>``, equal ones with commas.

    Raises:
        UsageError: an unknown requirement, one that is named twice, or fewer than two.
    """
    levels = (tuple(map(str.strip, level.split(','))) for level in text.split('>'))
    found = Objective(text=text, levels=tuple(levels))
    for name in found.rules:
        if name not in names:
            raise UsageError(
                f'objective {text}: {name!r} is no requirement of this search; add its '
                f'formula; known: {", ".join(names)}'
            )
        if found.rules.count(name) > 1:
            raise UsageError(f'objective {text}: {name} is named twice')
    if len(found.rules) == 1:
        raise UsageError(f'objective {text}: one requirement alone is given as the first formula')
    return found
