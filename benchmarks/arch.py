"""ARCH-COMP's falsification benchmarks: how many simulations do the samplers need?

Chasing Cars (CC) and Automatic Transmission (AT), instance 2 of the competition: inputs that are
constant for 5 s each, one dimension for each value. Samplers are those of ``taxinet falsify``, with
its delay of results (as with eight workers); a formula is falsified once rho < 0. Beside them are
``annealing``, SciPy's dual annealing without local search, which PSY-TaLiRo uses
(github.com/cpslab-asu/psy-taliro), and ``corners``, which draws every other simulation from the
corners of the space, after Hybrid-Corner-Random (in "Testing Cyber-Physical Systems Using a
Line-Search Falsification Method"). Both get each result at once.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, product
from queue import SimpleQueue
from typing import Any, Protocol

from common import Progress, leave, make_table, one_of, options, positive, run_study
from common import count as whole

import numpy as np
from arch_models import (
    CARS_S,
    SEGMENT_S,
    TRANSMISSION_S,
    Floats,
    Traces,
    automatic_transmission,
    chasing_cars,
)
from rich.console import Console
from scipy.optimize import dual_annealing
from scipy.stats import binomtest

from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.core.mtl import Spec, parse_spec, robustness
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.samplers.gaussian_process import blas_threads
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.space import Dimension

RUNS = 300
"""Simulations of a search, as published runs of 2024 have (their notebook is with the models)."""
SAMPLERS = ('random', 'halton', 'ce', 'mab', 'active', 'tpe', 'bo', 'cmaes')
SLOW = ('tpe', 'bo')
"""Samplers that take 10 to 200 ms for each point, measured only if named."""
OTHERS = ('annealing', 'corners')


@dataclass(frozen=True, kw_only=True, slots=True)
class Model:
    """A system of the competition.

    Attributes:
        simulate: maps inputs, shape (simulations, segments, inputs), and a length [s] to traces.
        segments: number of times at which each input is chosen.
        most: greatest value of each input; the least is 0.
        signals: what its formulas may read.
    """

    simulate: Callable[[Floats, float], Traces]
    segments: int
    most: tuple[float, ...]
    signals: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of dimensions."""
        return self.segments * len(self.most)

    def inputs(self, points: Sequence[Sequence[float | None]]) -> Floats:
        """Inputs of points, whose coordinates are quantiles in the order of time."""
        shape = (len(points), self.segments, len(self.most))
        return np.array(points, dtype=float).reshape(shape) * self.most


