"""Compares the scenes that are drawn here with those of Scenic's own ``generate()``.

    python tests/scenes/divergence.py --draws 2000

prints one line for each program and way of drawing: the smallest p-value of its two-sample tests,
and whether it is below a family-wise level of 0.1 %.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import random
import sys
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2_contingency, ks_2samp

from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.space import Point
from taxinet_ros.scenes import scenic_child
from taxinet_ros.scenes.programs import shipped_folder
from taxinet_ros.scenes.search_space import SearchSpace
from taxinet_ros.scenes.source import Refused, accepted_scene
from taxinet_ros.scenes.values import scene_values

LEVEL = 1e-3
"""Chance that any of all the tests fails where nothing differs."""

WAYS = ('run', 'random', 'halton', 'ce')

EGO = 'ego = new Plane at (0, 400)\n'
PLACED = 'ego = new Plane at (Range(-8, 8), Range(0, 2000)), facing Range(-30, 30) deg\n'
WEATHER = (
    'weather = Options({(Uniform(*CLOUDS), 0): 2, (Uniform(*RAIN_CLOUDS), Range(25, 100)): 1})\n'
    'param clouds = weather[0]\nparam rain = weather[1]\n'
)
PROGRAMS = {
    'plain': PLACED,
    's_falsif': 'param time_of_day = Range(6, 18)\n' + WEATHER + PLACED,
    'hard': PLACED + 'require ego.position.x > 6\n',
    'hard, two': PLACED + 'require ego.position.x > 0\nrequire ego.position.y < 500\n',
    'hard, on two': PLACED + 'require ego.position.x * 100 > ego.position.y - 800\n',
    'hard, on weather': WEATHER + PLACED + 'require weather[1] > 40\n',
    'soft': PLACED + 'require[0.8] ego.position.x > 6.4\n',
    'soft, rare': PLACED + 'require[0.3] ego.position.x > 7.5\n',
    'soft, two': PLACED + 'require[0.8] ego.position.x > 5\nrequire[0.4] ego.position.y < 300\n',
    'soft and hard': PLACED + 'require ego.position.x > 0\nrequire[0.5] ego.position.y < 200\n',
    'soft, on weather': WEATHER + PLACED + 'require[0.7] weather[1] > 60\n',
    'nested': 'inner = Uniform(Range(0, 1), Range(5, 9))\n'
              'param rain = Options({inner: 3, Uniform(20, Range(30, 40)): 1})\n' + EGO,
    'nested, shared': 'x = Range(0, 10)\nparam rain = Uniform(x, x + 20, 50)\n'
                      'param time_of_day = Uniform(x + 1, 20)\n' + EGO,
    'nested, deep': 'param rain = Uniform(Uniform(Uniform(1, Range(2, 3)), 4), Range(5, 6))\n'
                    + EGO,
    'mixture': 'ego = new Plane at (0, Options({Range(500, 600): 3, Range(0, 100): 1}))\n',
    'mixture, overlapping': 'param rain = Options({Range(0, 60): 1, Range(40, 100): 2})\n' + EGO,
    'weights': 'param clouds = Options({"clear": 5, "broken": 2, "stratus": 1})\n' + EGO,
    'normal': 'ego = new Plane at (Normal(0, 3), Normal(900, 200))\n',
    'normal, random mean': 'm = Range(8, 16)\nparam time_of_day = Normal(m, 0.5)\n'
                           'param rain = m\n' + EGO,
    'truncated normal': 'param time_of_day = TruncatedNormal(12, 3, 6, 18)\n' + EGO,
    'truncated, skewed': 'param rain = TruncatedNormal(0, 30, 0, 100)\n' + EGO,
    'whole numbers': 'param duration = DiscreteRange(3, 9)\n' + EGO,
    'weighted numbers': 'param duration = DiscreteRange(1, 4, weights=(4, 1, 1, 2))\n' + EGO,
    'many numbers': 'param rain = DiscreteRange(0, 900)\n' + EGO,
    'random ends': 'r = Range(1, 90)\nparam rain = Range(0, r)\nparam time_of_day = r\n' + EGO,
    'random whole ends': 'n = DiscreteRange(1, 5)\nparam rain = DiscreteRange(0, n)\n' + EGO,
    'rectangle': 'ego = new Plane in RectangularRegion((1, 500), 0.3, 6, 300)\n',
    'circle': 'ego = new Plane in CircularRegion((0, 400), 7)\n',
    'sector': 'ego = new Plane in SectorRegion(0 @ 400, 9, 0.5, 1.2)\n',
    'polygon': 'ego = new Plane in PolygonalRegion([(-6, 0), (6, 100), (8, 900), (0, 300), '
               '(-3, 950)])\n',
    'polyline': 'ego = new Plane on PolylineRegion([(0, 0), (5, 300), (-5, 900)])\n',
    'points': 'import numpy\nego = new Plane in PointSetRegion("p", '
              '[(0, 100, 0), (3, 300, 0), (-4, 700, 0)])\n',
    'random region': 'r = Range(1, 7)\nego = new Plane in CircularRegion((0, 400), r)\n'
                     'param rain = r\n',
    'either region': 'ego = new Plane in Uniform(RectangularRegion((0, 100), 0, 4, 100), '
                     'CircularRegion((0, 900), 6))\n',
    'region, required': 'ego = new Plane in RectangularRegion((0, 500), 0, 10, 800)\n'
                        'require[0.6] ego.position.y > 700\n',
    'odd region': 'Odd = type("Odd", (RectangularRegion,), {})\n'
                  'ego = new Plane in Odd((0, 500), 0, 8, 600)\n',
    'offset': 'spot = new OrientedPoint at (Range(-2, 2), Range(200, 900)), facing 10 deg\n'
              'ego = new Plane at spot offset by (Range(-1, 1), Normal(0, 20))\n',
    'mutate': 'ego = new Plane at (Range(-2, 2), 400)\nmutate ego by 0.5\n',
    'resample': 'x = Normal(40, 8)\nparam rain = x\nparam time_of_day = resample(x) / 8\n' + EGO,
    'correlated': 'x = Range(0, 1)\nparam rain = 100 * x\nparam time_of_day = 6 + 12 * x * x\n'
                  + EGO,
    'derived': 'param rain = 10 + 5 * Range(0, 1) + Range(0, 3) * Range(1, 2)\n' + EGO,
    'starred': 'param rain = Uniform(*Uniform([1, 2], [3, 4, 5, 6]))\n' + EGO,
    'verifai': 'param rain = VerifaiRange(0, 90, weights=[3, 1, 1])\n'
               'param clouds = VerifaiOptions({"clear": 3, "broken": 1})\n' + EGO,
    'partly marked': 't = Range(6, 18)\nparam rain = VerifaiRange(0, 90)\nparam time_of_day = t\n'
                     + EGO + 'require t > 15\n',
}
"""Programs after ``model runway_world``, by name."""

WRONG = {
    'another weight': ('param rain = Options({1: 2, 50: 1})\n' + EGO,
                       'param rain = Options({1: 1, 50: 3})\n' + EGO),
    'a wider normal': ('param rain = Normal(0, 1)\n' + EGO, 'param rain = Normal(0, 3)\n' + EGO),
    'another share': (PLACED + 'require[0.8] ego.position.x > 6.4\n',
                      PLACED + 'require[0.3] ego.position.x > 6.4\n'),
    'redrawn activation': (PLACED + 'require[0.8] ego.position.x > 6.4\n', ''),
    'independent': (PROGRAMS['correlated'],
                    'param rain = 100 * Range(0, 1)\n'
                    'param time_of_day = 6 + 12 * Range(0, 1) ** 2\n' + EGO),
}
"""Pairs of programs that the comparison has to tell apart. Without a second text it is the first
one with soft requirements decided anew for each refused point, which is not what Scenic does.
"""

Values = list[dict[str, Any]]


class Drawn:
    """The scenes of one program, in this process: only Scenic's own, or as they are drawn here."""

    def __init__(self, folder: Path, text: str, seed: int) -> None:
        """Compile."""
        self.program = folder / 'compared.scenic'
        self.program.write_text('model runway_world\n' + text)
        self._programs = scenic_child.Programs(seed, str(shipped_folder()))
        self._programs.compile(str(self.program))
        self._seed = seed
        self._space = SearchSpace.from_json(self._programs.space())

    def of_scenic(self, draws: int) -> Values:
        """What ``generate()`` gives, one scene after the other."""
        random.seed(self._seed + 1)
        np.random.seed(self._seed + 1)  # noqa: NPY002 (the one Scenic uses)
        generate = self._programs._scenario.generate
        return [scene_values(generate()[0]) for _ in range(draws)]

    def by(self, way: str, draws: int) -> Values:
        """What ``taxinet run`` or a sampler that is told nothing gives."""
        if way == 'run' or not self._space.searched:
            return [self._programs.scene(index)['values'] for index in range(draws)]
        sampler = make_sampler(way, self._space.dimensions, self._seed, draws)
        found = []
        for index in range(draws):
            _, point = sampler.next()
            found.append(accepted_scene(self, index, point, sampler.again)[0])
            sampler.tell(index, None)
        return found

    def decided_anew(self, draws: int) -> Values:
        """Wrong: a point that is refused is replaced by one with other soft requirements."""
        sampler = make_sampler('random', self._space.dimensions, self._seed, 100 * draws)
        found: Values = []
        for index in range(100 * draws):
            if len(found) == draws:
                break
            _, point = sampler.next()
            sampler.tell(index, None)
            with contextlib.suppress(Refused):
                found.append(self.scene(index, point, 0))
        return found

    def scene(self, index: int, point: Point, attempt: int) -> dict[str, Any]:
        """As :class:`~taxinet_ros.scenes.source.SceneSource` has it, but plain values."""
        answer = self._programs.scene(index, self._space.spread(point), attempt)
        if 'values' not in answer:
            raise Refused('', 1)
        return answer['values']


