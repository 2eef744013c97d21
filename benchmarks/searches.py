"""Search performance of the samplers on synthetic landscapes with known failure regions.

A formula for ρ replaces the simulator. Lengths are in quantiles, so the volume of a region in the
unit cube is its probability under the program. Each repetition is one search whose results arrive
as late as with eight workers, so the sampler knows as little as it ever does.
"""

from __future__ import annotations

import math
import time
import zlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from statistics import fmean
from typing import Any

from common import Progress, leave, make_table, one_of, options, run_study

from rich.console import Console

from taxinet_ros import registry
from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.samplers.registry import SAMPLERS, make_sampler
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.samplers.space import Branch, Dimension, Point, Space, alike

APART = 0.15
"""Two failures are distinct if a coordinate differs by more than this [quantiles]."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Landscape:
    """Robustness by point.

    Attributes:
        meaning: its difficulty, in one line.
        space: the searched space.
        parts: maps a point to the robustness that each failure region alone would give it.
        shape: maps the least of them and the point to its robustness, which is 0 or less (a
            failure) if the least is.
    """

    meaning: str
    space: Space
    parts: Callable[[Point], Sequence[float]]
    shape: Callable[[float, Point], float] = lambda least, point: least

    def rho(self, point: Point) -> float:
        """Robustness of a point; 0 or less is a failure."""
        return self.shape(min(self.parts(point)), point)

    def region(self, point: Point) -> int:
        """Index of the region that a failure belongs to."""
        parts = self.parts(point)
        return min(range(len(parts)), key=parts.__getitem__)

    @property
    def regions(self) -> int:
        """Number of separate failure regions."""
        return len(self.parts(self.space.point([0.5] * len(self.space))))


def count_distinct(space: Space, failures: Sequence[Point]) -> int:
    """Number of distinct failures: a greedy cover, in the order in which they were found.

    A failure counts if it differs from each one counted before: in a category, in whether a
    dimension is idle, or by more than :data:`APART` in some coordinate.
    """
    counted: list[Point] = []
    for point in failures:
        if not any(alike(space, point, other, APART) for other in counted):
            counted.append(point)
    return len(counted)


def _radius(share: float) -> float:
    """Radius of a disc with this share of the unit square."""
    return math.sqrt(share / math.pi)


def _continuous(dimensions: int) -> Space:
    return Space(Dimension(name=f'x{number}') for number in range(dimensions))


def _at(point: Point, first: int) -> tuple[float, float]:
    """Two adjacent coordinates of dimensions that are never idle."""
    return point[first] or 0.0, point[first + 1] or 0.0

_TWO = {(0.21, 0.72): 0.0075, (0.76, 0.27): 0.0075}
_FOUR = {(0.17, 0.22): 0.005, (0.71, 0.13): 0.006, (0.34, 0.81): 0.008, (0.86, 0.66): 0.01}
_EIGHT = {
    (0.5 + 0.38 * math.cos(angle), 0.5 + 0.38 * math.sin(angle)): 0.005
    for angle in (number * math.pi / 4 for number in range(8))
}


def _discs(
    meaning: str, dimensions: int, shares: Mapping[tuple[float, float], float],
    shape: Callable[[float, Point], float] = lambda least, point: least,
) -> Landscape:
    """Landscape of signed distance to discs in the first two dimensions; others do not matter.

    Args:
        meaning: see :class:`Landscape`.
        dimensions: number of dimensions of its space, all continuous.
        shares: share of the unit square of each disc, by its centre.
        shape: see :class:`Landscape`.
    """
    def parts(point: Point) -> list[float]:
        at = _at(point, 0)
        return [math.dist(at, centre) - _radius(share) for centre, share in shares.items()]

    return Landscape(meaning=meaning, space=_continuous(dimensions), parts=parts, shape=shape)


def _corner(dimensions: int) -> Landscape:
    side = math.sqrt(0.001)
    return Landscape(
        meaning=f'a corner of 0.1 %; 2 of {dimensions} dimensions matter',
        space=_continuous(dimensions), parts=lambda point: [max(_at(point, 0)) - side],
    )


def _noisy(least: float, point: Point) -> float:
    """Shape with noise that is a function of the point, but no failures elsewhere."""
    noise = zlib.crc32(repr(point).encode()) / 2**32 - 0.5
    return least if least <= 0 else max(least + 0.2 * noise, 1e-6)


def _decoyed(least: float, point: Point) -> float:
    """Shape with a wide basin elsewhere, whose minimum is 0.02."""
    return min(least, 0.02 + 0.8 * math.dist(_at(point, 0), (0.8, 0.8)))


def _balls() -> Landscape:
    centres = (
        (0.2, 0.3, 0.7, 0.4), (0.8, 0.7, 0.2, 0.3), (0.3, 0.8, 0.3, 0.8), (0.7, 0.2, 0.8, 0.7),
    )
    radius = (0.008 * 2 / math.pi**2) ** 0.25  # of a four-dimensional ball with this volume

    def parts(point: Point) -> list[float]:
        at = (*_at(point, 0), *_at(point, 2))
        return [math.dist(at, centre) - radius for centre in centres]

    return Landscape(meaning='four balls of 0.8 %; all 4 matter', space=_continuous(4), parts=parts)


def _categories() -> Landscape:
    space = Space((
        Dimension(name='clouds', weights=(1,) * 6), *_continuous(3),
        Dimension(name='rain', weights=(2, 1)),
    ))

    def parts(point: Point) -> list[float]:
        clouds, *_, rain = space.bins(point)
        at = _at(point, 1)
        return [
            math.dist(at, (0.3, 0.7)) - _radius(0.04) + (0.0 if clouds == 2 else 0.3),
            math.dist(at, (0.7, 0.2)) - _radius(0.03) + (0.0 if rain == 1 else 0.3),
        ]

    return Landscape(
        meaning='0.7 % under one of six skies, 1 % in rain', space=space, parts=parts,
    )


def _conditional() -> Landscape:
    dry, wet = Branch('weather', (0,)), Branch('weather', (1,))
    space = Space((
        Dimension(name='weather', weights=(2, 1)),
        Dimension(name='dry sky', weights=(1,) * 6, when=(dry,)),
        Dimension(name='wet sky', weights=(1,) * 3, when=(wet,)),
        Dimension(name='rain', when=(wet,)), *_continuous(3),
    ))

    def parts(point: Point) -> list[float]:
        sky, rain, at = space.bins(point)[1], point[3], _at(point, 4)
        return [
            math.dist(at, (0.65, 0.3)) - _radius(0.06)
            + (0.3 if rain is None else max(0.0, 0.7 - rain)),
            math.dist(at, (0.2, 0.8)) - _radius(0.05) + (0.0 if sky == 4 else 0.2),
        ]

    return Landscape(
        meaning='0.6 % in heavy rain, 0.6 % under one dry sky; idle branches', space=space,
        parts=parts,
    )

LANDSCAPES: Mapping[str, Landscape] = {
    'corner': _corner(4),
    'corner-2': _corner(2),
    'corner-6': _corner(6),
    'twins': _discs('two discs of 0.75 %; 2 of 4 dimensions matter', 4, _TWO),
    'twins-2': _discs('the same; both of 2 matter', 2, _TWO),
    'twins-6': _discs('the same; 2 of 6 matter', 6, _TWO),
    'four': _discs('four discs of 0.5 to 1 %; 2 of 4 matter', 4, _FOUR),
    'four-2': _discs('the same; both of 2 matter', 2, _FOUR),
    'four-6': _discs('the same; 2 of 6 matter', 6, _FOUR),
    'eight': _discs('eight discs of 0.5 %; 2 of 4 matter', 4, _EIGHT),
    'balls': _balls(),
    'categories': _categories(),
    'conditional': _conditional(),
    'plateau': _discs(
        'twins, level farther away than 0.1', 4, _TWO, lambda least, point: min(least, 0.1)
    ),
    'steps': _discs(
        'twins, in steps of 0.1', 4, _TWO, lambda least, point: math.ceil(least / 0.1) * 0.1
    ),
    'stopped': _discs(
        'four, failures all told as 0', 4, _FOUR, lambda least, point: max(least, 0.0)
    ),
    'rough': _discs('twins, with noise of 0.2', 4, _TWO, _noisy),
    'decoy': _discs(
        'a disc of 0.7 %, and a wide basin without', 4, {(0.12, 0.15): 0.007}, _decoyed
    ),
    'blind': _discs(
        'twins, 1 or -1', 4, _TWO, lambda least, point: 1.0 if least > 0 else -1.0
    ),
    'most': Landscape(
        meaning='all but 4 % fails; 2 of 4 matter', space=_continuous(4),
        parts=lambda point: [0.1 - max(abs(each - 0.5) for each in _at(point, 0))],
    ),
}
"""All landscapes by name."""


RUNS = 200
"""Runs of each search."""
_SLOW = ('bo', 'tpe')
"""Samplers that take a second or more per search; measured only if named."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Search:
    """Result of one search, or means over several.

    Attributes:
        found: whether it found a failure; over several, the share that did.
        regions: share of the failure regions that it found.
        failures: number of failed runs.
        distinct: distinct failures (:func:`count_distinct`).
        ask_s: processor time for choosing a run and processing its result [s].
    """

    found: float
    regions: float
    failures: float
    distinct: float
    ask_s: float


