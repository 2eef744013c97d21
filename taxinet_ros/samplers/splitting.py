"""The sampler ``splitting``: subset simulation as a search, and the estimate that it gives.

``taxinet estimate`` is a search by this sampler. Its runs are requested in batches, one move of all
chains at a time, so the scenes depend on no number of workers and no order of their answers, and an
interrupted search continues by repeating the requests.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from taxinet_ros.samplers.histogram import Floats
from taxinet_ros.samplers.sampler import Exhausted, Sampler
from taxinet_ros.samplers.space import Point, Space, run_generator
from taxinet_ros.samplers.subset_simulation import (
    KEEP,
    Batch,
    Island,
    Plan,
    SubsetSimulation,
)

NAME = 'splitting'
"""Its word in the table of samplers."""
LOOK_TAIL = 0.0125
"""Tail probability at each end of an interval.

Half of that of a 95 % interval, as the first draws decide whether the result is that of the islands
or of as many draws again: two looks.
"""
WIDE = 10
"""Upper end over the lower one above which an interval is called wide."""
BETS = np.linspace(0.05, 1.0, 20)
"""Shares of the stake that :func:`least_mean` bets."""


class State(StrEnum):
    """A word for the interval, which holds in either case."""

    ESTIMATED = 'estimated'
    """Its ends are within a factor of :data:`WIDE`."""
    UNCLEAR = 'unclear'
    """They are not."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Step:
    """One level of the estimate, over all islands that reached it.

    Attributes:
        below: mean level of the islands; infinite for plain draws.
        probability: mean estimated probability of being below each island's level.
        islands: number of islands that reached it.
        accepted: share of the moves that were accepted; NaN for plain draws.
    """

    below: float
    probability: float
    islands: int
    accepted: float


@dataclass(frozen=True, kw_only=True, slots=True)
class RareEstimate:
    """Probability of failure by splitting, or by plain draws.

    Attributes:
        state: a word for how wide the interval is.
        low, high: 95 % interval. The upper end is that of the plain draws, whatever the islands
            found: what all of them lost is in no island.
        probability: mean of the islands: what they found; or the share of the plain draws.
        plain: why everything was drawn plainly, or ''.
        islands: number of islands that count; failing: of those that found failures.
        runs: number of runs spent.
        drawn, drawn_failed: runs that the upper end rests on, and of those the failures.
        steps: levels from plain draws down.
        curve: robustness r, estimated P(robustness <= r), and its 95 % interval, made alike.
    """

    state: State
    low: float
    high: float
    probability: float
    plain: str
    islands: int
    failing: int
    runs: int
    drawn: int
    drawn_failed: int
    steps: tuple[Step, ...]
    curve: tuple[tuple[float, float, float, float], ...]


def least_mean(values: Floats, tail: float) -> float:
    """Lower confidence limit of the mean of non-negative values, whatever their distribution.

    The least mean against which a gambler would not have multiplied the stake by 1/tail, who bets
    on each value in turn that it is greater, a share of the stake from :data:`BETS` each (Ville,
    1939; Waudby-Smith and Ramdas, Journal of the Royal Statistical Society B 86, 2024). It needs
    values whose expectation, given those before, is at most the mean, and holds for any number of
    them.

    Args:
        values: the values, 0 or more.
        tail: probability that the limit is above the mean.
    """
    top = float(values.mean()) if len(values) else 0.0
    if not top:
        return 0.0
    low, high = math.log(top) - 40.0, math.log(top)
    for _ in range(32):
        middle = (low + high) / 2
        factors = 1 - BETS[:, None] + BETS[:, None] * values / math.exp(middle)
        # In logarithms, as the product of many values overflows; a stake may be lost to the last.
        with np.errstate(divide='ignore'):
            stakes = np.log(factors).sum(axis=1)
        stake = float(np.logaddexp.reduce(stakes)) - math.log(len(BETS))
        low, high = (middle, high) if stake >= -math.log(tail) else (low, middle)
    return math.exp(low)


