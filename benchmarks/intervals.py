"""Coverage of confidence intervals, in searches of landscapes whose failure rate is known.

The samplers are the real ones; a formula for ρ replaces the simulator. Each repetition is one
search, whose first 100, 400 and 1,000 runs are rated by the functions that rate a campaign.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from typing import Any

from common import Progress, leave, make_table, one_of, options, run_study

import numpy as np
from rich.console import Console

from taxinet_ros.analysis.gate.criteria import bounds
from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.samplers.registry import SAMPLERS, drawn_share, make_sampler
from taxinet_ros.samplers.space import Dimension, Point
from taxinet_ros.trials.rates import ProgramRate

RUNS = (100, 400, 1000)
RATES = (0.5, 0.1, 0.01, 0.001)
LOOK = 20
"""Runs between two looks of an observer who watches a search."""

_SPACE = (
    Dimension(name='x'), Dimension(name='y'), Dimension(name='z'),
    Dimension(name='kind', weights=(2, 1, 1)),
)
_CONFIDENCE = 0.95
_USUAL = ('random', 'ce', 'mab')
"""Samplers measured by default: those that are fast enough."""

Rho = Callable[[Point], float]


@dataclass(frozen=True, kw_only=True, slots=True)
class Held:
    """Coverage of one sampler's intervals at one failure rate; shares are of the repetitions.

    Attributes:
        sampler, rate: sampler and failure rate.
        repeats: number of searches, the landscapes in turn.
        drawn: mean number of runs drawn by the program itself, per number of runs.
        covers: share in which the 95 % interval contains the rate, per number of runs.
        width: median width of that interval, per number of runs.
        passes: share in which the gate says PASS at a threshold equal to the true rate of
            satisfied runs, per number of runs.
        watched_covers: share in which the anytime interval contains the rate at all looks.
        watched_passes: share in which the gate says PASS at any look, with 100 runs planned.
    """

    sampler: str
    rate: float
    repeats: int
    drawn: tuple[float, ...]
    covers: tuple[float, ...]
    width: tuple[float, ...]
    passes: tuple[float, ...]
    watched_covers: float
    watched_passes: float


def _band(rate: float) -> Rho:
    return lambda point: abs((point[0] or 0.0) - 0.6) - rate / 2


def _corner(rate: float) -> Rho:
    side = rate**0.5
    return lambda point: max(point[0] or 0.0, point[1] or 0.0) - side


def _diagonal(rate: float) -> Rho:
    half = 1 - (1 - rate) ** 0.5
    return lambda point: abs((point[0] or 0.0) - (point[1] or 0.0)) - half


def _two_regions(rate: float) -> Rho:
    half = (rate / 2) ** 0.5 / 2

    def rho(point: Point) -> float:
        x, y = point[0] or 0.0, point[1] or 0.0
        return min(max(abs(x - at), abs(y - at)) for at in (0.25, 0.75)) - half

    return rho


LANDSCAPES: Mapping[str, Callable[[float], Rho]] = {
    'band': _band, 'corner': _corner, 'diagonal': _diagonal, 'two regions': _two_regions,
}
"""Robustness with a given failure rate over quantiles of x and y, by name."""


def measure_intervals(
    samplers: Sequence[str], repeats: int, progress: Progress,
    *, runs: Sequence[int] = RUNS, rates: Sequence[float] = RATES, workers: int | None = None,
) -> dict[str, Any]:
    """Search every landscape with every sampler and measure the coverage of the intervals.

    Args:
        samplers: words; none for the usual ones. One that draws no runs gets ``floor=0.3``.
        repeats: searches for each sampler and rate, the landscapes in turn.
        progress: called with the number of searches done and their total.
        runs: numbers of runs after which to rate, ascending.
        rates: true failure rates.
        workers: number of processes; None for one per core.
    """
    words = list(dict.fromkeys(samplers)) or list(_USUAL)
    cases = list(product(words, rates))
    found = []
    with process_pool(workers, 'searching worker') as pool:  # after Ctrl-C, results so far suffice
        for number, (word, rate) in enumerate(cases):
            search = partial(_search, word, rate, tuple(runs))
            done = []
            searches = map(search, range(repeats)) if workers == 1 else pool.map(
                search, range(repeats), chunksize=5
            )
            for one in searches:
                done.append(one)
                progress(number * repeats + len(done), len(cases) * repeats)
            found.append(_held(word, rate, done))
    return {
        'machine': machine_facts(), 'runs': list(runs), 'repeats': repeats, 'look': LOOK,
        'landscapes': list(LANDSCAPES), 'intervals': [asdict(one) for one in found],
    }


@dataclass(frozen=True, kw_only=True, slots=True)
class _Search:
    """Result of one repetition."""

    drawn: tuple[int, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    passes: tuple[bool, ...]
    watched_covers: bool
    watched_passes: bool


def _search(word: str, rate: float, runs: tuple[int, ...], seed: int) -> _Search:
    rho = list(LANDSCAPES.values())[seed % len(LANDSCAPES)](rate)
    own = {} if drawn_share(word, {}) else {'floor': 0.3}
    sampler = make_sampler(word, _SPACE, seed, runs[-1], **own)
    failed = np.zeros(runs[-1], dtype=bool)
    drawn = np.zeros(runs[-1], dtype=bool)
    for number in range(runs[-1]):
        index, point = sampler.next()
        value = rho(point)
        sampler.tell(index, value)
        failed[number], drawn[number] = value <= 0, sampler.drawn(index)

    def rated(number: int, *, anytime: bool, good: bool = False) -> ProgramRate:
        hits = ~failed[:number] if good else failed[:number]
        return ProgramRate(
            runs=number, hits=int(hits.sum()), drawn=int(drawn[:number].sum()),
            drawn_hits=int((hits & drawn[:number]).sum()), anytime=anytime, sampler=word,
        )

    def passes(number: int, *, anytime: bool) -> bool:
        good = rated(number, anytime=anytime, good=True)
        return bounds(good, _CONFIDENCE).low >= 1 - rate

    ends = [rated(number, anytime=False).rate for number in runs]
    looks = range(LOOK, runs[-1] + 1, LOOK)
    return _Search(
        drawn=tuple(int(drawn[:number].sum()) for number in runs),
        low=tuple(one.low if one else 0.0 for one in ends),
        high=tuple(one.high if one else 1.0 for one in ends),
        passes=tuple(passes(number, anytime=False) for number in runs),
        watched_covers=all(
            one.low <= rate <= one.high
            for one in (rated(look, anytime=True).rate for look in looks) if one
        ),
        watched_passes=any(passes(look, anytime=look != runs[0]) for look in looks),
    )


def _held(word: str, rate: float, done: Sequence[_Search]) -> Held:
    return Held(
        sampler=word, rate=rate, repeats=len(done),
        drawn=_means(one.drawn for one in done),
        covers=_means(
            [low <= rate <= high for low, high in zip(one.low, one.high, strict=True)]
            for one in done
        ),
        width=tuple(
            statistics.median(widths) for widths in zip(
                *([high - low for low, high in zip(one.low, one.high, strict=True)]
                  for one in done), strict=True,
            )
        ),
        passes=_means(one.passes for one in done),
        watched_covers=statistics.fmean(one.watched_covers for one in done),
        watched_passes=statistics.fmean(one.watched_passes for one in done),
    )


def _means(rows: Iterable[Sequence[float]]) -> tuple[float, ...]:
    return tuple(statistics.fmean(column) for column in zip(*rows, strict=True))


def show(found: dict[str, Any], console: Console) -> None:
    """Print a table of the figures."""
    runs = ', '.join(f'{number:,}' for number in found['runs'])
    console.print(
        f'{found["repeats"]} searches for each line, {", ".join(found["landscapes"])} in turn; '
        f'after {runs} runs', soft_wrap=True,
    )
    table = make_table(('sampler',), (
        'fail', 'runs', 'drawn', 'covers', 'width', 'gate', 'watched', 'gate, watched',
    ))
    for one in found['intervals']:
        for number, runs_made in enumerate(found['runs']):
            last = number + 1 == len(found['runs'])
            table.add_row(
                one['sampler'], f'{100 * one["rate"]:g} %', f'{runs_made:,}',
                f'{one["drawn"][number]:.0f}',
                *(f'{100 * one[name][number]:.1f} %' for name in ('covers', 'width', 'passes')),
                *(f'{100 * one[name]:.1f} %' if last else ''
                  for name in ('watched_covers', 'watched_passes')),
            )
    console.print(table)
    console.print(
        'covers: share of 95 % intervals that contain the rate, and their median width. gate: '
        'wrong passes at exactly the true rate, at most 5 %. watched: the same with a look every '
        f'{found["look"]} runs and stopping at will', style='dim', soft_wrap=True,
    )


def main(words: Sequence[str] | None = None) -> int:
    """Search and print."""
    parser = options(__doc__, repeats=40)
    parser.add_argument('samplers', nargs='*', type=one_of(list(SAMPLERS)), metavar='SAMPLER',
                        help=f'none for {", ".join(_USUAL)}')
    given = parser.parse_args(words)
    measure = partial(measure_intervals, given.samplers, given.repeats)
    return run_study(measure, show, as_json=given.json)


if __name__ == '__main__':
    leave(main)
