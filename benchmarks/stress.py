"""Adaptive stress testing: how likely is the likeliest failure that each search finds?

Disturbances are independent standard normals, one a step, and the likelihood of a path falls with
their distance from 0. Samplers of the table run whole paths; results arrive as late as with eight
workers. ``tree`` is the usual adaptive stress testing beside them: Monte Carlo tree search with
progressive widening and the reward of Koren, Corso and Kochenderfer (arXiv:2004.04293), on forks of
the simulation, of which only the steps after the fork count. All have equal numbers of steps.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from itertools import product
from typing import Any

from common import Progress, leave, make_table, one_of, options, run_study

import numpy as np
import numpy.typing as npt
from rich.console import Console

from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.mtl.specs import parse_spec
from taxinet_ros.core.perception.perception import GroundTruth
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.signals import checked_signals
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.sampler import LAG, Exhausted
from taxinet_ros.samplers.space import Dimension
from taxinet_ros.samplers.stress import deviations

Floats = npt.NDArray[np.float64]

SAMPLERS = ('random', 'active', 'ce', 'tpe', 'cmaes', 'splitting', 'stress')
TREE = 'tree'
KEPT = 0.8
"""Share of its state that the integrator keeps in a step."""
BIAS_DEG = 2.0
"""Standard deviation of the plant's steering bias [degrees]."""
LIMIT_M = 0.5
"""Cross-track error that the plant has to stay within [m]."""


@dataclass(frozen=True, kw_only=True, slots=True)
class System:
    """What is disturbed.

    Attributes:
        meaning: in one line.
        steps: disturbances of a path.
        runs: whole paths that a search may simulate.
        rho: robustness of a path, shape (steps,); 0 or less is a failure.
        least: distance of the likeliest failure from 0 [sigma]; NaN if unknown.
    """

    meaning: str
    steps: int
    runs: int
    rho: Callable[[Floats], float]
    least: float = math.nan


def integrator(steps: int, least: float) -> Callable[[Floats], float]:
    """A leaky integrator of the disturbances, which fails beyond a limit at any step.

    Its state has the greatest variance after the last step, so the likeliest failure is there.

    Args:
        steps: their number.
        least: distance of the likeliest failure from 0 [sigma].
    """
    gains = KEPT ** np.arange(steps)[::-1]
    limit = least * float(np.linalg.norm(gains))

    def rho(path: Floats) -> float:
        state, most = 0.0, 0.0
        for disturbance in path:
            state = KEPT * state + float(disturbance)
            most = max(most, abs(state))
        return limit - most

    return rho


@lru_cache(maxsize=4096)
def _taxi(path: tuple[float, ...]) -> float:
    points = {
        f'steering_bias_deg@{second + 1}': min(max(BIAS_DEG * value, -30.0), 30.0)
        for second, value in enumerate(path)
    }
    points['steering_bias_deg@form'] = 'constant'
    duration_s = len(path) + 1.0
    scenario = Scenario(signals=checked_signals(points, duration_s), duration_s=duration_s)
    spec = parse_spec(f'keep=always(abs(cte) <= {LIMIT_M})')
    judgement = run_closed_loop(scenario, GroundTruth(), specs=[spec])
    return judgement.readings[0].upper


SYSTEMS: Mapping[str, System] = {
    'integrator': System(
        meaning='leaky integrator, 10 disturbances, the likeliest failure at 3 sigma', steps=10,
        runs=400, rho=integrator(10, 3.0), least=3.0,
    ),
    'integrator-20': System(
        meaning='the same, 20 disturbances, 4 sigma', steps=20, runs=400, rho=integrator(20, 4.0),
        least=4.0,
    ),
    'taxi': System(
        meaning=f'aircraft on the truth, steering bias of {BIAS_DEG:g} degrees (sigma) held for '
                f'1 s each, 10 disturbances; fails beyond {LIMIT_M:g} m', steps=10, runs=100,
        rho=lambda path: _taxi(tuple(path.tolist())),
    ),
}
"""All systems by name."""


def search(name: str, word: str, seed: int) -> float:
    """Distance of the likeliest failure found from 0 [sigma]; infinite if none was found."""
    system = SYSTEMS[name]
    paths = _tree(system, seed) if word == TREE else _sampler(system, word, seed)
    return min((float(np.linalg.norm(path)) for path, rho in paths if rho <= 0), default=math.inf)


