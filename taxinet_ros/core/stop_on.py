"""When a run may end before its horizon: as soon as what it was run for is decided.

Robust satisfaction intervals make that sound: once an interval leaves zero behind, no completion of
the run brings it back (Deshmukh et al., Formal Methods in System Design 51, 2017).
"""

from __future__ import annotations

import enum
from collections.abc import Sequence

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import Reading


class StopOn(enum.StrEnum):
    """What ends a run early."""

    NEVER = 'never'
    VIOLATED = 'violated'
    """The first formula, the headline, can no longer have robustness > 0: the run has failed."""
    DECIDED = 'decided'
    """Every formula is decided: robustness > 0 is certain, or out of reach."""


def parse_stop_on(word: str) -> StopOn:
    """The rule of this name; '' is never, as in recordings from before there was a choice.

    Raises:
        UsageError: there is none by that name.
    """
    try:
        return StopOn(word or StopOn.NEVER)
    except ValueError:
        raise UsageError(f'--stop-on {word}: unknown; known: {", ".join(StopOn)}') from None


def stops(stop_on: StopOn, readings: Sequence[Reading]) -> bool:
    """Whether a run ends at the sample of these readings, though its horizon is not reached.

    A run with an unusable sample is never stopped: it has no verdict, early or late.
    """
    if any(reading.final or not reading.valid or reading.unclear for reading in readings):
        return False
    if stop_on is StopOn.VIOLATED:
        return readings[0].upper <= 0
    if stop_on is StopOn.DECIDED:
        return all(reading.upper <= 0 or reading.lower > 0 for reading in readings)
    return False