def p_values(one: Values, other: Values) -> dict[str, float]:
    """Of two-sample tests: each key by itself, and each pair of keys.

    Numbers by Kolmogorov and Smirnov, words by chi-square. A pair by the sum of its ranks among
    all the scenes, whose distribution changes with the dependence.
    """
    found: dict[str, float] = {}
    ranks: dict[str, tuple[Any, Any]] = {}
    for key in sorted(one[0]):
        columns = [[scene[key] for scene in scenes] for scenes in (one, other)]
        words = sorted({value for column in columns for value in column}, key=str)
        if len(words) == 1:
            continue
        if len(words) <= 12:
            counts = [[column.count(word) for word in words] for column in columns]
            found[key] = float(chi2_contingency(counts).pvalue)
            codes = [[float(words.index(value)) for value in column] for column in columns]
        else:
            found[key] = float(ks_2samp(*columns).pvalue)
            codes = columns
        pooled = np.sort(np.concatenate(codes))
        ranks[key] = tuple(
            np.searchsorted(pooled, column, 'left') + np.searchsorted(pooled, column, 'right')
            for column in codes
        )
    for a, b in itertools.combinations(ranks, 2):
        sums = [x + y for x, y in zip(ranks[a], ranks[b], strict=True)]
        found[f'{a} with {b}'] = float(ks_2samp(*sums).pvalue)
    return found


