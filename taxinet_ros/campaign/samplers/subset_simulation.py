"""Probability of rare failures by subset simulation: multilevel splitting with Markov chains.

A failure of probability 1e-6 is a chain of events that are not rare: a robustness below the first
level (one draw in ten), then, given that, below a second, and so on to 0 (Au and Beck,
Probabilistic Engineering Mechanics 16, 2001; Cerou and others, Statistics and Computing 22, 2012).
Each level's points are drawn from the program's own distribution conditioned on the level before:
Markov chains in the unit cube, started at its survivors, that reject every move above the level.

**Islands.** The simulation is repeated on independent populations, the *islands*; their estimates
have the spread from which the interval is computed. An island that lost a region of failures
differs from one that kept it, so the interval widens, where the textbook variance of one
population would see nothing.

**Moves.** A move is cheap where a model can make it: several steps of a Markov chain that takes a
Gaussian process of all results so far for the robustness, and one run that accepts or rejects their
end with the exact ratio (the surrogate transition method; Liu, Monte Carlo Strategies in Scientific
Computing, 2001, section 9.4.3; Christen and Fox, Journal of Computational and Graphical Statistics
14, 2005). So a wrong model costs acceptance, not correctness. A share of the steps jumps to the
neighbourhood of another survivor, which is how chains pass between separate regions.

Pure: the caller runs the points. ``P(robustness <= 0)`` is estimated; everything is a function of
space, seed, options and results.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from taxinet_ros.campaign.samplers.gaussian_process import (
    Features,
    GaussianProcess,
    blas_threads,
)
from taxinet_ros.campaign.samplers.histogram import Floats
from taxinet_ros.campaign.samplers.space import Space, run_generator

KEEP = 10
"""One particle in so many survives a level."""
ADDED = 2
"""Islands added at a time after the first ones, until the error is small enough."""
WINDOW = 250
"""Most results that the model is conditioned on."""
FITTED = 120
"""Most results to which its length scales are fitted."""
STEPS = 12
"""Steps by the model for each run."""
JUMPS = 0.3
"""Share of these steps that jump to the neighbourhood of another survivor."""
OPEN = 0.1
"""Share of a level's proposals, roughly, where the model expects no survivors."""
MOVED = 0.6
"""Share of the coordinates that a local step moves."""
BANDWIDTHS = (0.1, 0.18, 0.32, 0.56, 1.0)
"""Widths to choose from around survivors [standard deviations of the program]; 1: anywhere."""
_STREAM = 2
"""Random stream of the moves; run ``i`` drawn from the program is that of plain draws."""

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, kw_only=True, slots=True)
class Level:
    """One level of one island.

    Attributes:
        below: robustness that its points have to be below; infinite for plain draws.
        probability: estimated probability of being below it.
        rho: robustness of its points, ascending.
        accepted: share of the moves that were accepted; NaN for plain draws.
    """

    below: float
    probability: float
    rho: tuple[float, ...]
    accepted: float = math.nan


@dataclass(kw_only=True)
class Island:
    """One independent population.

    Attributes:
        wave: 0 for the first islands, then 1, 2, ….
        levels: its levels, from plain draws on.
        failing: estimated probability of failure; None before its end.
        flat: whether it ended at equal results above 0: the robustness is flat there, or all its
            chains are at one point.
        runs: number of runs spent.
    """

    wave: int
    levels: list[Level] = field(default_factory=list)
    failing: float | None = None
    flat: bool = False
    runs: int = 0
    quantiles: Floats = field(default_factory=lambda: np.empty((0, 0)))
    rho: Floats = field(default_factory=lambda: np.empty(0))

    def probability_below(self, rho: float) -> float:
        """Estimated probability of a robustness of at most ``rho``."""
        for level in reversed(self.levels):
            if rho < level.below or level is self.levels[0]:
                share = float(np.searchsorted(level.rho, rho, 'right')) / len(level.rho)
                return level.probability * share
        raise ValueError('the island has no level')

    @property
    def reached(self) -> float:
        """Estimated probability of the last level: at least that of a failure."""
        return self.levels[-1].probability if self.levels else 1.0