def _sampler(system: System, word: str, seed: int) -> list[tuple[Floats, float]]:
    space = [Dimension(name=f'step {number}') for number in range(system.steps)]
    given = {'draws': system.runs // 2, 'particles': 20, 'islands': 4}
    given = given if word == 'splitting' else {}
    sampler = make_sampler(word, space, seed, system.runs, **given)
    under_way: deque[tuple[int, float]] = deque()
    found = []
    for _ in range(system.runs):
        while len(under_way) == LAG or not sampler.ready:
            sampler.tell(*under_way.popleft())
        try:
            index, point = sampler.next()
        except Exhausted:
            break
        path = deviations(point)
        found.append((path, system.rho(path)))
        under_way.append((index, found[-1][1]))
    return found


@dataclass(slots=True)
class _Node:
    visits: int = 0
    children: list[tuple[float, _Node]] = field(default_factory=list)
    value: float = 0.0


def _tree(system: System, seed: int) -> list[tuple[Floats, float]]:
    """Monte Carlo tree search, with double the square root of its visits as children of a node.

    A value is the mean return below; returns are scaled by their range for the confidence bound.
    """
    chance = np.random.default_rng(seed)
    root, found, steps = _Node(), [], 0
    least, most = math.inf, -math.inf
    usual = abs(system.rho(np.zeros(system.steps))) or 1.0
    while steps < system.runs * system.steps:
        node, path, way = root, [], [root]
        while len(path) < system.steps:
            if len(node.children) <= 2 * math.sqrt(node.visits):
                node.children.append((float(chance.standard_normal()), _Node()))
                disturbance, node = node.children[-1]
            else:
                wide = max(most - least, 1e-9)
                near = math.log(node.visits + 1)
                disturbance, node = max(
                    node.children,
                    key=lambda each: each[1].value / wide
                    + math.sqrt(near / max(each[1].visits, 1)),
                )
            path.append(disturbance)
            way.append(node)
            if not node.visits:
                break
        steps += system.steps - len(path) + 1  # of the fork
        rest = chance.standard_normal(system.steps - len(path))
        whole = np.concatenate((path, rest))
        rho = system.rho(whole)
        found.append((whole, rho))
        reward = -float(whole @ whole) / 2 - (0.0 if rho <= 0 else 100.0 * (1 + rho / usual))
        least, most = min(least, reward), max(most, reward)
        for each in way:
            each.visits += 1
            each.value += (reward - each.value) / each.visits
    return found


def measure_stress(words: Sequence[str], repeats: int, progress: Progress) -> dict[str, Any]:
    """Search systems, ``repeats`` times each with the seeds 0, 1, ….

    Args:
        words: samplers and systems; without those of a kind all of them.
        repeats: searches for each system and sampler.
        progress: called with the number of pairs done and their total.
    """
    samplers = [word for word in (*SAMPLERS, TREE) if word in words] or [*SAMPLERS, TREE]
    systems = [word for word in SYSTEMS if word in words] or list(SYSTEMS)
    cases, lines = list(product(systems, samplers)), []
    # Ranks whose interval has the median with at least 95 %, whatever the distribution.
    low = max((
        rank for rank in range(repeats // 2)
        if sum(math.comb(repeats, less) for less in range(rank + 1)) / 2**repeats <= 0.025
    ), default=-1) + 1
    with process_pool(None, 'searching worker') as pool:
        for number, (system, word) in enumerate(cases):
            sigmas = sorted(pool.map(partial(search, system, word), range(repeats)))
            lines.append({
                'system': system, 'sampler': word,
                'found': sum(map(math.isfinite, sigmas)) / repeats,
                'sigma': [sigmas[at] if math.isfinite(sigmas[at]) else None for at in (
                    low, (repeats - 1) // 2, repeats - 1 - low)],
            })
            progress(number + 1, len(cases))
    return {'machine': machine_facts(), 'repeats': repeats, 'searches': lines}


def show(found: dict[str, Any], console: Console) -> None:
    """Print a table of the figures."""
    console.print(f'{found["repeats"]} searches for each line')
    table = make_table(('system', 'search'), ('found', 'sigma', '95 % interval'))
    for one in found['searches']:
        low, middle, high = ('none' if value is None else f'{value:.2f}' for value in one['sigma'])
        table.add_row(
            one['system'], one['sampler'], f'{one["found"]:.0%}', middle, f'{low} to {high}')
    console.print(table)
    console.print(
        'found: searches with a failure; sigma: distance of the likeliest one from the means, '
        'median over searches and its interval by ranks', style='dim', soft_wrap=True,
    )
    for name in dict.fromkeys(one['system'] for one in found['searches']):
        system = SYSTEMS[name]
        console.print(
            f'{name}: {system.meaning}; {system.runs} whole paths, {system.runs * system.steps:,} '
            'steps of a disturbance', style='dim', soft_wrap=True)


def main(words: Sequence[str] | None = None) -> int:
    """Search and print."""
    parser = options(__doc__, repeats=20)
    parser.add_argument(
        'words', nargs='*', type=one_of([*SAMPLERS, TREE, *SYSTEMS]), metavar='SEARCH|SYSTEM',
        help='without searches or systems all',
    )
    given = parser.parse_args(words)
    measure = partial(measure_stress, given.words, given.repeats)
    return run_study(measure, show, as_json=given.json)


if __name__ == '__main__':
    leave(main)