def compared(
    programs: Mapping[str, str], draws: int, seed: int, ways: Sequence[str] = WAYS
) -> dict[str, dict[str, dict[str, float]]]:
    """P-values by program, way and key."""
    return _each(programs, lambda drawn, _: (
        drawn.of_scenic(draws), {way: drawn.by(way, draws) for way in ways}
    ), seed)


def told_apart(draws: int, seed: int) -> dict[str, dict[str, dict[str, float]]]:
    """The same of the wrong pairs: Scenic's scenes of one beside those drawn here of the other."""
    def draw(drawn: Drawn, folder: Path) -> tuple[Values, dict[str, Values]]:
        text = WRONG[folder.name][1]
        # The others are known by half as many, at p 1e-7 and less; a dependence shows less.
        most = draws if folder.name == 'independent' else draws // 2
        own = drawn.of_scenic(most)
        if not text:
            return own, {'random': drawn.decided_anew(most)}
        return own, {'random': Drawn(folder, text, seed).by('random', most)}

    return _each({name: pair[0] for name, pair in WRONG.items()}, draw, seed)


def _each(
    programs: Mapping[str, str],
    draw: Callable[[Drawn, Path], tuple[Values, dict[str, Values]]], seed: int,
) -> dict[str, dict[str, dict[str, float]]]:
    found = {}
    with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
        warnings.simplefilter('ignore')
        for name, text in programs.items():
            folder = Path(scratch) / name
            folder.mkdir()
            own, ours = draw(Drawn(folder, text, seed), folder)
            found[name] = {way: p_values(own, values) for way, values in ours.items()}
    return found


def main() -> None:
    """Print the comparison, as JSON where a test asks for it."""
    parser = argparse.ArgumentParser()
    parser.add_argument('--draws', type=int, default=2000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--programs', nargs='*', default=list(PROGRAMS))
    args = parser.parse_args()
    found = compared({name: PROGRAMS[name] for name in args.programs}, args.draws, args.seed)
    if args.json:
        json.dump({'right': found, 'wrong': told_apart(4 * args.draws, args.seed)}, sys.stdout)
        return
    tests = sum(len(values) for ways in found.values() for values in ways.values())
    for name, ways in found.items():
        for way, values in ways.items():
            key, least = min(values.items(), key=lambda item: item[1])
            word = 'DIFFERS' if least < LEVEL / tests else 'equal'
            print(f'{name:22} {way:8} {word:8} p {least:.2g} ({key})', flush=True)
    print(f'{tests} tests of {args.draws} draws each, family-wise level {LEVEL:g}')


if __name__ == '__main__':
    main()
