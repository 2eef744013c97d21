"""Probability of rare failures by subset simulation: multilevel splitting with Markov chains.

A failure of probability 1e-5 is a chain of events that are not rare: a robustness below the first
level, then, given that, below a second, and so on to 0 (Au and Beck, Probabilistic Engineering
Mechanics 16, 2001; Cerou and others, Statistics and Computing 22, 2012). Each level's points are
drawn from the program's own distribution conditioned on the level before: Markov chains in the unit
cube, started at its survivors, that reject every move above the level.

**Plain draws.** Half of the runs are draws of the program itself. They alone say what the islands
cannot know, how probable a region of failures is that no slope leads to, or that a population lost.
They are the first level of the islands as well. Where enough of them fail, or their results are
equal, nothing is gained by chains, and the rest is drawn plainly.

**Islands.** The simulation is repeated on populations, the *islands*. The first one, the *pilot*,
chooses the levels, the size of the others, the model and the size of moves; it is not counted.
Given the pilot, the later islands are independent and unbiased: with levels, moves or a model
chosen by an island's own points it would not be (with its own model, the estimate of 1e-6 was twice
too great). Their distribution is skewed, as an island may lose most of the probability without a
sign of it: a region that leads on early levels takes the survivors of one that counts in the end.
So their agreement tells nothing of what all of them lost. They give a lower end that holds whatever
their distribution, and no upper end.

**Moves.** A move is cheap where a model can make it: several steps of a Markov chain that takes a
Gaussian process of the pilot's results for the robustness, and one run that accepts or rejects
their end with the exact ratio (the surrogate transition method; Liu, Monte Carlo Strategies in
Scientific Computing, 2001, section 9.4.3; Christen and Fox, Journal of Computational and Graphical
Statistics 14, 2005). So a wrong model costs acceptance, not correctness. A share of the steps jumps
to the neighbourhood of another survivor, which is how chains pass between separate regions.

Pure: the caller runs the points. ``P(robustness <= 0)`` is estimated; everything is a function of
space, seed, options and results.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from taxinet_ros.samplers.gaussian_process import (
    Features,
    GaussianProcess,
    blas_threads,
)
from taxinet_ros.samplers.histogram import Floats
from taxinet_ros.samplers.space import Space, run_generator

KEEP = 5
"""One particle in so many survives a level."""
PLAIN = 2
"""Failures among the first draws from which on the rest is drawn plainly.

