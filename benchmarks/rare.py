"""Estimates of rare failures on landscapes of known probability: do their intervals hold?

A formula for ρ replaces the simulator, vectorised over points. A landscape has five continuous
dimensions, which enter by their standard normal quantiles z, and a category; its probability of
failure is exact, as every region is a half space, a corner, a box, or the outside of a circle. The
estimate is that of the sampler behind ``taxinet estimate``, with its defaults. Beside it are plain
draws, as many runs as it took, of which a binomial number fails, with the Clopper-Pearson interval.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from statistics import fmean
from typing import Any

from common import Progress, leave, make_table, one_of, options, run_study

import numpy as np
import numpy.typing as npt
from rich.console import Console

from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.samplers.sampler import Exhausted
from taxinet_ros.samplers.space import Dimension, Space
from taxinet_ros.samplers.splitting import WIDE, make_splitting, particles_for
from taxinet_ros.trials.rates import rate

Floats = npt.NDArray[np.float64]

PROBABILITIES = (1e-2, 1e-3, 1e-4, 1e-5)
RUNS, ISLANDS, FLOOR = 4000, 8, 1e-5
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


def _corners(dimensions: int, probability: float) -> Rho:
    limit = _beyond(probability ** (1 / dimensions) / 2)
    return lambda points: limit - np.abs(points[:, :dimensions]).min(axis=1)


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


def _late(probability: float) -> Rho:
    """A corner of 30 % and a half space of the rest, of other dimensions than the corner's.

    On the way from 2 % of the draws down, the corner's funnel is the more probable part of each
    level but the last.
    """
    corner = 0.3 * probability
    limit = _beyond((probability - corner) / (1 - corner))
    funnel = max(0.02, 2 * corner)

    def rho(points: Floats) -> Floats:
        from scipy.special import log_ndtr

        side = log_ndtr(points[:, :2]).max(axis=1)
        way = (2 * side - math.log(corner)) / math.log(funnel / corner)
        slope = limit - points[:, 2:5] @ (_ALONG[2:] / np.linalg.norm(_ALONG[2:]))
        return np.minimum(slope, np.where(way < 1, way, math.inf))

    return rho


def _three(probability: float) -> Rho:
    centres = np.array([[0.2, 0.25], [0.75, 0.3], [0.4, 0.8]])
    sides = np.sqrt(np.array([0.6, 0.3, 0.1]) * probability)

    def rho(points: Floats) -> Floats:
        from scipy.special import ndtr

        off = np.abs(ndtr(points[:, None, :2]) - centres).max(axis=2)
        return (off - sides / 2).min(axis=1)

    return rho


def _capped(probability: float) -> Rho:
    half, usual = _half(probability), _beyond(probability) - _beyond(0.05)
    return lambda points: np.minimum(half(points), max(usual, 0.1))


def _rough(probability: float) -> Rho:
    half = _half(probability)

    def rho(points: Floats) -> Floats:
        noise = np.modf(1e4 * np.abs(np.sin(points[:, :5] @ (1e3 * _ALONG[::-1]))))[0]
        return half(points) * np.exp(6 * noise - 3)

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
    'four': Landscape('four corners of two dimensions, separated', partial(_corners, 2)),
    'corners': Landscape('eight corners of three dimensions', partial(_corners, 3)),
    'ring': Landscape('everywhere outside a circle in two dimensions', _ring),
    'kinds': Landscape('80 % in a category of 10 %, 20 % in one of 60 %', _kinds),
    'three': Landscape('three boxes, with 60, 30 and 10 % of the probability', _three),
    'late': Landscape('70 % in a half space, after a corner that leads until the end', _late),
    'capped': Landscape('a half space; equal for 95 % of the draws', _capped),
    'rough': Landscape('a half space; the sign is right, the size is noise', _rough),
    'hidden': Landscape('half of it a cliff, to which no slope leads', _hidden),
}
"""All landscapes by name; nothing but plain draws can know ``hidden``."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Found:
    """One estimate.

    Attributes:
        probability: the estimate.
        low, high: 95 % interval.
        runs: runs spent.
        plain: whether all of them were plain draws.
    """

    probability: float
    low: float
    high: float
    runs: int
    plain: bool

    @property
    def clear(self) -> bool:
        """Whether the ends of the interval are within a factor of ten."""
        return self.high <= WIDE * self.low


def split(
    rho: Rho, seed: int, *, runs: int = RUNS, floor: float = FLOOR
) -> Found:
    """Estimate as ``taxinet estimate`` does."""
    from scipy.special import ndtri

    sampler = make_splitting(SPACE, seed, runs, {
        'draws': runs // 2, 'particles': particles_for(runs, ISLANDS, floor),
        'islands': ISLANDS, 'floor': floor,
    })
    spent = 0
    with contextlib.suppress(Exhausted):
        while spent < runs:
            points = [sampler.ask()]
            while len(points) + spent < runs and sampler.needed() <= spent:
                points.append(sampler.ask())
            found = rho(ndtri(np.clip(np.array(points, dtype=float), 1e-15, 1 - 1e-15)))
            for number, value in enumerate(found.tolist()):
                sampler.tell(spent + number, value)
            spent += len(points)
    told = sampler.estimate()
    return Found(
        probability=told.probability, low=told.low, high=told.high, runs=spent,
        plain=bool(told.plain),
    )


