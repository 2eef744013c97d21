"""Which of several requirements is looked into: one rule for all that ask why runs failed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.errors import UsageError


@dataclass(frozen=True, kw_only=True, slots=True)
class Examined:
    """The requirement that is looked into, beside the others.

    Attributes:
        spec: its name.
        asked: whether it was asked for.
        judged: number of judged runs.
        violated: how many of them violate each requirement, the headline first.
    """

    spec: str
    asked: bool
    judged: int
    violated: Mapping[str, int]

    @property
    def failed(self) -> int:
        """Number of runs that violate it."""
        return self.violated[self.spec]

    @property
    def chosen(self) -> str:
        """Why it is another than the headline, in words; '' if it is not, or was asked for."""
        headline = next(iter(self.violated))
        if self.asked or self.spec == headline:
            return ''
        if self.judged == 1:
            return f'the run does not violate {headline}; looked into: {self.spec}'
        return (
            f'no run violates {headline}; looked into: {self.spec}, violated by {self.failed:,} '
            f'of {self.judged:,} runs'
        )

    def also(self, command: str) -> str:
        """Sentence on the other requirements that are violated; '' if none is.

        Args:
            command: what looks into one of them by its option ``spec``.
        """
        others = {
            name: number for name, number in self.violated.items() if number and name != self.spec
        }
        if not others:
            return ''
        one = self.judged == 1
        named = ', '.join(
            name if one else f'{name} ({number:,} of {self.judged:,})'
            for name, number in others.items()
        )
        commands = ' or '.join(f'{command} --spec {name}' for name in others)
        also = 'also ' if self.failed else ''
        return (
            f'{"The run" if one else "Runs"} {also}{"violates" if one else "violate"} {named}; '
            f'look into that by: {commands}'
        )


def examine(
    violated: Mapping[str, int], judged: int, *, asked: str | None = None, where: str = ''
) -> Examined:
    """Choose the requirement to look into.

    It is the one that is asked for; else the headline, if a run violates it or none violates any;
    else the one that most runs violate, the first of several.

    Args:
        violated: number of judged runs that violate each requirement, the headline first.
        judged: number of judged runs.
        asked: name of the requirement that is asked for, or None.
        where: what was judged, for the error message.

    Raises:
        UsageError: there is no such requirement.
    """
    if asked is not None and asked not in violated:
        raise UsageError(f'spec {asked}: not judged in {where}; known: {", ".join(violated)}')
    headline = next(iter(violated))
    most = headline if violated[headline] else max(violated, key=lambda name: violated[name])
    return Examined(
        spec=asked or most, asked=asked is not None, judged=judged, violated=violated)


def examine_runs(
    names: Sequence[str], runs: Iterable[Mapping[str, RobustnessInterval]], *,
    asked: str | None = None, where: str = '',
) -> Examined:
    """Choose the requirement to look into, as :func:`examine`.

    Args:
        names: names of the requirements, the headline first.
        runs: robustness of each judged run by name.
        asked: as there.
        where: as there.

    Raises:
        UsageError: there is no such requirement.
    """
    known = list(runs)
    return examine({
        name: sum(name in one and one[name].failed for one in known) for name in names
    }, len(known), asked=asked, where=where)


def decisive(robustness: Mapping[str, RobustnessInterval]) -> str:
    """The requirement that :func:`examine` chooses for one run, of which there is one or more."""
    return next((name for name, interval in robustness.items() if interval.failed),
                next(iter(robustness)))