def _interval(found: Floats, hits: int, draws: int, *, plain: bool) -> tuple[float, float]:
    """95 % interval of a probability, by the islands' estimates and by the program's own draws."""
    from scipy.special import betaincinv

    # That of Clopper and Pearson; campaign.rates has it too, but is no floor of the samplers.
    misses = draws - hits
    low = float(betaincinv(hits, misses + 1, LOOK_TAIL)) if hits else 0.0
    high = float(betaincinv(hits + 1, misses, 1 - LOOK_TAIL)) if misses else 1.0
    least = low if plain else least_mean(found, LOOK_TAIL)
    # If the ends contradict each other, the islands' is left out.
    return (least if least < high else low), high


def estimate(simulation: SubsetSimulation, drawn: Floats, runs: int) -> RareEstimate:
    """The estimate of a simulation.

    Args:
        simulation: the simulation; islands without an end count as without a failure.
        drawn: robustness of the planned draws of the program itself; all have ended.
        runs: number of runs spent.
    """
    islands = [one for one in simulation.islands if one.wave]
    plain = bool(simulation.plain)
    values = np.array([one.failing or 0.0 for one in islands])
    failed = int((drawn <= 0).sum())
    low, high = _interval(values, failed, len(drawn), plain=plain)
    share = failed / len(drawn) if len(drawn) else 0.0
    return RareEstimate(
        state=State.ESTIMATED if high <= WIDE * low else State.UNCLEAR, low=low, high=high,
        probability=float(values.mean()) if islands else share, plain=simulation.plain,
        islands=len(islands), failing=int((values > 0).sum()), runs=runs,
        drawn=len(drawn), drawn_failed=failed, steps=_steps(islands),
        curve=_curve(islands, drawn, plain=plain),
    )


def _steps(islands: Sequence[Island]) -> tuple[Step, ...]:
    deepest = max((len(one.levels) for one in islands), default=0)
    steps = []
    for number in range(deepest):
        levels = [one.levels[number] for one in islands if number < len(one.levels)]
        steps.append(Step(
            below=float(np.mean([one.below for one in levels])),
            probability=float(np.mean([one.probability for one in levels])),
            islands=len(levels), accepted=float(np.mean([one.accepted for one in levels])),
        ))
    return tuple(steps)


def _curve(
    islands: Sequence[Island], drawn: Floats, *, plain: bool
) -> tuple[tuple[float, float, float, float], ...]:
    """P(robustness <= r) at a hundred values of r, from the least seen to the greatest."""
    seen = [drawn, *(np.array(level.rho) for one in islands for level in one.levels)]
    values = np.concatenate(seen)
    values = values[np.isfinite(values)]
    if not len(values):
        return ()
    ended = [one for one in islands if one.failing is not None]
    unended = [0.0] * (len(islands) - len(ended))
    curve = []
    for rho in np.unique(np.append(np.quantile(values, np.linspace(0, 1, 100)), 0.0)):
        hits = int((drawn <= rho).sum())
        found = np.array([one.probability_below(float(rho)) for one in ended] + unended)
        mean = float(found.mean()) if islands else hits / len(drawn)
        if mean:
            curve.append((float(rho), mean, *_interval(found, hits, len(drawn), plain=plain)))
    return tuple(curve)