@dataclass(frozen=True, slots=True)
class Batch:
    """Points to run at once; none depends on another's result.

    Attributes:
        quantiles: the points, shape (n, d); NaN where the program itself draws.
        drawn: whether the program itself draws them.
    """

    quantiles: Floats
    drawn: bool


Answers = Sequence[float | None]
"""A robustness for each point of a batch; None if it has none, or is no scene of the program."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """Size of a simulation.

    Attributes:
        particles: points of an island at each level, a multiple of :data:`KEEP`.
        islands: number of islands in the first wave, 2 or more.
        error: relative standard error at which to stop; 0 to use all runs.
        floor: probability below which an island ends without a failure.
        runs: most runs.
    """

    particles: int
    islands: int = 8
    error: float = 0.0
    floor: float = 1e-7
    runs: int = 4000


class SubsetSimulation:
    """The simulation, as a generator of batches.

    Attributes:
        islands: the islands so far.
        ended: why it ended, or ''.
    """

    def __init__(self, space: Space, seed: int, plan: Plan) -> None:
        """Create it without results.

        Args:
            space: the space of the program's choices.
            seed: seed of the campaign.
            plan: its size.
        """
        self.islands: list[Island] = []
        self.ended = ''
        self._space = space
        self._seed = seed
        self._plan = plan
        self._features = Features(space)
        self._model = GaussianProcess(self._features)
        self._known: list[Floats] = []
        self._results: list[Floats] = []
        self._scale = 0.5
        self._moves = 0
        self._runs = 0

    def batches(self) -> Generator[Batch, tuple[Floats, Answers], None]:
        """Yield batches; send the quantiles that were run, shape (n, d), and their results."""
        wave, size = 0, self._plan.islands
        while True:
            islands = [Island(wave=wave) for _ in range(size)]
            self.islands += islands
            yield from self._wave(islands)
            if self.ended or self._enough():
                return
            wave, size = wave + 1, ADDED

    def _enough(self) -> bool:
        """Whether to end after a whole wave."""
        plan, spent = self._plan, [island.runs for island in self.islands]
        found = [island.failing or 0.0 for island in self.islands]
        if all(island.flat for island in self.islands):
            self.ended = 'all islands ended at equal results above 0'
        elif not any(found):
            self.ended = f'no failure down to a probability of {plan.floor:g}'
        elif relative_error(self.islands, plan.particles) <= plan.error:
            self.ended = f'relative error {plan.error:g} reached'
        elif self._runs + ADDED * (max(spent) + plan.particles) > plan.runs:
            self.ended = 'the rest of the runs is too few for another island'
        return bool(self.ended)

    def _wave(self, islands: list[Island]) -> Generator[Batch, tuple[Floats, Answers], None]:
        """Take some islands to their end, one level at a time."""
        count = self._plan.particles
        size = len(islands) * count
        nowhere = np.full((size, len(self._space)), np.nan)
        quantiles, answers = yield Batch(nowhere, True)
        self._runs += size
        known = np.array([math.nan if rho is None else rho for rho in answers])
        self._learn(quantiles, known)
        for number, island in enumerate(islands):
            own = slice(number * count, (number + 1) * count)
            there = ~np.isnan(known[own])
            island.quantiles, island.rho = quantiles[own][there], known[own][there]
            island.runs = count
            island.levels.append(_level(math.inf, 1.0, island.rho))
        before = math.inf
        while True:
            going = []
            for island in islands:
                if island.failing is None and (seeds := self._survivors(island)) is not None:
                    going.append((island, *seeds))
            if not going:
                return
            level = float(np.median([below for _, below, _ in going]))
            yield from self._next_level(going, level, before)
            before = level

    def _survivors(self, island: Island) -> tuple[float, Indices] | None:
        """The next level and the numbers of its seeds; None if the island has ended."""
        rho, before = island.rho, island.levels[-1]
        keep = max(len(rho) // KEEP, 1)
        failed = int((rho <= 0).sum())
        if not len(rho):
            island.failing, island.flat = 0.0, True
            return None
        order = np.argsort(rho, kind='stable')
        below = float(rho[order[min(keep, len(rho) - 1)]])
        live = order[:keep][rho[order[:keep]] < below]
        if failed >= keep or not len(live):
            island.failing = before.probability * failed / len(rho)
            island.flat = not failed
            return None
        probability = before.probability * len(live) / len(rho)
        if probability < self._plan.floor:
            island.failing = before.probability * failed / len(rho)
            return None
        return below, live

    def _next_level(
        self, going: list[tuple[Island, float, Indices]], level: float, before: float
    ) -> Generator[Batch, tuple[Floats, Answers], None]:
        """Fill the next level of some islands by chains from their survivors."""
        plan = self._plan
        chance = self._chance()
        keep = plan.particles // KEEP
        owner = np.repeat(np.arange(len(going)), keep)
        seeds = [chance.permutation(np.resize(live, keep)) for _, _, live in going]
        at = np.vstack([one.quantiles[own] for (one, _, _), own in zip(going, seeds, strict=True)])
        rho = np.concatenate([one.rho[own] for (one, _, _), own in zip(going, seeds, strict=True)])
        below = np.array([level for _, level, _ in going])[owner]
        passed = [
            one.levels[-1].probability * len(live) / len(one.rho) for one, _, live in going
        ]
        jumps = _Jumps(self._space, at)
        walk = _Walk(self._space, jumps)
        path, heights, accepted = [at], [rho], []
        share = float(np.mean(passed))
        scaled = self._scaling(level, before)
        self._fit(scaled, level, chance)
        for _ in range(KEEP - 1):
            chance = self._chance()
            expect = self._survival(scaled, level, below, OPEN * share, chance)
            with blas_threads().limit(limits=1):
                proposed, ratio, moved = walk.moved(at, expect, self._scale, chance)
            self._scale = min(1.0, max(0.02, self._scale * math.exp(0.5 * (moved - 0.3))))
            still = (proposed == at).all(axis=1)
            tried = np.flatnonzero(~still)
            found = np.full(len(at), math.nan)
            if len(tried):
                _, answers = yield Batch(proposed[tried], False)
                found[tried] = [math.nan if one is None else one for one in answers]
                self._learn(proposed[tried], found[tried])
                self._runs += len(tried)
            takes = (found < below) & (chance.random(len(at)) < ratio)  # NaN is not below
            at = np.where(takes[:, None], proposed, at)
            rho = np.where(takes, found, rho)
            path.append(at)
            heights.append(rho)
            accepted.append(takes)
            for number, (island, _, _) in enumerate(going):
                island.runs += int((owner[tried] == number).sum())
        for number, (island, own_level, _) in enumerate(going):
            mine = owner == number
            island.quantiles = np.vstack([some[mine] for some in path])
            island.rho = np.concatenate([some[mine] for some in heights])
            island.levels.append(_level(
                own_level, passed[number], island.rho,
                float(np.mean([some[mine] for some in accepted])),
            ))

    def _chance(self) -> np.random.Generator:
        """Random numbers of the next moves."""
        self._moves += 1
        return run_generator(self._seed, self._moves, stream=_STREAM)

    # The model ---------------------------------------------------------------------------------

    def _learn(self, quantiles: Floats, rho: Floats) -> None:
        there = ~np.isnan(rho)
        self._known.append(quantiles[there])
        self._results.append(rho[there])

    def _scaling(self, level: float, before: float) -> Callable[[Floats], Floats]:
        """Robustness relative to the level, in units of the way to it."""
        results = np.concatenate(self._results)
        top = before if math.isfinite(before) else float(np.median(results))
        unit = top - level
        if not (math.isfinite(unit) and unit > 0):
            unit = abs(level) if math.isfinite(level) and level else 1.0

        def scaled(rho: Floats) -> Floats:
            found: Floats = np.clip((rho - level) / unit, -2.0, 3.0)
            return found

        return scaled

    def _chosen(self, level: float, most: int, chance: np.random.Generator) -> Indices:
        """Numbers of results to learn a level from: half of them below it, most others near."""
        results = np.concatenate(self._results)
        if len(results) <= most:
            return np.arange(len(results))
        order = np.argsort(results, kind='stable')
        count = int((results < level).sum())
        inside = chance.permutation(order[:count])[:most // 2]
        near = order[count:count + (most - len(inside)) * 2 // 3]
        rest = chance.permutation(order[count + len(near):])[:most - len(inside) - len(near)]
        return np.sort(np.concatenate([inside, near, rest]))

    def _fit(
        self, scaled: Callable[[Floats], Floats], level: float, chance: np.random.Generator
    ) -> None:
        """Fit the model's length scales around a level."""
        some = self._chosen(level, FITTED, chance)
        results = scaled(np.concatenate(self._results)[some])
        if len(set(results)) < 2:
            return
        with blas_threads().limit(limits=1):
            self._model.fit(self._features.of(np.vstack(self._known)[some]), results)

    def _survival(
        self, scaled: Callable[[Floats], Floats], level: float, below: Floats, least: float,
        chance: np.random.Generator,
    ) -> Callable[[Floats], Floats]:
        """Expected probability that points are below each chain's level, at least ``least``."""
        from scipy.special import ndtr

        some = self._chosen(level, WINDOW, chance)
        known = self._features.of(np.vstack(self._known)[some])
        results = scaled(np.concatenate(self._results)[some])
        limit = scaled(below)
        with blas_threads().limit(limits=1):
            predict = self._model.conditioned(known, results, known[:0])

        def expect(quantiles: Floats) -> Floats:
            mean, deviation = predict(self._features.of(quantiles))
            found: Floats = np.maximum(ndtr((limit - mean) / deviation), least)
            return found

        return expect