def draw(probability: float, runs: int, seed: int) -> Found:
    """Estimate by plain draws."""
    failed = int(np.random.default_rng([seed, 1]).binomial(runs, probability))
    found = rate(failed, runs)
    return Found(probability=failed / runs, low=found.low, high=found.high, runs=runs, plain=True)


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """One repetition: the estimates of one landscape."""

    splitting: Found
    plain: Found


def attempt(landscape: str, probability: float, seed: int) -> Trial:
    """One repetition."""
    own = split(LANDSCAPES[landscape].make(probability), seed)
    return Trial(splitting=own, plain=draw(probability, own.runs, seed))


@dataclass(frozen=True, kw_only=True, slots=True)
class Method:
    """Estimates of one method over the repetitions; shares are of these.

    Attributes:
        covers, covers_low, covers_high: share of intervals that contain the probability, with a
            95 % interval.
        above, below: number of intervals that the probability is above of, and below of.
        clear: share of intervals whose ends are within a factor of ten.
        low, high: median ends of the intervals over the probability.
        error: median relative error of the mean of what was found.
        gain: runs that plain draws need for its mean square error, over those spent.
    """

    covers: float
    covers_low: float
    covers_high: float
    above: int
    below: int
    clear: float
    low: float
    high: float
    error: float
    gain: float


def measure_rare(
    words: Sequence[str], repeats: int, progress: Progress,
    *, probabilities: Sequence[float] = PROBABILITIES, workers: int | None = None, seed: int = 0,
) -> dict[str, Any]:
    """Estimate every landscape at several probabilities.

    Args:
        words: landscapes; none for all of them.
        repeats: estimates for each landscape and probability.
        progress: called with the number of lines done and their total.
        probabilities: probabilities of failure.
        workers: number of processes; None for the number of cores.
        seed: of the first estimate; the others have those that follow.
    """
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
                'plainly': fmean(one.splitting.plain for one in trials),
                **{
                    method: asdict(_over([getattr(one, method) for one in trials], probability))
                    for method in METHODS
                },
            })
            progress(len(lines), len(cases))
    return {
        'machine': machine_facts(), 'repeats': repeats, 'most_runs': RUNS, 'down_to': FLOOR,
        'rare': lines,
    }


METHODS = ('splitting', 'plain')


def _over(found: Sequence[Found], probability: float) -> Method:
    ratio = np.array([one.probability for one in found]) / probability
    low = np.array([one.low for one in found]) / probability
    high = np.array([one.high for one in found]) / probability
    above, below = int((high < 1).sum()), int((low > 1).sum())
    covers = rate(len(found) - above - below, len(found))
    cost = probability * float(np.mean((ratio - 1) ** 2)) * fmean(one.runs for one in found)
    return Method(
        covers=covers.rate, covers_low=covers.low, covers_high=covers.high,
        above=above, below=below, clear=fmean(one.clear for one in found),
        low=float(np.median(low)), high=float(np.median(high)),
        error=float(np.median(np.abs(ratio - 1))), gain=(1 - probability) / cost,
    )


def show(found: dict[str, Any], console: Console) -> None:
    """Print a table of the figures."""
    console.print(
        f'{found["repeats"]} estimates for each line, of at most {found["most_runs"]:,} runs'
    )
    table = make_table(('landscape',), (
        'fails', 'runs', 'plain', 'holds', '95 %', 'miss', 'ends', 'all plain', 'gain',
    ))
    table.collapse_padding = True
    last = ''
    for one in found['rare']:
        split = one['splitting']
        table.add_row(
            '' if one['landscape'] == last else one['landscape'], f'{one["probability"]:.0e}',
            f'{one["runs"]:,.0f}', f'{one["plainly"]:.0%}', f'{split["covers"]:.1%}',
            f'{100 * split["covers_low"]:.0f}–{100 * split["covers_high"]:.0f}',
            f'{split["above"]}/{split["below"]}',
            *(f'{one[method]["low"]:.2g}–{one[method]["high"]:.2g}' for method in METHODS),
            f'{split["gain"]:.2g}',
        )
        last = one['landscape']
    console.print(table)
    console.print(
        'plain: estimates that drew plainly; holds: intervals that contain the probability, with a '
        '95 % interval of this share; miss: how many the probability is above/below of; ends: '
        'medians over the probability, and those of as many plain draws; gain: runs that plain '
        'draws need for the same mean square error, over those spent', style='dim', soft_wrap=True,
    )
    for name in dict.fromkeys(one['landscape'] for one in found['rare']):
        console.print(f'{name}: {LANDSCAPES[name].meaning}', style='dim', soft_wrap=True)


def main(words: Sequence[str] | None = None) -> int:
    """Estimate and print."""
    parser = options(__doc__, repeats=40)
    parser.add_argument('landscapes', nargs='*', type=one_of(LANDSCAPES), metavar='LANDSCAPE',
                        help=f'{", ".join(LANDSCAPES)}; none for all')
    parser.add_argument('--seed', type=int, default=0, help='of the first estimate')
    given = parser.parse_args(words)
    measure = partial(measure_rare, given.landscapes, given.repeats, seed=given.seed)
    return run_study(measure, show, as_json=given.json)


if __name__ == '__main__':
    leave(main)
