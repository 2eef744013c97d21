"""How well the samplers search: synthetic landscapes whose failure regions are known.

Each repetition is one search with results that come as late as eight workers bring them, so with
as little known as there ever is.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from multiprocessing import get_context
from statistics import fmean
from typing import Any

from taxinet_ros.bench.landscapes import LANDSCAPES, count_distinct
from taxinet_ros.bench.machine import machine_facts
from taxinet_ros.campaign.samplers.lagged import LAG
from taxinet_ros.campaign.samplers.make import SAMPLERS, make_sampler
from taxinet_ros.campaign.samplers.space import Point
from taxinet_ros.core.errors import UsageError

RUNS = 200
"""Of each search."""

_SLOW = ('bo', 'tpe')
"""Samplers that take a second and more for a search; measured only where they are named."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Search:
    """What one search came to; or the means of several.

    Attributes:
        found: whether it found a failure; the share of the searches that did.
        regions: share of the failure regions that it found.
        failures: runs that failed.
        distinct: failures that lie apart (:func:`~taxinet_ros.bench.landscapes.count_distinct`).
        ask_s: processor time for choosing a run and taking its result in [s].
    """

    found: float
    regions: float
    failures: float
    distinct: float
    ask_s: float


def measure_searches(
    words: Sequence[str], repeats: int, progress: Callable[[int, int], object],
) -> dict[str, Any]:
    """Search landscapes with samplers, as often as asked for.

    Args:
        words: samplers and landscapes; where no sampler is named all but the slow ones, where no
            landscape is named all of them.
        repeats: searches for each landscape and sampler, with the seeds 0, 1, ….
        progress: is told how many pairs of them are done, of how many.

    Raises:
        UsageError: an unknown word, or no repetition.
    """
    for word in words:
        if word not in SAMPLERS and word not in LANDSCAPES:
            known = ', '.join((*SAMPLERS, *LANDSCAPES))
            raise UsageError(f'bench: sampler or landscape {word!r} is unknown; known: {known}')
    if repeats < 1:
        raise UsageError(f'bench: --repeats is {repeats}, needs to be 1 or more')
    samplers = [word for word in SAMPLERS if word in words] or [
        word for word in SAMPLERS if word not in _SLOW
    ]
    landscapes = [word for word in LANDSCAPES if word in words] or list(LANDSCAPES)
    cases = list(product(landscapes, samplers))
    found = []
    spawned = get_context('spawn')  # a progress bar has threads, which do not survive a fork
    with ProcessPoolExecutor(os.cpu_count(), mp_context=spawned) as pool:
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
