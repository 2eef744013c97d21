"""What decides a run's verdict: its requirements, what ends it early, and what is vouched for.

A run may end before its horizon as soon as what it was run for is decided. Robust satisfaction
intervals make that sound: once an interval leaves zero behind, no completion of the run brings it
back (Deshmukh et al., Formal Methods in System Design 51, 2017).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from taxinet_ros.core.mtl import Assumptions, Reading, Spec, parse_assumptions, parse_spec
from taxinet_ros.errors import UsageError


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
    if any(reading.final or not reading.valid or reading.interval.unclear for reading in readings):
        return False
    if stop_on is StopOn.VIOLATED:
        return readings[0].interval.failed
    if stop_on is StopOn.DECIDED:
        return all(reading.interval.decided for reading in readings)
    return False


@dataclass(frozen=True, kw_only=True, slots=True)
class Judging:
    """What decides the verdict of runs, in words that go into files and messages as they are.

    Attributes:
        specs: formulas as text that needs no file (:func:`.mtl.parse_spec`); the first is the
            headline.
        stop_on: what ends a run before its end.
        bounds: what is vouched for of the signals' values, such as ``cte=-25:25``, each in the
            signal's unit (:mod:`.mtl.assumptions`).
        rates: of their change per second, such as ``cte=3``.
    """

    specs: tuple[str, ...]
    stop_on: StopOn = StopOn.NEVER
    bounds: tuple[str, ...] = ()
    rates: tuple[str, ...] = ()

    @property
    def parsed_specs(self) -> tuple[Spec, ...]:
        """The formulas.

        Raises:
            UsageError: one is none.
        """
        return tuple(parse_spec(text) for text in self.specs)

    @property
    def assumptions(self) -> Assumptions:
        """What is vouched for.

        Raises:
            UsageError: it is not spelled as it should be.
        """
        return parse_assumptions(self.bounds, self.rates)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the formulas."""
        return tuple(spec.name for spec in self.parsed_specs)

    @property
    def headline(self) -> str:
        """Name of the first formula."""
        return parse_spec(self.specs[0]).name

    def facts(self) -> dict[str, Any]:
        """Plain values for a campaign's record, the formulas fully parenthesised."""
        return {
            'specs': {spec.name: spec.text for spec in self.parsed_specs},
            'stop_on': self.stop_on.value,
            'bounds': list(self.bounds),
            'rates': list(self.rates),
        }

    @classmethod
    def from_facts(cls, facts: Mapping[str, Any]) -> Self:
        """Read back what :meth:`facts` gave; a record from before there was a choice lacks some.

        Raises:
            UsageError: there is no such rule to stop.
        """
        return cls(
            specs=tuple(f'{name}={text}' for name, text in facts.get('specs', {}).items()),
            stop_on=parse_stop_on(facts.get('stop_on', '')),
            bounds=tuple(facts.get('bounds', ())), rates=tuple(facts.get('rates', ())),
        )

    @classmethod
    def from_message(cls, message: Any) -> Self:
        """What a scenario message says; bags from before there was a choice lack some fields.

        Raises:
            UsageError: there is no such rule to stop.
        """
        return cls(
            specs=tuple(message.specs), stop_on=parse_stop_on(getattr(message, 'stop_on', '')),
            bounds=tuple(getattr(message, 'bounds', ())),
            rates=tuple(getattr(message, 'rates', ())),
        )