With so many, as many draws again give about as narrow an interval as islands that miss little; with
more, a narrower one.
"""
WINDOW = 200
"""Most results that the model is conditioned on."""
FITTED = 120
"""Most results to which its length scales are fitted."""
CENTRES = 80
"""Most results to jump to the neighbourhood of."""
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
        wave: 0 for the pilot, then 1, 2, ….
        levels: its levels, from plain draws on.
        failing: estimated probability of failure; None before its end.
        runs: number of runs of its chains.
        quantiles, rho: its points, and their robustness.
        known, results: all its results so far, accepted or not.
    """

    wave: int
    levels: list[Level] = field(default_factory=list)
    failing: float | None = None
    runs: int = 0
    quantiles: Floats = field(default_factory=lambda: np.empty((0, 0)))
    rho: Floats = field(default_factory=lambda: np.empty(0))
    known: list[Floats] = field(default_factory=list)
    results: list[Floats] = field(default_factory=list)

    def learn(self, quantiles: Floats, rho: Floats) -> None:
        """Keep results, for the model of other islands; NaN is none."""
        there = ~np.isnan(rho)
        self.known.append(quantiles[there])
        self.results.append(rho[there])

    def end(self) -> None:
        """End it, with the failures among its points."""
        share = float((self.rho <= 0).mean()) if len(self.rho) else 0.0
        self.failing = self.levels[-1].probability * share

    def probability_below(self, rho: float) -> float:
        """Estimated probability of a robustness of at most ``rho``."""
        for level in reversed(self.levels):
            if rho < level.below or level is self.levels[0]:
                share = float(np.searchsorted(level.rho, rho, 'right')) / len(level.rho)
                return level.probability * share
        raise ValueError('the island has no level')


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
        draws: draws of the program itself at first, and as many again if it is drawn plainly.
        particles: points of the pilot at each level after them, a multiple of :data:`KEEP`; the
            islands after it have as many as twice the draws suffice for.
        islands: number of islands after the pilot; as many follow as long as the runs suffice.
        floor: probability below which an island ends without a failure.
        runs: most runs.
    """

    draws: int
    particles: int
    islands: int = 8
    floor: float = 1e-6
    runs: int = 4000


class SubsetSimulation:
    """The simulation, as a generator of batches.

    Attributes:
        islands: the islands so far, the pilot first.
        plain: why everything is drawn plainly, or ''.
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
        self.plain = ''
        self.ended = ''
        self._space = space
        self._seed = seed
        self._plan = plan
        self._features = Features(space)
        self._guides: list[_Guide] = []
        self._moves = 0
        self._runs = 0
        self._levels: list[float | None] = []
        self._particles = plan.particles

    def batches(self) -> Generator[Batch, tuple[Floats, Answers], None]:
        """Yield batches; send the quantiles that were run, shape (n, d), and their results."""
        plan = self._plan
        drawn = yield from self._draw(plan.draws)
        self.plain = _plain(drawn[1])
        if self.plain:
            yield from self._draw(plan.draws)
            self.ended = 'all plain draws are made'
            return
        parts = _parts(*drawn, plan.islands + 1)
        yield from self._wave(parts[:1])
        levels = max(len(self._levels) - 1, 1)
        rest = (2 * plan.draws - self._runs) / (plan.islands * levels * (1 - 1 / KEEP))
        self._particles = max(int(rest) // KEEP, 1) * KEEP
        fresh = len(parts[0][1]) * plan.islands
        while not self.ended:
            yield from self._wave(parts[1:])
            cost = plan.islands * max(island.runs for island in self.islands)
            if self._runs + fresh + cost > plan.runs:
                self.ended = 'the rest of the runs is too few for as many islands again'
            else:
                parts = parts[:1] + _parts(*(yield from self._draw(fresh)), plan.islands)

    def _draw(
        self, count: int
    ) -> Generator[Batch, tuple[Floats, Answers], tuple[Floats, Floats]]:
        """Draws of the program itself, and their robustness; NaN without a result."""
        nowhere = np.full((count, len(self._space)), np.nan)
        quantiles, answers = yield Batch(nowhere, True)
        self._runs += count
        return quantiles, np.array([math.nan if rho is None else rho for rho in answers])

    def _wave(
        self, parts: Sequence[tuple[Floats, Floats]]
    ) -> Generator[Batch, tuple[Floats, Answers], None]:
        """Take islands, each with its part of the plain draws, to their end, level by level."""
        wave = self.islands[-1].wave + 1 if self.islands else 0
        islands = [Island(wave=wave) for _ in parts]
        for island, (quantiles, rho) in zip(islands, parts, strict=True):
            there = ~np.isnan(rho)
            island.quantiles, island.rho = quantiles[there], rho[there]
            island.learn(quantiles, rho)
            island.levels.append(_level(math.inf, 1.0, island.rho))
        self.islands += islands
        for number in itertools.count():
            going = [one for one in islands if one.failing is None]
            if not going:
                return
            if number == len(self._levels):
                self._choose_level(going[0])
            before = self._levels[number - 1] if number else math.inf
            level = self._levels[number]
            seeds = []
            for one in going:
                live = np.flatnonzero(one.rho < (-math.inf if level is None else level))
                if len(live):
                    seeds.append((one, live))
                else:
                    one.end()
            if seeds:
                assert level is not None
                assert before is not None
                yield from self._next_level(seeds, level, before)

    def _choose_level(self, pilot: Island) -> None:
        """Add the next level, or None where the islands end."""
        rho = np.sort(pilot.rho)
        keep = max(len(rho) // KEEP, 1)
        below = float(rho[min(keep, len(rho) - 1)]) if len(rho) else 0.0
        passed = int((rho < below).sum())
        reached = pilot.levels[-1].probability
        ends = below <= 0 or not passed or reached * passed / len(rho) < self._plan.floor
        self._levels.append(None if ends else below)

    def _next_level(
        self, going: list[tuple[Island, Indices]], level: float, before: float
    ) -> Generator[Batch, tuple[Floats, Answers], None]:
        """Fill the next level of some islands by chains from their survivors."""
        chance = self._chance()
        keep = self._particles // KEEP
        owner = np.repeat(np.arange(len(going)), keep)
        # Which survivors have one chain more than others, or none, is left to chance.
        seeds = [np.resize(chance.permutation(live), keep) for _, live in going]
        at = np.vstack([one.quantiles[own] for (one, _), own in zip(going, seeds, strict=True)])
        rho = np.concatenate([one.rho[own] for (one, _), own in zip(going, seeds, strict=True)])
        passed = [one.levels[-1].probability * len(live) / len(one.rho) for one, live in going]
        path, heights, accepted = [at], [rho], []
        number, pilot = len(going[0][0].levels) - 1, not going[0][0].wave
        if pilot:
            scale = self._guides[-1].scale if self._guides else 0.5
            self._guides.append(_Guide(
                self._space, self._features, self.islands[0], level, before, chance, scale
            ))
        guide = self._guides[number]
        guide.learn(chance)
        for _ in range(KEEP - 1):
            chance = self._chance()
            proposed, ratio, moved = guide.moved(at, chance)
            still = (proposed == at).all(axis=1)
            tried = np.flatnonzero(~still)
            found = np.full(len(at), math.nan)
            if len(tried):
                _, answers = yield Batch(proposed[tried], False)
                found[tried] = [math.nan if one is None else one for one in answers]
                for place, (island, _) in enumerate(going):
                    own = tried[owner[tried] == place]
                    island.learn(proposed[own], found[own])
                self._runs += len(tried)
            takes = (found < level) & (chance.random(len(at)) < ratio)  # NaN is not below
            at = np.where(takes[:, None], proposed, at)
            rho = np.where(takes, found, rho)
            if pilot:
                guide.adapt(moved)
                guide.learn(chance)
            path.append(at)
            heights.append(rho)
            accepted.append(takes)
            for place, (island, _) in enumerate(going):
                island.runs += int((owner[tried] == place).sum())
        for place, (island, _) in enumerate(going):
            mine = owner == place
            island.quantiles = np.vstack([some[mine] for some in path])
            island.rho = np.concatenate([some[mine] for some in heights])
            island.levels.append(_level(
                level, passed[place], island.rho,
                float(np.mean([some[mine] for some in accepted])),
            ))

    def _chance(self) -> np.random.Generator:
        """Random numbers of the next moves."""
        self._moves += 1
        return run_generator(self._seed, self._moves, stream=_STREAM)


def _plain(rho: Floats) -> str:
    """Why draws with such results are better followed by plain ones than by chains, or ''."""
    known = np.sort(rho[~np.isnan(rho)])
    failed = int((known <= 0).sum())
    if failed >= PLAIN:
        return f'{failed} of the first {len(known):,} failed'
    if not len(known) or known[0] == known[len(known) // 50]:
        return f'the least results of the first {len(known):,} are equal'
    return ''


def _parts(quantiles: Floats, rho: Floats, count: int) -> list[tuple[Floats, Floats]]:
    """Draws in equal parts, one for each island."""
    return [
        (quantiles[own], rho[own]) for own in np.array_split(np.arange(len(rho)), count)
    ]


class _Guide:
    """Proposes moves at a level by the results of the pilot: a model, and jumps to where it was.

    Attributes:
        scale: typical size of a local step [standard deviations], 0..1.
    """

    def __init__(
        self, space: Space, features: Features, pilot: Island, level: float, before: float,
        chance: np.random.Generator, scale: float,
    ) -> None:
        """Fit the model's length scales around a level."""
        self.scale = scale
        self._space = space
        self._features = features
        self._model = GaussianProcess(features)
        self._pilot = pilot
        quantiles, rho = self._results()
        top = before if math.isfinite(before) else float(np.median(rho))
        self._level, self._unit = level, top - level
        if not (math.isfinite(self._unit) and self._unit > 0):
            self._unit = abs(level) if math.isfinite(level) and level else 1.0
        some = self._chosen(rho, FITTED, chance)
        scaled = self._scaled(rho[some])
        if len(set(scaled)) > 1:
            with blas_threads().limit(limits=1):
                self._model.fit(features.of(quantiles[some]), scaled)

    def learn(self, chance: np.random.Generator) -> None:
        """Condition the model on the pilot's results so far, and choose where to jump."""
        quantiles, rho = self._results()
        inside = chance.permutation(np.flatnonzero(rho < self._level))[:CENTRES]
        self._walk = _Walk(self._space, _Jumps(self._space, quantiles[inside]))
        some = self._chosen(rho, WINDOW, chance)
        known = self._features.of(quantiles[some])
        with blas_threads().limit(limits=1):
            self._predict = self._model.conditioned(known, self._scaled(rho[some]), known[:0])

    def moved(self, at: Floats, chance: np.random.Generator) -> tuple[Floats, Floats, float]:
        """Where chains are after some steps; see :meth:`_Walk.moved`."""
        with blas_threads().limit(limits=1):
            return self._walk.moved(at, self._survival, self.scale, chance)

    def adapt(self, moved: float) -> None:
        """Change the size of the steps by the share of them that was accepted."""
        self.scale = min(1.0, max(0.02, self.scale * math.exp(0.5 * (moved - 0.3))))

    def _survival(self, points: Floats) -> Floats:
        """Expected probability that points are below the level, as the weight of their moves."""
        from scipy.special import ndtr

        mean, deviation = self._predict(self._features.of(points))
        found: Floats = np.maximum(ndtr(-mean / deviation), OPEN / KEEP)
        return found

    def _results(self) -> tuple[Floats, Floats]:
        """All results of the pilot."""
        return np.vstack(self._pilot.known), np.concatenate(self._pilot.results)

    def _scaled(self, rho: Floats) -> Floats:
        """Robustness relative to the level, in units of the way to it."""
        found: Floats = np.clip((rho - self._level) / self._unit, -2.0, 3.0)
        return found

    def _chosen(self, rho: Floats, most: int, chance: np.random.Generator) -> Indices:
        """Numbers of results to learn a level from: half of them below it, most others near."""
        if len(rho) <= most:
            return np.arange(len(rho))
        order = np.argsort(rho, kind='stable')
        count = int((rho < self._level).sum())
        inside = chance.permutation(order[:count])[:most // 2]
        near = order[count:count + (most - len(inside)) * 2 // 3]
        rest = chance.permutation(order[count + len(near):])[:most - len(inside) - len(near)]
        return np.sort(np.concatenate([inside, near, rest]))


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
        if not len(self._points):
            return chance.random((count, len(self._space)))
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
        if not len(self._points):
            return np.ones(len(quantiles))
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
