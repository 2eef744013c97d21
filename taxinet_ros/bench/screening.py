"""Samplers at equal budgets, one of which looks before it runs.

The budget is in *full runs*: a run costs 1, a look a fixed share of one (:data:`LOOK_COST`). On a
landscape of :mod:`.searches` a formula replaces the simulator, and another one the look, which is
good, fair, worthless or misleading. Otherwise runs and looks are closed loops of S_falsif with a
network, and their processor time is measured too.
"""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from statistics import fmean
from typing import Any

import cv2
import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from taxinet_ros import registry
from taxinet_ros.bench.measure import machine_facts
from taxinet_ros.bench.searches import LANDSCAPES, Landscape, count_distinct
from taxinet_ros.campaign.loop_run import Loop, LoopOptions
from taxinet_ros.campaign.samplers.registry import (
    SAMPLERS,
    SCREENING,
    make_sampler,
    make_screening_sampler,
)
from taxinet_ros.campaign.samplers.sampler import LAG
from taxinet_ros.campaign.samplers.screening import LOOK_COST, NAME, Look
from taxinet_ros.campaign.samplers.space import Point, Space
from taxinet_ros.campaign.scenes.source import Rejected, SceneSource
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.pacing.timing import AT_ONCE
from taxinet_ros.core.perception.perception import GroundTruth, perception_names
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.errors import UsageError
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.registry import KMWH

BUDGET = 100.0
"""Budget of a search of a landscape, unless another is given [full runs]."""
REAL_BUDGET = 20.0
"""Budget of a search of S_falsif, likewise [full runs]."""
PROGRAM = 's_falsif'
"""Program whose scenes a network is searched on."""
DEFAULT_LANDSCAPES = ('corner', 'twins', 'four', 'eight', 'categories', 'decoy')
DEFAULT_SAMPLERS = ('random', 'sobol', 'ce', 'active', 'tpe', 'cmaes', NAME)


def _noise(point: Point, salt: str) -> float:
    """Standard normal number that is a function of the point, rough at every scale."""
    words = [zlib.crc32(f'{salt}{part}{point!r}'.encode()) for part in (1, 2)]
    one, two = ((word + 1) / (2**32 + 1) for word in words)
    return math.sqrt(-2 * math.log(one)) * math.cos(math.tau * two)


def _shifted(place: Landscape, point: Point) -> float:
    """Robustness of the point half the space away: failures where there are none."""
    return place.rho(place.space.point([
        0.5 if each is None else (each + 0.5) % 1.0 for each in point
    ]))


