"""Estimates of rare failures on landscapes of known probability: splitting beside two others.

A formula for ρ replaces the simulator, vectorised over points. A landscape has five continuous
dimensions, which enter by their standard normal quantiles z, and a category; its probability of
failure is exact, as every region is a half space, a corner, or the outside of a circle. Splitting
runs as ``taxinet estimate`` does by default. The other two have as many runs as it took, repetition
by repetition:

* plain draws, of which a binomial number fails, with the Clopper-Pearson interval;
* importance sampling by cross entropy with mixtures of normal distributions (Rubinstein and Kroese,
  The Cross-Entropy Method, 2004, section 3.6; Geyer, Papaioannou and Straub, Structural Safety 76,
  2019), a tenth of whose last proposal is the program itself (Hesterberg, Technometrics 37, 1995),
  with the normal interval of the last sample's weights in the logarithm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from statistics import fmean
from typing import Any

import numpy as np
import numpy.typing as npt

from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.campaign.rates import TAIL, rate
from taxinet_ros.campaign.samplers.space import Dimension, Space
from taxinet_ros.campaign.samplers.splitting import State, estimate, particles_for
from taxinet_ros.campaign.samplers.subset_simulation import Plan, SubsetSimulation
from taxinet_ros.errors import UsageError
from taxinet_ros.processes.pool import process_pool

Floats = npt.NDArray[np.float64]

PROBABILITIES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
RUNS, ISLANDS, ERROR, FLOOR = 4000, 8, 0.3, 1e-6
"""What ``taxinet estimate`` does unless told otherwise."""
WEIGHTS = (6.0, 3.0, 1.0)
"""Of the category, the last dimension."""
SPACE = Space((
    *(Dimension(name=f'z{number}') for number in range(5)),
    Dimension(name='kind', weights=WEIGHTS),
))
_ALONG = np.array([0.7, 0.5, 0.4, 0.3, 0.1])
"""Direction of the half spaces: all dimensions matter, some more; of length 1."""

Rho = Callable[[Floats], Floats]
"""Robustness of points: standard normal quantiles, shape (n, 6), the last that of the category."""


def _beyond(probability: float) -> float:
    """Standard normal quantile that is exceeded with a probability."""
    from scipy.special import ndtri

    return -float(ndtri(probability))


def _category(points: Floats) -> npt.NDArray[np.intp]:
    from scipy.special import ndtri

    edges = ndtri(np.cumsum(WEIGHTS)[:-1] / sum(WEIGHTS))
    return np.searchsorted(edges, points[:, -1], 'right')


def _half(probability: float) -> Rho:
    limit = _beyond(probability)
    return lambda points: limit - points[:, :5] @ _ALONG


def _two(probability: float) -> Rho:
    near, far = _beyond(0.7 * probability), _beyond(0.3 * probability)

    def rho(points: Floats) -> Floats:
        along = points[:, :5] @ _ALONG
        return np.minimum(near - along, far + along)

    return rho


def _four(probability: float) -> Rho:
    limit = _beyond(math.sqrt(probability) / 2)
    return lambda points: limit - np.abs(points[:, :2]).min(axis=1)


def _ring(probability: float) -> Rho:
    radius = math.sqrt(-2 * math.log(probability))
    return lambda points: radius - np.hypot(points[:, 0], points[:, 1])


def _kinds(probability: float) -> Rho:
    shares = (0.2, 0.0, 0.8)
    limits = np.array([
        _beyond(share * probability * sum(WEIGHTS) / weight) if share else math.inf
        for share, weight in zip(shares, WEIGHTS, strict=True)
    ])

    def rho(points: Floats) -> Floats:
        along = points[:, :5] @ _ALONG
        return np.minimum(limits[_category(points)] - along, 3.0 + 0.1 * along)

    return rho


def _hidden(probability: float) -> Rho:
    limit = _beyond(probability / 2)

    def rho(points: Floats) -> Floats:
        along = points[:, :5] @ _ALONG
        return np.where(-along > limit, -0.1, limit - along)

    return rho


@dataclass(frozen=True, slots=True)
class Landscape:
    """A family of landscapes by their probability of failure.

    Attributes:
        meaning: its difficulty, in one line.
        make: robustness of points, for a probability.
    """

    meaning: str
    make: Callable[[float], Rho]


LANDSCAPES: Mapping[str, Landscape] = {
    'half': Landscape('one half space, across five dimensions', _half),
    'two': Landscape('two opposite half spaces, with 70 and 30 % of the probability', _two),
    'four': Landscape('four corners of two dimensions, separated', _four),
    'ring': Landscape('everywhere outside a circle in two dimensions', _ring),
    'kinds': Landscape('80 % in a category of 10 %, 20 % in one of 60 %', _kinds),
    'hidden': Landscape('half of it a cliff, to which no slope leads', _hidden),
}
"""All landscapes by name; nothing but plain draws can know ``hidden``."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Found:
    """One estimate.

    Attributes:
        probability: the estimate.
        low, high: 95 % interval; 1 as the upper end if nothing is known.
        runs: runs spent.
        clear: whether it claims its interval: not *unclear*, and no mere upper limit.
    """

    probability: float
    low: float
    high: float
    runs: int
    clear: bool = True