def measure_searches(
    words: Sequence[str], repeats: int, progress: Progress,
) -> dict[str, Any]:
    """Search landscapes with samplers, ``repeats`` times each.

    Args:
        words: samplers and landscapes; without samplers all but the slow ones, without landscapes
            all of them.
        repeats: searches for each landscape and sampler, with the seeds 0, 1, ….
        progress: called with the number of landscape-sampler pairs done and their total.
    """
    samplers = [word for word in SAMPLERS if word in words] or [
        word for word in registry.SHIPPED[registry.SAMPLERS] if word not in _SLOW
    ]
    landscapes = [word for word in LANDSCAPES if word in words] or list(LANDSCAPES)
    cases = list(product(landscapes, samplers))
    found = []
    with process_pool(None, 'searching worker') as pool:
        for number, (landscape, word) in enumerate(cases):
            done = list(pool.map(partial(search, landscape, word), range(repeats)))
            found.append({'landscape': landscape, 'sampler': word, **asdict(_mean(done))})
            progress(number + 1, len(cases))
    return {'machine': machine_facts(), 'runs': RUNS, 'repeats': repeats, 'searches': found}


def search(landscape: str, word: str, seed: int, runs: int = RUNS) -> Search:
    """Search a landscape once with a sampler of the table."""
    place = LANDSCAPES[landscape]
    sampler = make_sampler(word, place.space, seed, runs)
    spent_s = 0.0
    failures: list[Point] = []
    under_way: deque[tuple[int, Point]] = deque()

    def end() -> None:
        index, point = under_way.popleft()
        rho = place.rho(point)
        sampler.tell(index, rho)
        if rho <= 0:
            failures.append(point)

    for _ in range(runs):
        if len(under_way) == LAG:
            end()
        start_s = time.process_time()
        under_way.append(sampler.next())
        spent_s += time.process_time() - start_s
    while under_way:
        end()
    return Search(
        found=bool(failures),
        regions=len({place.region(point) for point in failures}) / place.regions,
        failures=len(failures), distinct=count_distinct(place.space, failures),
        ask_s=spent_s / runs,
    )


