"""Timing of answers: immediate, delayed by a fixed or random latency, or free-running.

In lockstep, simulated time waits for every answer, as if perception and controller took no time. A
latency simulates their computing time and keeps the run deterministic: the answer to the frame of
time t takes effect at t plus the latency, rounded up to whole control steps: of 0.1 s, 0.05 s acts
as 0.1 s. In a free run, time follows the wall clock regardless of answers, so results vary.

At each step, the command in effect is the one for the newest frame whose latency has passed; a
command overtaken by that for a newer frame never takes effect. Before the first command, the
aircraft keeps its initial motion: actuators keep their last command (zero-order hold; Astrom and
Wittenmark, Computer-Controlled Systems, 3rd edition, section 2.3), and braking would be a
disturbance not caused by the latency under test.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Generic, Self, TypeVar

import numpy as np

from taxinet_ros.core.types import reached_ns
from taxinet_ros.errors import UsageError

LATE_NODES = ('perception', 'controller')
"""Nodes whose answers may be delayed."""

MOST_LATENCY_S = 30.0
"""Maximum latency parameter [s]: the length of a default run."""

LAWS = 'SECONDS, uniform(LOW,HIGH) or normal(MEAN,SD)'
_FORM = 'NAME=LATENCY, e.g. perception=0.15 or perception=normal(0.15,0.05)'
_LAW = re.compile(r'(?P<kind>[a-z]+)\((?P<numbers>[^()]*)\)')
_PLAIN = re.compile(r'[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?', re.IGNORECASE)
_CONSTANT, _UNIFORM, _NORMAL = 'constant', 'uniform', 'normal'
_NEARLY_1 = math.nextafter(1.0, 0.0)
_LATENCY, _DRAWS, _FACTOR = 'latency', 'draws', 'real_time_factor'
FREE, MAX = 'free', 'max'
LEAST_FACTOR, MOST_FACTOR = 0.1, 100.0
"""Minimum and maximum real-time factor of a free run, unless unlimited."""

NOT_REPRODUCIBLE = 'free runs depend on the speed of machine and nodes: not reproducible'
"""Reason given where reproducibility is required."""

Answer = TypeVar('Answer')


@dataclass(frozen=True, kw_only=True, slots=True)
class Law:
    """Latency law: a constant or a distribution.

    Attributes:
        kind: ``constant``, ``uniform`` or ``normal``.
        first: the constant, minimum, or mean [s].
        second: the maximum, or standard deviation [s]; 0 for a constant.
    """

    kind: str
    first: float
    second: float = 0.0

    @property
    def drawn(self) -> bool:
        """Whether it is random in each step."""
        return self.kind != _CONSTANT

    @property
    def words(self) -> str:
        """Text form; :func:`parse_timing` restores it bit for bit."""
        if not self.drawn:
            return _number_words(self.first)
        return f'{self.kind}({_number_words(self.first)},{_number_words(self.second)})'

    def latency_s(self, chance: float) -> float:
        """Quantile of the latency [s] at probability ``chance``, 0 <= chance < 1."""
        if self.kind == _UNIFORM:
            return self.first + chance * (self.second - self.first)
        if self.kind == _NORMAL:
            law = NormalDist(self.first, self.second)
            # Truncated to non-negative values and the length of a default run.
            below_0 = law.cdf(0.0)
            share = below_0 + chance * (law.cdf(MOST_LATENCY_S) - below_0)
            drawn_s = law.inv_cdf(min(max(share, 1e-300), _NEARLY_1))
            return min(max(0.0, drawn_s), MOST_LATENCY_S)
        return self.first


@dataclass(frozen=True, kw_only=True, slots=True)
class Timing:
    """Timing of the answers of a run; by default immediate.

    Attributes:
        laws: latency by name, in the order of :data:`LATE_NODES`; without zeros.
        draws: seed and index of the run whose draws are repeated; None: each run has its own.
        free: simulated time follows the wall clock, and answers take effect when they arrive.
        factor: real-time factor of a free run; 0: as fast as possible.
    """

    laws: tuple[tuple[str, Law], ...] = ()
    draws: tuple[int, int] | None = None
    free: bool = False
    factor: float = 1.0

    @property
    def latency(self) -> str:
        """Argument of ``--latency``, one word per name; '' for none."""
        words = [f'{name}={law.words}' for name, law in self.laws]
        if self.draws is not None:
            words.append(f'{_DRAWS}={self.draws[0]}.{self.draws[1]}')
        return ' '.join(words)

    @property
    def options(self) -> list[str]:
        """Command-line options of ``taxinet run``."""
        if self.free:
            return ['--free', '--real-time-factor', self.words.partition('=')[2]]
        return [text for word in self.latency.split() for text in (f'--{_LATENCY}', word)]

    @property
    def words(self) -> str:
        """Text form for bags, tables and records; '' for immediate answers."""
        if self.free:
            return f'{FREE} {_FACTOR}={_number_words(self.factor) if self.factor else MAX}'
        return f'{_LATENCY} {self.latency}' if self.laws else ''

    def of_run(self, seed: int, index: int) -> Self:
        """Timing that repeats the draws of the run with this seed and index."""
        if self.draws is None and any(law.drawn for _, law in self.laws):
            return replace(self, draws=(seed, index))
        return self

    def latencies_ns(self, seed: int, index: int) -> Iterator[int]:
        """Latency of the answer to each frame, from frame 0 on [ns].

        Each name has its own random stream, determined by seed, index and name.

        Args:
            seed: seed of the campaign.
            index: index of the run in it.
        """
        seed, index = self.draws or (seed, index)
        streams = [
            (law, np.random.default_rng([seed % 2**64, index, *name.encode()]))
            for name, law in self.laws
        ]
        while True:
            yield reached_ns(math.fsum(
                law.latency_s(stream.random() if law.drawn else 0.0) for law, stream in streams
            ))


AT_ONCE = Timing()
"""Default timing: lockstep with immediate answers."""


def parse_latency(words: Iterable[str]) -> Timing:
    """Parse ``--latency``.

    Args:
        words: each ``NAME=LATENCY``, or several separated by spaces.

    Raises:
        UsageError: an entry is invalid.
    """
    laws: dict[str, Law] = {}
    draws: tuple[int, int] | None = None
    for word in (word for text in words for word in text.split()):
        name, equals, text = word.partition('=')
        if name == _DRAWS and (found := re.fullmatch(r'(-?\d{1,19})\.(\d{1,10})', text)):
            draws = int(found[1]), int(found[2])
            continue
        if not (equals and text) or name not in LATE_NODES:
            raise UsageError(f'latency {word}: expected {_FORM}; names: {", ".join(LATE_NODES)}')
        if name in laws:
            raise UsageError(f'latency {word}: {name} has one already, {laws[name].words}')
        laws[name] = _law(word, text)
    timing = Timing(laws=tuple(
        (name, laws[name]) for name in LATE_NODES
        if name in laws and (laws[name].drawn or laws[name].first > 0)
    ))
    if draws is not None and timing.of_run(*draws) is timing:
        raise UsageError(f'latency {_DRAWS}=…: no effect without a random latency')
    return timing if draws is None else timing.of_run(*draws)


def parse_timing(words: str) -> Timing:
    """Parse :attr:`Timing.words`.

    Raises:
        UsageError: words of another version.
    """
    kind, _, rest = words.partition(' ')
    if not words:
        return AT_ONCE
    if kind == FREE and rest.startswith(f'{_FACTOR}='):
        return free_timing(rest.removeprefix(f'{_FACTOR}='))
    if kind != _LATENCY:
        raise UsageError(f'timing {words!r:.80}: not of this version')
    return parse_latency([rest])


def free_timing(factor: str) -> Timing:
    """Timing of a free run.

    Args:
        factor: real-time factor; ``max`` or 0: as fast as possible.

    Raises:
        UsageError: factor out of range.
    """
    try:
        value = 0.0 if factor == MAX else _number(factor)
    except ValueError:
        value = math.nan
    if not (value == 0 or LEAST_FACTOR <= value <= MOST_FACTOR):
        raise UsageError(
            f'real_time_factor {factor}: needs to be within {LEAST_FACTOR:g}..{MOST_FACTOR:g}, or '
            f'{MAX} (or 0) for unlimited'
        )
    return Timing(free=True, factor=value)


def timing_of(latency: str, *, lockstep: bool, factor: float) -> Timing:
    """Timing from the simulator's parameters.

    Args:
        latency: as for :func:`parse_latency`, or ''.
        lockstep: simulated time waits for every answer.
        factor: simulated seconds per second of the wall clock in a free run; 0: no limit.

    Raises:
        UsageError: one of them is invalid, or has no effect with another.
    """
    timing = parse_latency([latency])
    if not lockstep and timing.laws:
        raise UsageError(
            f'simulator: latency {timing.latency}: no effect in a free run, which has real delays'
        )
    if lockstep and factor != 1.0:
        raise UsageError('simulator: real_time_factor: no effect in lockstep; set lockstep false')
    return timing if lockstep else free_timing(f'{factor!r}')


def is_free(words: str) -> bool:
    """Whether :attr:`Timing.words` are those of a free run."""
    return words.partition(' ')[0] == FREE


def timing_words(words: str) -> str:
    """Readable form of :attr:`Timing.words`, also if empty."""
    return words or 'immediate answers'


def _law(word: str, text: str) -> Law:
    found = _LAW.fullmatch(text)
    numbers = found['numbers'].split(',') if found else [text]
    try:
        values = [_number(number) for number in numbers]
    except ValueError:
        values = []
    kind = found['kind'] if found else _CONSTANT
    if len(values) != {_CONSTANT: 1, _UNIFORM: 2, _NORMAL: 2}.get(kind):
        raise UsageError(f'latency {word}: a latency is {LAWS}')
    if not all(0 <= value <= MOST_LATENCY_S for value in values):
        raise UsageError(f'latency {word}: seconds have to be within 0..{MOST_LATENCY_S:g}')
    law = Law(kind=kind, first=values[0], second=values[1] if len(values) > 1 else 0.0)
    if kind == _UNIFORM and not law.first < law.second:
        raise UsageError(f'latency {word}: uniform needs LOW < HIGH')
    if kind == _NORMAL and not law.second > 0:
        raise UsageError(f'latency {word}: normal needs SD > 0')
    return law


def _number(text: str) -> float:
    """Parse a plain decimal number; rejects Python's 1_0 and non-ASCII digits.

    Raises:
        ValueError: not a number.
    """
    if not _PLAIN.fullmatch(text.strip()):
        raise ValueError(text)
    return float(text)


def _number_words(value: float) -> str:
    short = f'{value:g}'
    return short if float(short) == value else repr(value)


class LateAnswers(Generic[Answer]):
    """Pending answers, and the one in effect.

    Attributes:
        held: number of the frame whose answer is in effect; -1 before the first.
    """

    def __init__(self, first: Answer) -> None:
        """``first`` is in effect until the first answer."""
        self.held = -1
        self._held = first
        self._waiting: dict[int, tuple[int, Answer]] = {}

    def put(self, seq: int, due_ns: int, answer: Answer) -> None:
        """Add the answer to frame ``seq``; it takes effect at ``due_ns`` unless a newer one has."""
        if seq > self.held:
            self._waiting[seq] = due_ns, answer

    def newest(self, now_ns: int) -> Answer:
        """Return the answer in effect at ``now_ns``: that to the newest frame due."""
        due = [seq for seq, (due_ns, _) in self._waiting.items() if due_ns <= now_ns]
        if due:
            self.held = max(due)
            self._held = self._waiting[self.held][1]
            waiting: Mapping[int, tuple[int, Answer]] = self._waiting
            self._waiting = {seq: rest for seq, rest in waiting.items() if seq > self.held}
        return self._held