def split(
    rho: Rho, seed: int, *, runs: int = RUNS, error: float = ERROR, floor: float = FLOOR,
) -> Found:
    """Estimate as ``taxinet estimate`` does."""
    from scipy.special import ndtri

    particles = particles_for(runs, ISLANDS, floor)
    plan = Plan(particles=particles, islands=ISLANDS, error=error, floor=floor / 10, runs=runs)
    simulation = SubsetSimulation(SPACE, seed, plan)
    random = np.random.default_rng([seed, 0])
    batches = simulation.batches()
    spent = failed = 0
    batch = next(batches)
    while spent + len(batch.quantiles) <= runs:
        at = random.random(batch.quantiles.shape) if batch.drawn else batch.quantiles
        found = rho(ndtri(np.clip(at, 1e-15, 1 - 1e-15)))
        if not spent:
            failed = int((found <= 0).sum())
        spent += len(at)
        try:
            batch = batches.send((at, found.tolist()))
        except StopIteration:
            break
    told = estimate(simulation.islands, particles, ISLANDS * particles, failed)
    return Found(
        probability=told.probability, low=told.low, high=told.high, runs=spent,
        clear=told.state is State.ESTIMATED,
    )


def draw(probability: float, runs: int, seed: int) -> Found:
    """Estimate by plain draws."""
    failed = int(np.random.default_rng([seed, 1]).binomial(runs, probability))
    found = rate(failed, runs)
    return Found(probability=failed / runs, low=found.low, high=found.high, runs=runs)


# Importance sampling --------------------------------------------------------------------------

_KEPT = 0.1
"""Share of each sample that the next proposal is fitted to, until it is all failures."""
_PART = 8
"""One sample takes this part of the runs; the last takes all that are left."""
_COMPONENTS = 4
_DEFENSIVE = 0.1
"""Share of the last proposal that is the program itself."""


@dataclass(frozen=True, slots=True)
class _Mixture:
    """A mixture of normal distributions with independent coordinates."""

    shares: Floats
    """(k,)"""
    means: Floats
    """(k, d)"""
    deviations: Floats
    """(k, d)"""

    def draw(self, count: int, random: np.random.Generator) -> Floats:
        own = random.choice(len(self.shares), size=count, p=self.shares)
        noise = random.standard_normal((count, self.means.shape[1]))
        drawn: Floats = self.means[own] + self.deviations[own] * noise
        return drawn

    def logs(self, points: Floats) -> Floats:
        """Log of each component's share and density over the standard normal one; (n, k)."""
        off = (points[:, None] - self.means) / self.deviations
        found: Floats = np.log(self.shares) + (
            (points[:, None] ** 2 - off**2) / 2 - np.log(self.deviations)
        ).sum(axis=2)
        return found

    def ratio(self, points: Floats) -> Floats:
        """Density over the program's."""
        found: Floats = np.exp(self.logs(points)).sum(axis=1)
        return found


def _fitted(points: Floats, weights: Floats, random: np.random.Generator) -> _Mixture:
    """Fit by expectation maximisation with weights."""
    weights = weights / weights.sum()
    count = min(_COMPONENTS, len(points))
    first = random.choice(len(points), size=count, replace=False, p=weights) \
        if (weights > 0).sum() >= count else np.arange(count)
    spread = np.sqrt(np.maximum(np.average(
        (points - np.average(points, axis=0, weights=weights))**2, axis=0, weights=weights
    ), 0.01))
    found = _Mixture(
        np.full(count, 1 / count), points[first], np.tile(spread, (count, 1))
    )
    for _ in range(30):
        logs = found.logs(points)
        owned = np.exp(logs - logs.max(axis=1, keepdims=True))
        owned *= (weights / owned.sum(axis=1))[:, None]
        shares = owned.sum(axis=0) + 1e-6
        means = owned.T @ points / shares[:, None]
        squares = (owned[:, :, None] * (points[:, None] - means) ** 2).sum(axis=0)
        # A little of the whole spread keeps a component from collapsing on a point.
        deviations = np.sqrt((squares + 0.02 * spread**2) / (shares[:, None] + 0.02))
        found = _Mixture(shares / shares.sum(), means, np.maximum(deviations, 0.05))
    return found