def _level(below: float, probability: float, rho: Floats, accepted: float = math.nan) -> Level:
    return Level(
        below=below, probability=probability, rho=tuple(np.sort(rho).tolist()), accepted=accepted
    )


class _Walk:
    """A Markov chain that leaves the program's distribution times a given weight unchanged."""

    def __init__(self, space: Space, jumps: _Jumps) -> None:
        self._discrete = np.array([dimension.discrete for dimension in space])
        self._jumps = jumps

    def moved(
        self, quantiles: Floats, weight: Callable[[Floats], Floats], scale: float,
        chance: np.random.Generator,
    ) -> tuple[Floats, Floats, float]:
        """Where the chains are after :data:`STEPS` steps.

        Args:
            quantiles: where they are, shape (n, d).
            weight: the weight at points, one for each chain.
            scale: typical size of a local step [standard deviations], 0..1.
            chance: random numbers.

        Returns:
            The points, the ratio of the weights before and after, and the share of the local
            steps that were accepted.
        """
        at, before = quantiles, weight(quantiles)
        now, dense = before, self._jumps.density(quantiles)
        steps = moves = 0
        for _ in range(STEPS):
            far = chance.random(len(at)) < JUMPS
            to = np.where(
                far[:, None], self._jumps.draw(len(at), chance), self._near(at, scale, chance)
            )
            then, denser = weight(to), self._jumps.density(to)
            odds = np.where(far, then * dense, then) / np.where(far, now * denser, now)
            takes = chance.random(len(at)) < odds
            at = np.where(takes[:, None], to, at)
            now, dense = np.where(takes, then, now), np.where(takes, denser, dense)
            steps += int((~far).sum())
            moves += int((takes & ~far).sum())
        return at, before / now, moves / max(steps, 1)

    def _near(self, at: Floats, scale: float, chance: np.random.Generator) -> Floats:
        """Local steps: a preconditioned Crank-Nicolson step of some coordinates.

        It leaves a normal distribution unchanged (Cotter and others, Statistical Science 28,
        2013), so it leaves the uniform one of quantiles unchanged. Categories are redrawn.
        """
        spread = chance.standard_normal((len(at), 1))
        size = np.minimum(1.0, scale * np.exp(0.7 * spread))
        shifted = _uniform(
            np.sqrt(1 - size * size) * _normal(at) + size * chance.standard_normal(at.shape)
        )
        redrawn = np.where(chance.random(at.shape) < 0.5, chance.random(at.shape), at)
        changed = chance.random(at.shape) < MOVED
        near: Floats = np.where(changed, np.where(self._discrete, redrawn, shifted), at)
        return near


