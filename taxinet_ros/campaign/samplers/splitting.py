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

from taxinet_ros.campaign.samplers.histogram import Floats
from taxinet_ros.campaign.samplers.sampler import Exhausted, Probabilities
from taxinet_ros.campaign.samplers.space import Point, Space, run_generator
from taxinet_ros.campaign.samplers.subset_simulation import (
    KEEP,
    Batch,
    Island,
    Plan,
    SubsetSimulation,
    relative_error,
)

NAME = 'splitting'
"""Its word in the table of samplers."""
TAIL = 0.025
"""Tail probability at each end of an interval."""
CLEAR = 0.5
"""Relative standard error above which the interval of so few islands is not to be relied on."""

MISSED = 0.1
"""Share of islands without a failure above which the result is unclear.

Of 16 estimates of 1e-5 (``taxinet bench rare two``), the three with two such islands of ten and a
small spread all had intervals that were too low.
"""


class State(StrEnum):
    """What an estimate tells."""

    ESTIMATED = 'estimated'
    """The probability, with its interval."""
    UNCLEAR = 'unclear'
    """Failures, but the islands or the plain draws contradict the interval."""
    AT_MOST = 'at most'
    """An upper limit only."""


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
    """Probability of failure by splitting.

    Attributes:
        state, why: what it tells, and why no more; '' if it is estimated.
        probability: mean over the islands; unbiased up to terms of the order 1/particles.
        low, high: 95 % interval; 0 and the upper limit if :attr:`state` is ``at most``.
        relative_error: standard error over the probability; infinite without failures.
        islands: number of islands; failing: of those that found failures.
        runs: number of runs spent.
        drawn, drawn_failed: runs that the program itself drew, and of those the failures.
        steps: levels from plain draws down.
        curve: robustness r, estimated P(robustness <= r), and the ends of its 95 % interval.
    """

    state: State
    why: str
    probability: float
    low: float
    high: float
    relative_error: float
    islands: int
    failing: int
    runs: int
    drawn: int
    drawn_failed: int
    steps: tuple[Step, ...]
    curve: tuple[tuple[float, float, float, float], ...]


def log_interval(mean: float, relative: float, islands: int) -> tuple[float, float]:
    """95 % interval of a mean over islands, symmetric in the logarithm.

    Student's t with ``islands - 1`` degrees of freedom, by the delta method: the estimate of a
    product of shares is nearly log-normal (Cerou and others 2012, section 3.2).

    Args:
        mean: mean over the islands, above 0.
        relative: its relative standard error.
        islands: number of islands, 2 or more.
    """
    from scipy.special import stdtrit

    reach = float(stdtrit(islands - 1, 1 - TAIL)) * relative
    return mean * math.exp(-min(reach, 700.0)), min(1.0, mean * math.exp(min(reach, 700.0)))


