"""What the samplers cost: one question and one answer, after a hundred or more of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from taxinet_ros.bench.measure import Subject
from taxinet_ros.campaign.samplers.lagged import Lagged
from taxinet_ros.campaign.samplers.make import SAMPLERS, make_sampler
from taxinet_ros.campaign.samplers.space import Dimension, Point

SPACE = (
    *(Dimension(name=f'continuous {number}') for number in range(5)),
    Dimension(name='clouds', weights=(1.0,) * 6),
    Dimension(name='rain', weights=(2.0, 1.0)),
)
"""Seven dimensions: as many as the shipped programs vary, and two of them categories."""

RUNS = 120
"""Runs made before the first one measured."""

_CALLS = {'tpe': 5, 'cmaes': 5, 'bo': 1}
_OFTEN = 50


def subjects() -> list[Subject]:
    """Asking for a run and telling its result, with each sampler."""
    return [
        Subject(
            name=f'samplers/{word}', run=_first_filled(word), calls=_CALLS.get(word, _OFTEN),
            warm_ups=1, most=3 if word == 'bo' else 20,
        )
        for word in SAMPLERS
    ]


def _first_filled(word: str) -> Callable[[], None]:
    """Runs of a sampler that has made :data:`RUNS` before."""
    # Before its start a Gaussian process costs nothing, then its window is full at once.
    options = {'startup': RUNS} if word == 'bo' else {}
    sampler = make_sampler(word, SPACE, 0, RUNS, **options)
    _runs(sampler, RUNS + 10)
    return partial(_runs, sampler, _CALLS.get(word, _OFTEN))


def _runs(sampler: Lagged, number: int) -> None:
    for _ in range(number):
        index, point = sampler.next()
        sampler.tell(index, _robustness(point))


def _robustness(point: Point) -> float:
    """A bowl in which about one run in ten fails."""
    return sum((quantile - 0.3) ** 2 for quantile in point if quantile is not None) - 0.4