LOOKS: Mapping[str, Callable[[Landscape, Point], float]] = {
    'good': lambda place, point: place.rho(point) + 0.02 * _noise(point, 'good'),
    'fair': lambda place, point: place.rho(point) + 0.1 * _noise(point, 'fair'),
    'worthless': lambda place, point: 0.3 + 0.2 * _noise(point, 'worthless'),
    'misleading': _shifted,
}
"""Looks at a landscape by quality: with normal errors of 0.02 and 0.1 (most ρ are 0 to 0.6),
unrelated to ρ, and low half the space away from the failures."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Spent:
    """One search at a budget, and what it cost.

    Attributes:
        runs, looks: number of each.
        failures: number of failed runs.
        distinct: cost at which each distinct failure was found (:func:`.searches.count_distinct`)
            [full runs].
        regions: share of the failure regions found; None where they are unknown.
        ask_s, look_s, run_s: processor time per search for choosing, for looks and for runs [s].
    """

    runs: int
    looks: int
    failures: int
    distinct: tuple[float, ...]
    regions: float | None
    ask_s: float
    look_s: float = 0.0
    run_s: float = 0.0


def spend(
    word: str, space: Space, seed: int, budget: float, rho: Callable[[Point], float | None],
    look: Look, *, lag: int, region: Callable[[Point], int] | None = None, regions: int = 0,
) -> Spent:
    """Search with a sampler until the budget is spent.

    Args:
        word: sampler of the table.
        space: the space to search.
        seed: seed of the search.
        budget: cost allowed [full runs]; no run is begun that would exceed it.
        rho: makes a run; None without a result.
        look: looks at a point, for the sampler that takes looks.
        lag: results are told so many runs late.
        region: index of the region that a failure belongs to, if known.
        regions: number of regions.
    """
    screening, looks = None, 0
    if word == NAME:
        sampler, screening = make_screening_sampler(space, seed, look)
    else:
        sampler = make_sampler(word, space, seed, int(budget))
    sampler.set_lag(lag)
    failures: list[Point] = []
    waiting: list[tuple[int, float | None]] = []
    distinct: list[float] = []
    ask_s, runs = 0.0, 0
    while True:
        if len(waiting) == lag:
            sampler.tell(*waiting.pop(0))
        begun_s = time.process_time()
        index, point = sampler.next()
        ask_s += time.process_time() - begun_s
        after = 0 if screening is None else screening.looks
        if runs + 1 + LOOK_COST * after > budget:
            break
        runs, looks = runs + 1, after
        found = rho(point)
        waiting.append((index, found))
        if found is not None and found <= 0:
            failures.append(point)
            if count_distinct(space, failures) > len(distinct):
                distinct.append(runs + LOOK_COST * looks)
    return Spent(
        runs=runs, looks=looks, failures=len(failures), distinct=tuple(distinct),
        regions=None if region is None else len({region(one) for one in failures}) / regions,
        ask_s=ask_s,
    )


def search_landscape(
    landscape: str, quality: str, word: str, seed: int, budget: float = BUDGET
) -> Spent:
    """Search a landscape once; results arrive as late as with eight workers."""
    place = LANDSCAPES[landscape]
    return spend(
        word, place.space, seed, budget, place.rho,
        lambda point: LOOKS[quality](place, point), lag=LAG,
        region=place.region, regions=place.regions,
    )


def search_network(network: str, word: str, seed: int, budget: float = REAL_BUDGET) -> Spent:
    """Search S_falsif with a network once, by real closed loops, one run after the other."""
    cv2.setNumThreads(1)
    judging = Judging(specs=(f'phi_eventually={SHIPPED["phi_eventually"].text}',))
    every = int(SCREENING.options['every'].default)
    loops = {
        each: Loop(LoopOptions(
            perception=network, controller=STEERING, controller_sha256='', gains={},
            timing=AT_ONCE, world=KMWH, world_sha256='', out=None, images='none', every=each,
        )) for each in (1, every)
    }
    spent_s = dict.fromkeys(loops, 0.0)
    number = 0

    def made(each: int, point: Point) -> float | None:
        nonlocal number
        number += 1
        begun_s = time.process_time()
        try:
            scenario = source.scene(number, point)
        except Rejected:
            return None
        result = loops[each].run(RunRequest(
            run_id=f'{PROGRAM}-{number}', index=number, program=PROGRAM, seed=seed,
            scenario=scenario, judging=judging, participants=(),
        ))
        spent_s[each] += time.process_time() - begun_s
        interval = result.robustness.get('phi_eventually')
        return None if interval is None else interval.lower

    with threadpool_limits(limits=1), SceneSource(PROGRAM, seed=seed) as source:
        found = spend(
            word, source.space(), seed, budget, partial(made, 1), partial(made, every), lag=1
        )
    return Spent(**{
        **asdict(found), 'ask_s': found.ask_s - spent_s[every], 'look_s': spent_s[every],
        'run_s': spent_s[1],
    })


def measure_screening(
    words: Sequence[str], repeats: int, runs: int | None, progress: Callable[[int, int], object],
) -> dict[str, Any]:
    """Search landscapes and networks with samplers at equal budgets, ``repeats`` times each.

    Args:
        words: samplers, landscapes and networks, of which S_falsif is searched; without samplers
            :data:`DEFAULT_SAMPLERS`, without landscapes and networks :data:`DEFAULT_LANDSCAPES`.
        repeats: searches for each line, with the seeds 0, 1, ….
        runs: budget of each search [full runs]; None for the default one.
        progress: called with the number of lines done and their total.

    Raises:
        UsageError: a word is unknown, or ``repeats`` is less than 1.
    """
    networks = [word for word in perception_names() if word in words and word != GroundTruth.word]
    for word in words:
        if word not in (*SAMPLERS, *LANDSCAPES, *networks):
            known = registry.known(registry.SAMPLERS, *LANDSCAPES, 'or a network of S_falsif')
            raise UsageError(
                f'bench: sampler, landscape or network {word!r} is unknown; known: {known}'
            )
    if repeats < 1:
        raise UsageError(f'bench: --repeats is {repeats}, needs to be 1 or more')
    samplers = [word for word in SAMPLERS if word in words] or DEFAULT_SAMPLERS
    landscapes = [word for word in LANDSCAPES if word in words]
    if not landscapes and not networks:
        landscapes = list(DEFAULT_LANDSCAPES)
    cases = [
        (place, word, quality) for place, word in product((*landscapes, *networks), samplers)
        for quality in (LOOKS if word == NAME and place in LANDSCAPES else ('',))
    ]
    lines = []
    with process_pool(None, 'searching worker') as pool:
        for number, (place, word, quality) in enumerate(cases):
            budget = runs or (REAL_BUDGET if place in networks else BUDGET)
            one = partial(search_network, place, word, budget=budget) if place in networks else (
                partial(search_landscape, place, quality or 'good', word, budget=budget)
            )
            done = list(pool.map(one, range(repeats)))
            lines.append({
                'place': place, 'sampler': word, 'looks': quality, 'budget': budget,
                **summary(done), 'searches': [asdict(each) for each in done],
            })
            progress(number + 1, len(cases))
    return {'machine': machine_facts(), 'repeats': repeats, 'lines': lines}


def summary(done: Sequence[Spent]) -> dict[str, Any]:
    """What searches of one line found, on average.

    Returns:
        ``distinct_mean``: mean number of distinct failures, with ``low`` and ``high``, Student's
        95 % interval over the searches (0 at least; None of one search); ``failures``, ``runs``,
        ``made``: mean numbers of failures, runs and looks; ``regions``: mean share of the regions,
        or None; ``found``: share of the searches that found a failure; ``first``: median cost until
        the first [full runs], None if half of them found none; ``ask_s``, ``look_s``, ``run_s``:
        mean processor times [s].
    """
    counts = np.array([len(one.distinct) for one in done], np.float64)
    low = high = None
    if len(counts) > 1:
        half = stats.t.ppf(0.975, len(counts) - 1) * counts.std(ddof=1) / math.sqrt(len(counts))
        low, high = max(float(counts.mean() - half), 0.0), float(counts.mean() + half)
    first = float(np.median([one.distinct[0] if one.distinct else math.inf for one in done]))
    regions = [one.regions for one in done if one.regions is not None]
    return {
        'distinct_mean': float(counts.mean()), 'low': low, 'high': high,
        'failures': fmean(one.failures for one in done), 'runs': fmean(one.runs for one in done),
        'made': fmean(one.looks for one in done),
        'regions': fmean(regions) if regions else None, 'found': float((counts > 0).mean()),
        'first': first if math.isfinite(first) else None,
        'ask_s': fmean(one.ask_s for one in done), 'look_s': fmean(one.look_s for one in done),
        'run_s': fmean(one.run_s for one in done),
    }