def estimate(
    islands: Sequence[Island], particles: int, drawn: int, drawn_failed: int
) -> RareEstimate:
    """The estimate of a simulation.

    Args:
        islands: its islands; those without an end count as an upper limit.
        particles: points of an island at each level.
        drawn: number of runs that the program itself drew, with a result.
        drawn_failed: failures among them.
    """
    from scipy.special import betaincinv

    # A later island without its end would be counted only if it was short: a biased choice.
    used = [one for one in islands if one.levels]
    ended = [one for one in used if one.failing is not None]
    plain_high = float(betaincinv(drawn_failed + 1, drawn - drawn_failed, 1 - TAIL)) \
        if drawn > drawn_failed else 1.0
    plain_low = float(betaincinv(drawn_failed, drawn - drawn_failed + 1, TAIL)) \
        if drawn_failed else 0.0
    values = np.array([one.reached if one.failing is None else one.failing for one in used])
    mean = float(values.mean()) if len(values) else 0.0
    relative = relative_error(used, particles) if mean and len(values) > 1 else math.inf
    state, why = State.ESTIMATED, ''
    low, high = log_interval(mean, relative, len(values)) if mean else (0.0, 1.0)
    if len(ended) < len(used) or not used:
        state, low = State.AT_MOST, 0.0
        why = f'{len(used) - len(ended)} of {len(used)} islands were not ended'
        if not used:
            high = plain_high
    elif not mean:
        state, low, why = State.AT_MOST, 0.0, 'no island found a failure'
        flat = any(one.flat for one in used)
        reached = np.array([one.reached for one in used])
        spread = max(float(reached.std(ddof=1)), float(reached.mean()) / math.sqrt(particles))
        high = log_interval(
            float(reached.mean()), spread / math.sqrt(len(used)) / float(reached.mean()), len(used)
        )[1]
        if flat:
            high = plain_high
            why = 'islands ended at equal results: flat robustness, or chains that do not move'
    elif relative > CLEAR or (values == 0).mean() > MISSED:
        missed = int((values == 0).sum())
        state = State.UNCLEAR
        why = (
            f'the islands differ too much: relative error {relative:.2f}' if relative > CLEAR else
            f'{missed} of {len(values)} islands found no failure'
        )
    elif high < plain_low or low > plain_high:
        state = State.UNCLEAR
        why = (
            f'of {drawn} draws of the program itself {drawn_failed} failed, which contradicts it; '
            'a region of failures was missed'
        )
    return RareEstimate(
        state=state, why=why, probability=mean if state is not State.AT_MOST else 0.0,
        low=low, high=high, relative_error=relative if state is not State.AT_MOST else math.inf,
        islands=len(used), failing=int(sum(bool(one.failing) for one in used)),
        runs=sum(one.runs for one in islands), drawn=drawn, drawn_failed=drawn_failed,
        steps=_steps(used), curve=_curve(used, particles),
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
    islands: Sequence[Island], particles: int
) -> tuple[tuple[float, float, float, float], ...]:
    """P(robustness <= r) at a hundred values of r, from the least seen to the greatest."""
    if len(islands) < 2:
        return ()
    values = np.concatenate([level.rho for one in islands for level in one.levels])
    values = values[np.isfinite(values)]
    if not len(values):
        return ()
    curve = []
    for rho in np.unique(np.append(np.quantile(values, np.linspace(0, 1, 100)), 0.0)):
        shares = np.array([one.probability_below(float(rho)) for one in islands])
        mean = float(shares.mean())
        if not mean:
            continue
        least = math.sqrt(max(1 - mean, 0.0) / max(mean, 0.1) / particles)
        relative = max(float(shares.std(ddof=1)) / mean, least) / math.sqrt(len(shares))
        curve.append((float(rho), mean, *log_interval(mean, relative, len(shares))))
    return tuple(curve)


class Splitting:
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
        self._drawn: list[bool] = []
        self._attempt = 0
        self._failed = self._known = 0

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
        self._drawn.append(self._batch.drawn and self._of_first_wave)
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
        place = self._places[index]
        if self._drawn[index] and rho is not None:
            self._known += 1
            self._failed += rho <= 0
        if place is not None and index >= self._first:
            self._answers[place] = rho

    def weight(self, index: int) -> None:
        """None: the density is unknown."""

    def drawn(self, index: int) -> bool:
        """Whether the program itself drew a run: those that begin the first islands."""
        return self._drawn[index]

    def learned(self) -> Probabilities:
        """Empty: nothing is learned per dimension."""
        return {}

    def estimate(self) -> RareEstimate:
        """The estimate by the results so far; call it once all runs have ended."""
        if self._batch is not None and self._next_place == len(self._batch.quantiles):
            self._begin_batch()
        return estimate(
            self.simulation.islands, self._plan.particles, self._known, self._failed
        )

    @property
    def _of_first_wave(self) -> bool:
        return self.simulation.islands[-1].wave == 0

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
    """Particles of an island such that ``runs`` suffice down to a probability of ``floor``."""
    levels = math.ceil(-math.log(floor) / math.log(KEEP))
    whole = runs / (islands * (1 + (1 - 1 / KEEP) * levels))
    return int(whole // KEEP * KEEP)


def make_splitting(space: Space, seed: int, runs: int, values: Mapping[str, float]) -> Splitting:
    """The sampler with its option values."""
    particles = int(values['particles']) // KEEP * KEEP
    return Splitting(space, seed, Plan(
        particles=particles, islands=int(values['islands']), error=values['error'],
        floor=values['floor'] / 10, runs=runs,
    ))