def _mean(done: Sequence[Search]) -> Search:
    return Search(**{
        name: fmean(getattr(one, name) for one in done)
        for name in ('found', 'regions', 'failures', 'distinct', 'ask_s')
    })


def show(found: dict[str, Any], console: Console) -> None:
    """Print a table of the figures."""
    console.print(f'{found["repeats"]} searches of {found["runs"]} runs for each line')
    table = make_table(
        ('landscape', 'sampler'), ('found', 'regions', 'failures', 'distinct', 'ask'),
    )
    last = ''
    for one in found['searches']:
        table.add_row(
            '' if one['landscape'] == last else one['landscape'], one['sampler'],
            f'{one["found"]:.0%}', f'{one["regions"]:.0%}', f'{one["failures"]:.1f}',
            f'{one["distinct"]:.1f}', f'{1e3 * one["ask_s"]:.2f} ms',
        )
        last = one['landscape']
    console.print(table)
    console.print(
        'found: searches with a failure; regions: share of the failure regions found; distinct: '
        f'failures that differ in category, or by {APART:g} of a dimension; ask: processor time',
        style='dim', soft_wrap=True,
    )
    for name in dict.fromkeys(one['landscape'] for one in found['searches']):
        console.print(f'{name}: {LANDSCAPES[name].meaning}', style='dim', soft_wrap=True)


def main(words: Sequence[str] | None = None) -> int:
    """Search and print."""
    parser = options(__doc__, repeats=40)
    parser.add_argument(
        'words', nargs='*', type=one_of([*SAMPLERS, *LANDSCAPES]), metavar='SAMPLER|LANDSCAPE',
        help=f'without samplers all but {" and ".join(_SLOW)}, without landscapes all',
    )
    given = parser.parse_args(words)
    measure = partial(measure_searches, given.words, given.repeats)
    return run_study(measure, show, as_json=given.json)


if __name__ == '__main__':
    leave(main)