class Splitting(Sampler):
    """Subset simulation as a sampler; :meth:`estimate` tells what it found.

    A scene that the program's requirements refuse is a move that is not accepted; the run is then
    that of another chain. If none is left, the run is one more draw from the program, which no
    rate counts, as its place depends on the results.
    """

    def __init__(self, space: Space, seed: int, plan: Plan) -> None:
        """Create it without results.

        Args:
            space: the space to search.
            seed: seed of the campaign.
            plan: size of the simulation.
        """
        self.simulation = SubsetSimulation(space, seed, plan)
        self._plan = plan
        self._space = space
        self._seed = seed
        self._batches = self.simulation.batches()
        self._batch: Batch | None = next(self._batches)
        self._first = 0
        self._next_place = 0
        self._answers: list[float | None] = [None] * len(self._batch.quantiles)
        self._run_at = np.array(self._batch.quantiles)
        self._places: list[int | None] = []
        self._attempt = 0
        self._told: dict[int, float | None] = {}

    def needed(self) -> int:
        """Number of results that the next run depends on: all, where a batch begins."""
        begins = self._batch is None or self._next_place == len(self._batch.quantiles)
        return len(self._places) if begins else self._first

    def ask(self) -> Point:
        """The next point.

        Raises:
            Exhausted: the estimate is ready, or the runs are spent.
        """
        self._attempt = 0
        if self._batch is not None and self._next_place == len(self._batch.quantiles):
            self._begin_batch()
        if self._batch is None:
            raise Exhausted(self.simulation.ended)
        self._places.append(self._next_place)
        return self._take()

    def again(self) -> Point:
        """Another point for the last run, whose point is no scene of the program."""
        assert self._batch is not None
        self._attempt += 1
        if not self._batch.drawn and self._places[-1] is not None:
            if self._next_place < len(self._batch.quantiles):
                self._places[-1] = self._next_place
                return self._take()
            self._places[-1] = None
        quantiles = self._drawn_quantiles()
        if (place := self._places[-1]) is not None:
            self._run_at[place] = quantiles
        return self._space.point(quantiles)

    def tell(self, index: int, rho: float | None) -> None:
        """Record a result."""
        self._told[index] = rho
        place = self._places[index]
        if place is not None and index >= self._first:
            self._answers[place] = rho

    def drawn(self, index: int) -> bool:
        """Whether the program itself drew a run, whatever the results: the first ones."""
        return index < self._plan.draws

    def draws(self) -> tuple[int, int]:
        """How many of the planned draws have ended, and their number; call it after the last run.

        Those without a result have ended, too. An interval needs all: it is one for a number that
        was fixed beforehand, and whoever watches the runs could end them at the first failure.
        """
        # A batch is handed over whole: what an interrupt cut off is no move that was refused.
        whole = len(self._told) == len(self._places)
        if self._batch is not None and self._next_place == len(self._batch.quantiles) and whole:
            self._begin_batch()
        planned = self._plan.draws * (2 if self.simulation.plain else 1)
        return sum(index < planned for index in self._told), planned

    def estimate(self) -> RareEstimate:
        """The estimate by the results so far; call it after the last run.

        Raises:
            ValueError: planned draws have not ended, see :meth:`draws`.
        """
        ended, planned = self.draws()
        if ended < planned:
            raise ValueError(f'no interval: {ended} of {planned} planned draws have ended')
        drawn = [
            rho for index, rho in self._told.items() if index < planned and rho is not None
        ]
        return estimate(self.simulation, np.array(drawn), len(self._places))

    def _take(self) -> Point:
        """The next point of the batch."""
        assert self._batch is not None
        place, self._next_place = self._next_place, self._next_place + 1
        if self._batch.drawn:
            self._run_at[place] = self._drawn_quantiles()
        return self._space.point(self._run_at[place])

    def _drawn_quantiles(self) -> Floats:
        index = len(self._places) - 1
        return run_generator(self._seed, index, self._attempt).random(len(self._space))

    def _begin_batch(self) -> None:
        """Hand over the results of a whole batch, and get the next one."""
        self._first, self._next_place = len(self._places), 0
        try:
            self._batch = self._batches.send((self._run_at, self._answers))
        except StopIteration:
            self._batch = None
            return
        self._answers = [None] * len(self._batch.quantiles)
        self._run_at = np.array(self._batch.quantiles)


def particles_for(runs: int, islands: int, floor: float) -> int:
    """Particles of an island such that ``runs`` suffice down to a probability of ``floor``.

    Args:
        runs: number of runs, half of which are plain draws.
        islands: number of islands beside the pilot.
        floor: the probability.
    """
    levels = max(1, math.ceil(-math.log(floor) / math.log(KEEP)) - 1)
    whole = runs / 2 / ((islands + 1) * levels * (1 - 1 / KEEP))
    return int(whole // KEEP * KEEP)


def make_splitting(space: Space, seed: int, runs: int, values: Mapping[str, float]) -> Splitting:
    """The sampler with its option values."""
    return Splitting(space, seed, Plan(
        draws=int(values['draws']), particles=int(values['particles']) // KEEP * KEEP,
        islands=int(values['islands']), floor=values['floor'] / 10, runs=runs,
    ))