def weigh(rho: Rho, runs: int, seed: int) -> Found:
    """Estimate by importance sampling."""
    random = np.random.default_rng([seed, 2])
    size = max(runs // _PART, 20)
    left = runs
    dimensions = len(SPACE)
    proposal = _Mixture(np.ones(1), np.zeros((1, dimensions)), np.ones((1, dimensions)))
    while left >= 2 * size:
        points = proposal.draw(size, random)
        left -= size
        found = rho(points)
        level = max(float(np.quantile(found, _KEPT)), 0.0)
        chosen = found <= level
        proposal = _fitted(points[chosen], 1 / proposal.ratio(points[chosen]), random)
        if not level:
            break
    plain = random.random(left) < _DEFENSIVE
    points = np.where(
        plain[:, None], random.standard_normal((left, dimensions)), proposal.draw(left, random)
    )
    ratio = _DEFENSIVE + (1 - _DEFENSIVE) * proposal.ratio(points)
    weights = np.where(rho(points) <= 0, 1 / ratio, 0.0)
    mean = float(weights.mean())
    if not mean:
        return Found(probability=0.0, low=0.0, high=1.0, runs=runs, clear=False)
    reach = _beyond(TAIL) * float(weights.std(ddof=1)) / math.sqrt(left) / mean
    return Found(
        probability=mean, low=mean * math.exp(-reach), high=min(1.0, mean * math.exp(reach)),
        runs=runs,
    )


# The study ------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """One repetition: the three estimates of one landscape."""

    splitting: Found
    plain: Found
    importance: Found


def attempt(landscape: str, probability: float, seed: int) -> Trial:
    """One repetition."""
    rho = LANDSCAPES[landscape].make(probability)
    own = split(rho, seed)
    return Trial(
        splitting=own, plain=draw(probability, own.runs, seed),
        importance=weigh(rho, own.runs, seed),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Method:
    """Estimates of one method over the repetitions; shares are of these.

    Attributes:
        error: median relative error.
        bias: mean of estimate over probability, less 1.
        gain: runs that plain draws need for the same mean square error, over those spent.
        covers: share of intervals that contain the probability, of all.
        clear: share that claims its interval (:attr:`Found.clear`).
        covers_clear, covers_clear_low, covers_clear_high: share of these that contains it, with a
            95 % interval; None without any.
        width: median of the upper end over the lower; None if the lower is 0.
    """

    error: float
    bias: float
    gain: float
    covers: float
    clear: float
    covers_clear: float | None
    covers_clear_low: float | None
    covers_clear_high: float | None
    width: float | None


def measure_rare(
    words: Sequence[str], repeats: int, progress: Callable[[int, int], object],
    *, probabilities: Sequence[float] = PROBABILITIES, workers: int | None = None, seed: int = 0,
) -> dict[str, Any]:
    """Estimate every landscape at several probabilities by the three methods.

    Args:
        words: landscapes; none for all of them.
        repeats: estimates for each landscape and probability.
        progress: called with the number of lines done and their total.
        probabilities: probabilities of failure.
        workers: number of processes; None for the number of cores.
        seed: of the first estimate; the others have those that follow.

    Raises:
        UsageError: a word is unknown, or ``repeats`` is less than 1.
    """
    for word in words:
        if word not in LANDSCAPES:
            raise UsageError(
                f'bench: landscape {word!r} is unknown; known: {", ".join(LANDSCAPES)}'
            )
    if repeats < 1:
        raise UsageError(f'bench: --repeats is {repeats}, needs to be 1 or more')
    names = [word for word in LANDSCAPES if word in words] or list(LANDSCAPES)
    cases = list(product(names, probabilities))
    lines = []
    with process_pool(workers, 'estimating worker') as pool:
        for name, probability in cases:
            seeds = range(seed, seed + repeats)
            trials = list(pool.map(partial(attempt, name, probability), seeds))
            lines.append({
                'landscape': name, 'probability': probability,
                'runs': fmean(one.splitting.runs for one in trials),
                **{
                    method: asdict(_over([getattr(one, method) for one in trials], probability))
                    for method in METHODS
                },
            })
            progress(len(lines), len(cases))
    return {
        'machine': machine_facts(), 'repeats': repeats, 'most_runs': RUNS, 'target_error': ERROR,
        'down_to': FLOOR, 'rare': lines,
    }


METHODS = ('splitting', 'plain', 'importance')


def _over(found: Sequence[Found], probability: float) -> Method:
    ratio = np.array([one.probability for one in found]) / probability
    covers = np.array([one.low <= probability <= one.high for one in found])
    clear = np.array([one.clear for one in found])
    runs = fmean(one.runs for one in found)
    square = float(np.mean((ratio - 1) ** 2))
    share = rate(int((covers & clear).sum()), int(clear.sum())) if clear.any() else None
    widths = [one.high / one.low if one.low else math.inf for one in found]
    width = float(np.median(widths))
    return Method(
        error=float(np.median(np.abs(ratio - 1))), bias=float(ratio.mean()) - 1,
        gain=(1 - probability) / (probability * square * runs),
        covers=float(covers.mean()), clear=float(clear.mean()),
        covers_clear=share and share.rate, covers_clear_low=share and share.low,
        covers_clear_high=share and share.high,
        width=width if math.isfinite(width) else None,
    )
