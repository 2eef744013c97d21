"""What decides a run's verdict: requirements, stop rule and assumptions.

A run may end before its horizon as soon as its verdict is decided. Robust satisfaction intervals
make this sound: once an interval excludes zero, no completion of the run can include it again
(Deshmukh et al., Formal Methods in System Design 51, 2017).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

from taxinet_ros.core.mtl import Assumptions, Reading, Spec, parse_assumptions, parse_spec
from taxinet_ros.errors import UsageError


class StopOn(enum.StrEnum):
    """Rule to stop a run early."""

    NEVER = 'never'
    VIOLATED = 'violated'
    """Stop when the first formula (the headline) can no longer have robustness > 0."""
    DECIDED = 'decided'
    """Stop when for every formula robustness > 0 is certain or impossible."""


def parse_stop_on(word: str) -> StopOn:
    """Parse the rule name; '' means never, as in older recordings.

    Raises:
        UsageError: unknown name.
    """
    try:
        return StopOn(word or StopOn.NEVER)
    except ValueError:
        raise UsageError(f'stop_on {word}: unknown; known: {", ".join(StopOn)}') from None


def stops(stop_on: StopOn, readings: Sequence[Reading]) -> bool:
    """Whether a run stops at the sample of these readings, before its horizon.

    A run with an unusable sample is never stopped early: it has no verdict.
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
    """Judging options as texts, stored unchanged in files and messages.

    Attributes:
        specs: formulas as self-contained text (:func:`.mtl.parse_spec`); the first is the headline.
        stop_on: stop rule.
        bounds: assumed ranges of signals, such as ``cte=-25:25``, in the signal's unit
        (:mod:`.mtl.assumptions`).
        rates: assumed maximum change per second, such as ``cte=3``.
    """

    specs: tuple[str, ...]
    stop_on: StopOn = StopOn.NEVER
    bounds: tuple[str, ...] = ()
    rates: tuple[str, ...] = ()

    @property
    def parsed_specs(self) -> tuple[Spec, ...]:
        """The formulas.

        Raises:
            UsageError: one is invalid.
        """
        return tuple(parse_spec(text) for text in self.specs)

    @property
    def assumptions(self) -> Assumptions:
        """The parsed assumptions.

        Raises:
            UsageError: the syntax is invalid.
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

    def headed_by(self, name: str) -> Self:
        """The same with one formula as the headline, by name or text, before the others."""
        texts = dict(zip(self.names, self.specs, strict=True))
        return replace(self, specs=(texts.pop(name, name), *texts.values()))

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
        """Inverse of :meth:`facts`; older records lack some values.

        Raises:
            UsageError: unknown stop rule.
        """
        return cls(
            specs=tuple(f'{name}={text}' for name, text in facts.get('specs', {}).items()),
            stop_on=parse_stop_on(facts.get('stop_on', '')),
            bounds=tuple(facts.get('bounds', ())), rates=tuple(facts.get('rates', ())),
        )

    @classmethod
    def from_message(cls, message: Any) -> Self:
        """Read from a scenario message; older bags lack some fields.

        Raises:
            UsageError: unknown stop rule.
        """
        return cls(
            specs=tuple(message.specs), stop_on=parse_stop_on(getattr(message, 'stop_on', '')),
            bounds=tuple(getattr(message, 'bounds', ())),
            rates=tuple(getattr(message, 'rates', ())),
        )