CC = Model(
    simulate=chasing_cars, segments=CARS_S // SEGMENT_S, most=(1.0, 1.0),
    signals=('y1', 'y2', 'y3', 'y4', 'y5'),
)
AT = Model(
    simulate=automatic_transmission, segments=-(-TRANSMISSION_S // SEGMENT_S), most=(100.0, 325.0),
    signals=('speed', 'rpm', 'gear'),
)


def _stays(gear: int) -> str:
    chosen = f'abs(gear - {gear}) <= 0.5'
    soon = f'eventually[0.001:0.1](always[0:2.5]({chosen}))'
    enters = f'not ({chosen}) and eventually[0.001:0.1]({chosen})'
    return f'always[0:30](({enters}) implies {soon})'


def _slow(*limits: tuple[int, int]) -> str:
    least = ' and '.join(f'always[0:{until_s}](speed < {speed})' for until_s, speed in limits)
    return f'always[0:30](rpm < 3000) implies ({least})'


FORMULAS: Mapping[str, tuple[Model, float, str]] = {
    'CC1': (CC, 100, 'always[0:100](y5 - y4 <= 40)'),
    'CC2': (CC, 100, 'always[0:70](eventually[0:30](y5 - y4 >= 15))'),
    'CC3': (CC, 100, 'always[0:80](always[0:20](y2 - y1 <= 20)'
                     ' or eventually[0:20](y5 - y4 >= 40))'),
    'CC4': (CC, 100, 'always[0:65](eventually[0:30](always[0:5](y5 - y4 >= 8)))'),
    'CC5': (CC, 100, 'always[0:72](eventually[0:8]('
                     'always[0:5](y2 - y1 >= 9) implies always[5:20](y5 - y4 >= 9)))'),
    'CCx': (CC, 50, ' and '.join(
        f'always[0:50](y{number + 1} - y{number} > 7.5)' for number in range(1, 5))),
    'AT1': (AT, 20, 'always[0:20](speed < 120)'),
    'AT2': (AT, 10, 'always[0:10](rpm < 4750)'),
    **{f'AT5{gear}': (AT, 32.6, _stays(gear)) for gear in range(1, 5)},
    'AT6a': (AT, 30, _slow((4, 35))),
    'AT6b': (AT, 30, _slow((8, 50))),
    'AT6c': (AT, 30, _slow((20, 65))),
    'AT6abc': (AT, 30, _slow((4, 35), (8, 50), (20, 65))),
}
"""Model, horizon [s] and formula of each requirement, as in 2024; CC2 as in 2020."""


def parsed(name: str) -> Spec:
    """The formula of a requirement."""
    model, _, text = FORMULAS[name]
    return parse_spec(f'{name.lower()}={text}', signals=dict.fromkeys(model.signals, '1'))


def rhos(names: Sequence[str], points: Sequence[Sequence[float | None]]) -> list[float]:
    """Robustness of a requirement in the simulation of each point; all are of one model."""
    model = FORMULAS[names[0]][0]
    formulas = {name: parsed(name).formula for name in set(names)}
    length_s = max(FORMULAS[name][1] for name in formulas)
    stamps_ns, signals = model.simulate(model.inputs(points), length_s)
    return [
        robustness(
            formulas[name], stamps_ns, {word: values[row] for word, values in signals.items()})
        for row, name in enumerate(names)
    ]


class Search(Protocol):
    """What proposes points; as :class:`taxinet_ros.samplers.sampler.Lagged`."""

    def next(self) -> tuple[int, tuple[float | None, ...]]:
        """Number of the next point, and the point."""

    def tell(self, index: int, rho: float | None) -> None:
        """Record its robustness."""


class Corners:
    """Draws of the space and of its corners in turn."""

    def __init__(self, size: int, seed: int) -> None:
        self._size, self._chance = size, np.random.default_rng(seed)
        self._numbers = count()

    def next(self) -> tuple[int, tuple[float, ...]]:
        """See :class:`Search`."""
        number = next(self._numbers)
        drawn = self._chance.random(self._size)
        return number, tuple((drawn if number % 2 else np.round(drawn)).tolist())

    def tell(self, index: int, rho: float | None) -> None:
        """Nothing is learned."""


class Annealing:
    """Dual annealing, which calls a function and so has a thread that waits for each result."""

    def __init__(self, size: int, seed: int) -> None:
        self._asked: SimpleQueue[tuple[float, ...]] = SimpleQueue()
        self._told: SimpleQueue[float] = SimpleQueue()
        self._numbers = count()
        threading.Thread(target=dual_annealing, daemon=True, args=(self._rho, [(0, 1)] * size),
                         kwargs={'rng': seed, 'no_local_search': True, 'maxiter': 10**6}).start()

    def _rho(self, point: Floats) -> float:
        self._asked.put(tuple(point.tolist()))
        return self._told.get()

    def next(self) -> tuple[int, tuple[float, ...]]:
        """See :class:`Search`."""
        return next(self._numbers), self._asked.get()

    def tell(self, index: int, rho: float | None) -> None:
        """Let it go on."""
        self._told.put(float('inf') if rho is None else rho)


def _made(word: str, size: int, seed: int, runs: int) -> Search:
    if word in OTHERS:
        return (Annealing if word == 'annealing' else Corners)(size, seed)
    return make_sampler(word, [Dimension(name=f'x{at}') for at in range(size)], seed, runs)


def needed(
    formulas: Sequence[str], words: Sequence[str], repeats: int, runs: int,
    minutes: float = math.inf,
) -> tuple[dict[tuple[str, str], list[int | None]], int]:
    """Simulations until each formula is falsified, by search; None if it is not.

    All searches of a model go on together, so that they are simulated together; none knows of the
    others.

    Args:
        formulas: formulas of one model.
        words: searches.
        repeats: seeds 0, 1, … of each.
        runs: simulations of each.
        minutes: ends all of them after as many simulations of each as take so long [min].

    Returns:
        The simulations, and how many each search could make.
    """
    size = FORMULAS[formulas[0]][0].size
    cases = list(product(formulas, words, range(repeats)))
    searches = {case: _made(case[1], size, case[2], runs) for case in cases}
    done: dict[tuple[str, str, int], int] = {}
    begun_s, made = time.monotonic(), 0
    while made < runs and time.monotonic() - begun_s < 60 * minutes:
        asked = {case: searches[case].next() for case in cases if case not in done}
        if not asked:
            made = runs
            break
        found = rhos([case[0] for case in asked], [point for _, point in asked.values()])
        made += 1
        for (case, (index, _)), rho in zip(asked.items(), found, strict=True):
            searches[case].tell(index, rho)
            if rho < 0:
                done[case] = made
    return {
        (formula, word): [done.get((formula, word, seed)) for seed in range(repeats)]
        for formula, word in product(formulas, words)
    }, made


def _measured(
    words: Sequence[str], repeats: int, runs: int, minutes: float, formulas: Sequence[str],
) -> list[dict[str, Any]]:
    with blas_threads().limit(limits=1):  # there are no large matrices
        found, made = needed(formulas, words, repeats, runs, minutes)
    return [{'formula': name, 'search': word, 'runs': made, 'found': each, **_figures(each)}
            for (name, word), each in found.items()]


def _figures(found: Sequence[int | None]) -> dict[str, Any]:
    """Share that falsified with its interval; mean of these, its interval, and their median."""
    counts = np.array([one for one in found if one is not None], dtype=float)
    rate = binomtest(len(counts), len(found)).proportion_ci(method='exact')
    figures: dict[str, Any] = {
        'falsified': len(counts), 'rate': [float(rate.low), float(rate.high)], 'mean': None}
    if len(counts):
        again = np.random.default_rng(0).choice(counts, (10_000, len(counts))).mean(axis=1)
        figures |= {
            'mean': float(counts.mean()), 'median': float(np.median(counts)),
            'mean_interval': np.quantile(again, (0.025, 0.975)).tolist(),
        }
    return figures


def measure_arch(
    words: Sequence[str], repeats: int, runs: int, minutes: float, progress: Progress,
) -> dict[str, Any]:
    """Search for falsifying inputs of the formulas, ``repeats`` times each with the seeds 0, 1, ….

    Args:
        words: searches and formulas; without those of a kind all, but slow ones only if named.
        repeats: searches for each formula and sampler.
        runs: simulations of each search.
        minutes: see :func:`needed`.
        progress: called with the number of models done and their total.
    """
    searches = [word for word in (*SAMPLERS, *OTHERS) if word in words] or [
        word for word in (*SAMPLERS, *OTHERS) if word not in SLOW]
    formulas = [word for word in FORMULAS if word in words] or list(FORMULAS)
    parts = [[name for name in formulas if FORMULAS[name][0] is model] for model in (CC, AT)]
    parts, lines = [part for part in parts if part], []
    with process_pool(None, 'falsifying worker') as pool:
        measure = partial(_measured, searches, repeats, runs, minutes)
        for number, found in enumerate(pool.map(measure, parts)):
            lines += found
            progress(number + 1, len(parts))
    return {'machine': machine_facts(), 'repeats': repeats, 'searches': lines}


def show(found: dict[str, Any], console: Console) -> None:
    """Print a table of the figures."""
    console.print(f'{found["repeats"]} searches for each line')
    table = make_table(
        ('formula', 'search'),
        ('simulations', 'falsified', '95 %', 'mean', '95 % of the mean', 'median'))
    for one in found['searches']:
        low, high = one['rate']
        mean = ('', '', '') if one['mean'] is None else (
            f'{one["mean"]:.1f}', ' to '.join(f'{end:.1f}' for end in one['mean_interval']),
            f'{one["median"]:g}')
        table.add_row(one['formula'], one['search'], str(one['runs']), str(one['falsified']),
                      f'{low:.0%} to {high:.0%}', *mean)
    console.print(table)
    console.print(
        'simulations: of each search; falsified: searches that found rho < 0, with the interval '
        'of Clopper and Pearson; mean and median: simulations until then, of these searches; '
        'interval of the mean by bootstrap',
        style='dim', soft_wrap=True)
    for name in dict.fromkeys(one['formula'] for one in found['searches']):
        console.print(f'{name}: {parsed(name).text}', style='dim', soft_wrap=True)


def main(words: Sequence[str] | None = None) -> int:
    """Search and print."""
    parser = options(__doc__, repeats=30)
    parser.add_argument('--runs', type=whole, default=RUNS, metavar='N',
                        help=f'simulations of each search (default {RUNS})')
    parser.add_argument('--minutes', type=positive, default=math.inf, metavar='M',
                        help='ends the searches of a model after M minutes, all after as many '
                             'simulations (default: never)')
    parser.add_argument(
        'words', nargs='*', type=one_of([*SAMPLERS, *OTHERS, *FORMULAS]), metavar='SEARCH|FORMULA',
        help=f'without searches all but {" and ".join(SLOW)}, without formulas all')
    given = parser.parse_args(words)
    measure = partial(measure_arch, given.words, given.repeats, given.runs, given.minutes)
    return run_study(measure, show, as_json=given.json)


if __name__ == '__main__':
    leave(main)