class _Jumps:
    """Independent points near given ones, with their density relative to the program's.

    A mixture of the program itself and, around each given point, of products over the dimensions:
    a normal distribution around its coordinate that is wide where the points are spread as the
    program's are (chosen by leave-one-out likelihood, dimension by dimension), or its category.
    """

    def __init__(self, space: Space, points: Floats) -> None:
        self._space = space
        self._points = points
        self._discrete = np.array([dimension.discrete for dimension in space])
        self._places = self._transformed(points)
        fits = [
            [self._left_out(number, width) for width in BANDWIDTHS] for number in range(len(space))
        ]
        self._widths = np.array([BANDWIDTHS[int(np.argmax(fit))] for fit in fits])

    def draw(self, count: int, chance: np.random.Generator) -> Floats:
        """``count`` points, shape (count, d)."""
        origins = self._points[chance.integers(len(self._points), size=count)]
        width = self._widths
        shifted = _uniform(
            np.sqrt(1 - width * width) * _normal(origins)
            + width * chance.standard_normal(origins.shape)
        )
        anew = chance.random(origins.shape)
        redrawn = np.where(chance.random(origins.shape) < width, anew, origins)
        near = np.where(self._discrete, redrawn, shifted)
        drawn: Floats = np.where(chance.random((count, 1)) < OPEN, anew, near)
        return drawn

    def density(self, quantiles: Floats) -> Floats:
        """Density of :meth:`draw` over that of the program, shape (n,)."""
        places = self._transformed(quantiles)
        logs = np.zeros((len(quantiles), len(self._points)))
        for number, width in enumerate(self._widths):
            if width < 1:
                logs += self._log(number, width, places[:, number])
        near: Floats = np.exp(logs).mean(axis=1)
        return OPEN + (1 - OPEN) * near

    def _left_out(self, number: int, width: float) -> float:
        """Log likelihood of each point's coordinate by those of the others."""
        if width == 1:
            return 0.0
        dense = np.exp(self._log(number, width, self._places[:, number]))
        others = (dense.sum(axis=1) - np.diag(dense)) / max(len(dense) - 1, 1)
        return float(np.log(np.maximum(others, 1e-12)).sum())

    def _log(self, number: int, width: float, places: Floats) -> Floats:
        """Log density of coordinates around each given point's, over the program's; (n, m)."""
        own = self._places[:, number]
        if self._discrete[number]:
            prior = np.array(self._space[number].prior)
            alike = places[:, None] == own
            dense: Floats = np.log(width + (1 - width) * alike / prior[own.astype(int)])
            return dense
        off = (places[:, None] - math.sqrt(1 - width * width) * own) / width
        found: Floats = (np.square(places)[:, None] - np.square(off)) / 2 - math.log(width)
        return found

    def _transformed(self, quantiles: Floats) -> Floats:
        """Standard normal coordinates, and numbers of categories."""
        places = _normal(quantiles)
        for number, dimension in enumerate(self._space):
            if dimension.discrete:
                places[:, number] = (
                    np.searchsorted(dimension.edges, quantiles[:, number], 'right') - 1
                )
        return places


def _normal(quantiles: Floats) -> Floats:
    from scipy.special import ndtri

    found: Floats = ndtri(np.clip(quantiles, 1e-15, 1 - 1e-15))
    return found


def _uniform(normal: Floats) -> Floats:
    from scipy.special import ndtr

    found: Floats = np.minimum(ndtr(normal), math.nextafter(1.0, 0.0))
    return found


def ideal_error(island: Island, particles: int) -> float:
    """Relative standard error of one island if all points of each level were independent."""
    shares = [
        after.probability / before.probability
        for before, after in zip(island.levels, island.levels[1:], strict=False)
    ]
    if island.failing:
        shares.append(island.failing / island.reached)
    return math.sqrt(sum((1 - share) / (share * particles) for share in shares))


def relative_error(islands: Sequence[Island], particles: int) -> float:
    """Relative standard error of the islands' mean: their spread, or the ideal error if greater."""
    values = np.array([island.failing or 0.0 for island in islands])
    mean = float(values.mean())
    if not mean:
        return math.inf
    spread = float(values.std(ddof=1)) / mean
    ideal = max(ideal_error(island, particles) for island in islands)
    return max(spread, ideal) / math.sqrt(len(values))
