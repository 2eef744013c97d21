"""Runs that break each of two rules, by a rulebook and by none, beside VerifAI's own sampler.

The second rule is broken in half of a space of five dimensions, the first in 2 % of it, elsewhere;
three dimensions do not matter. ``--verifai PYTHON`` names a Python with VerifAI, whose multi-armed
bandit takes a rulebook as a graph; this file calls itself with it.
"""

from __future__ import annotations

import argparse
import json
import random
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence

DIMENSIONS, RUNS = 5, 200
Points = list[list[float]]


def rules(point: Sequence[float]) -> dict[str, float]:
    """Robustness of both rules."""
    return {'rare': abs(point[0] - 0.9) + abs(point[1] - 0.9) - 0.1, 'wide': 4 * (point[0] - 0.5)}


def ours(sampler: str, text: str, seed: int) -> Points:
    """Points of one of our searches."""
    from taxinet_ros.core.mtl.interval import exact_intervals
    from taxinet_ros.samplers.registry import make_sampler
    from taxinet_ros.samplers.space import Dimension
    from taxinet_ros.trials.objective import parse_objective

    book = parse_objective(text, ('rare', 'wide'))
    space = [Dimension(name=f'x{number}') for number in range(DIMENSIONS)]
    made, points = make_sampler(sampler, space, seed, RUNS), []
    for _ in range(RUNS):
        index, point = made.next()
        points.append([value or 0.0 for value in point])
        made.tell(index, book.value(exact_intervals(rules(points[-1]))))
    return points


def theirs(seed: int) -> Points:
    """Points of VerifAI's bandit with the graph rare -> wide."""
    import networkx
    import numpy as np
    from verifai.features import Box
    from verifai.samplers.multi_armed_bandit import ContinuousMultiArmedBanditSampler

    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 (what VerifAI draws from)
    made = ContinuousMultiArmedBanditSampler(Box(*[(0, 1)] * DIMENSIONS), alpha=0.9, thres=0.0)
    made.set_graph(networkx.DiGraph([(0, 1)]))
    points = []
    for _ in range(RUNS):
        vector, bins = made.getVector()
        points.append([float(value) for value in vector])
        # Its updateVector() does this and counts; with a list of rules and a monitor it needs more.
        made.t += 1
        made.update_dist_from_multi(vector, bins, np.array(list(rules(vector).values())))
    return points


def searches(verifai: str, seeds: int) -> Iterator[tuple[str, list[Points]]]:
    """Name and points of each kind of search."""
    for sampler, text in (
        ('random', 'rare, wide'), ('tpe', 'rare > wide'), ('tpe', 'rare, wide'),
        ('cmaes', 'rare > wide'), ('active', 'rare, wide'),
    ):
        yield f'{sampler}: {text}', [ours(sampler, text, seed) for seed in range(seeds)]
    if verifai:
        done = subprocess.run(
            [verifai, __file__, '--peer', '--seeds', str(seeds)], check=True, capture_output=True,
        )
        yield 'VerifAI mab: rare -> wide', json.loads(done.stdout)


def main() -> None:
    """Print the medians over the seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--verifai', default='', metavar='PYTHON')
    parser.add_argument('--peer', action='store_true', help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.peer:
        json.dump([theirs(seed) for seed in range(asked.seeds)], sys.stdout)
        return
    print(f'of {RUNS} runs, medians of {asked.seeds} searches: runs that break a rule, and in how '
          'many cells of a tenth by a tenth')
    for name, found in searches(asked.verifai, asked.seeds):
        words = []
        for rule in ('rare', 'wide'):
            broken = [[point for point in points if rules(point)[rule] <= 0] for points in found]
            cells = [len({(int(10 * one[0]), int(10 * one[1])) for one in each}) for each in broken]
            words.append(f'{rule} {statistics.median(map(len, broken)):g} in '
                         f'{statistics.median(cells):g}')
        print(f'{name:<28}{", ".join(words)}')


if __name__ == '__main__':
    main()
