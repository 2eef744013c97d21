"""Synthetic robustness over a search space, with failure regions that are known beforehand.

A search is measured on them without a simulator: how often it finds a rare region, how many of
several it finds, how different its failures are. Distances are of quantiles, so the share of a
region in the unit cube is its probability under the program.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from taxinet_ros.campaign.samplers.space import Branch, Dimension, Point, Space

Centre = tuple[float, float]

APART = 0.15
"""Two failures are distinct where a coordinate differs by more [quantiles], or a category."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Landscape:
    """Robustness by point.

    Attributes:
        name: of its row in the table.
        meaning: what it is, in a line.
        space: what is searched.
        rho: robustness of a point; 0 or less is a failure.
        regions: number of separate failure regions.
        region: number of the region, 0 or more, that a failure belongs to.
        rate: probability of a failure under the program.
    """

    name: str
    meaning: str
    space: Space
    rho: Callable[[Point], float]
    regions: int
    region: Callable[[Point], int]
    rate: float


def count_distinct(space: Space, failures: Sequence[Point]) -> int:
    """Number of failures that lie apart: a greedy cover in the order in which they were found.

    A failure counts where it differs from each one counted before in a category, or by more than
    :data:`APART` in some coordinate.
    """
    counted: list[Point] = []
    for point in failures:
        if all(_apart(space, point, other) for other in counted):
            counted.append(point)
    return len(counted)


def _apart(space: Space, one: Point, other: Point) -> bool:
    for dimension, mine, its in zip(space, one, other, strict=True):
        if mine is None or its is None:
            if mine is not its:
                return True
        elif dimension.discrete:
            if dimension.bin(mine) != dimension.bin(its):
                return True
        elif abs(mine - its) > APART:
            return True
    return False


def _continuous(number: int) -> Space:
    return Space(Dimension(name=f'x{each}') for each in range(number))


def _radius(share: float) -> float:
    """Of a disc with this share of the unit square."""
    return math.sqrt(share / math.pi)


def _discs(point: Point, centres: Sequence[Centre], shares: Sequence[float]) -> list[float]:
    """Signed distance to each disc in the plane of the first two coordinates."""
    return [
        math.dist(point[:2], centre) - _radius(share)
        for centre, share in zip(centres, shares, strict=True)
    ]


def _of_discs(
    name: str, meaning: str, space: Space, centres: Sequence[Centre], shares: Sequence[float],
    shape: Callable[[float], float] = lambda distance: distance,
) -> Landscape:
    def nearest(point: Point) -> tuple[float, int]:
        distances = _discs(point, centres, shares)
        return min((distance, number) for number, distance in enumerate(distances))

    return Landscape(
        name=name, meaning=meaning, space=space, regions=len(centres), rate=sum(shares),
        rho=lambda point: shape(nearest(point)[0]), region=lambda point: nearest(point)[1],
    )


_TWO = ((0.21, 0.72), (0.76, 0.27))
_FOUR = ((0.17, 0.22), (0.71, 0.13), (0.34, 0.81), (0.86, 0.66))
_SHARES_FOUR = (0.005, 0.006, 0.008, 0.01)


def _corner(dimensions: int) -> Landscape:
    side = math.sqrt(0.001)
    return Landscape(
        name=f'corner-{dimensions}', meaning=f'a 0.1 % corner of two dimensions of {dimensions}',
        space=_continuous(dimensions), regions=1, rate=0.001,
        rho=lambda point: max(point[0], point[1]) - side, region=lambda point: 0,
    )


def _rough(distance: float, point: Point) -> float:
    """Distance, and noise that is a function of the point."""
    chance = zlib.crc32(repr(point).encode()) / 2**32
    return distance + 0.1 * (chance - 0.5)


def landscapes() -> tuple[Landscape, ...]:
    return (
        *(_corner(n) for n in (2, 4, 6)),
        *(_of_discs(f'twins-{n}', '', _continuous(n), _TWO, (0.0075, 0.0075)) for n in (2, 4, 6)),
        *(_of_discs(f'four-{n}', '', _continuous(n), _FOUR, _SHARES_FOUR) for n in (2, 4, 6)),
        _of_discs('bumps-4', '', _continuous(4), _FOUR, _SHARES_FOUR,
                  lambda d: 0.5 - 0.5 * math.exp(-(d * abs(d)) * 30 - d * 3)),
        _of_discs('plateau-4', '', _continuous(4), _TWO, (0.0075, 0.0075),
                  lambda d: min(d, 0.1)),
        _of_discs('steps-4', '', _continuous(4), _TWO, (0.0075, 0.0075),
                  lambda d: math.ceil(d / 0.1) * 0.1),
        _of_discs('eight-4', '', _continuous(4), tuple((0.5+0.38*math.cos(k*math.pi/4), 0.5+0.38*math.sin(k*math.pi/4)) for k in range(8)), (0.005,)*8),
        _of_discs('funnel-4', '', _continuous(4), _TWO, (0.0075, 0.0075), lambda d: min(d, 0.05)),
        _of_discs('tail-6', 'rho mostly large, nonlinear', _continuous(6), _FOUR, _SHARES_FOUR, lambda d: 20*d*abs(d)),
        _of_discs('touch-4', 'told 0 for all failures', _continuous(4), _FOUR, _SHARES_FOUR, lambda d: max(d, 0.0)),
        _of_discs('cliff-4', 'jumps from +1', _continuous(4), _TWO, (0.0075, 0.0075), lambda d: d if d <= 0 else 0.5 + d),
        _blind(), _rough4(), _deceptive(), _categories(), _most(), _ball4(), _conditional(),
    )

def _blind():
    return _of_discs('blind-4', 'no gradient', _continuous(4), _TWO, (0.0075, 0.0075),
                  lambda d: -1.0 if d <= 0 else 1.0)

def _rough4():
    a = _of_discs('x', '', _continuous(4), _TWO, (0.0075, 0.0075))
    # a failure only within the regions
    def rho(p):
        d = a.rho(p)
        n = zlib.crc32(repr(p).encode()) / 2**32
        return d if d <= 0 else max(1e-6, d + 0.2 * (n - 0.5))
    return Landscape(name='rough-4', meaning='', space=a.space, rho=rho, regions=2, region=a.region, rate=.015)

def _deceptive():
    c = (0.8, 0.8)
    t = (0.12, 0.15)
    def rho(p):
        return min(0.02 + 0.8 * math.dist(p[:2], c), math.dist(p[:2], t) - _radius(0.007) )
    return Landscape(name='deceptive-4', meaning='', space=_continuous(4), rho=rho, regions=1, region=lambda p: 0, rate=.007)

def _categories():
    space = Space((Dimension(name='clouds', weights=(1,)*6), *_continuous(3), Dimension(name='rain', weights=(2, 1))))
    def parts(p):
        k = space[0].bin(p[0]); 
        d0 = max(math.dist(p[1:3], (0.3, 0.7)) - _radius(0.04), 0 if k == 2 else .3)
        d1 = max(math.dist(p[1:3], (0.7, 0.2)) - _radius(0.03), 0 if space[4].bin(p[4]) == 1 else .3)
        return (math.dist(p[1:3], (0.3, 0.7)) - _radius(0.04) + (0 if k == 2 else .3), math.dist(p[1:3], (0.7, 0.2)) - _radius(0.03) + (0 if space[4].bin(p[4]) == 1 else .3))
    return Landscape(name='categories', meaning='', space=space, rho=lambda p: min(parts(p)), regions=2, region=lambda p: 0 if parts(p)[0] <= parts(p)[1] else 1, rate=.04/6+.01)

def _most():
    return Landscape(name='most-4', meaning='', space=_continuous(4), rho=lambda p: 0.1-max(abs(x-.5) for x in p[:2])/1.0*1, regions=1, region=lambda p: 0, rate=.96)

def _ball4():
    cs = [(0.2,.3,.7,.4), (.8,.7,.2,.3), (.3,.8,.3,.8), (.7,.2,.8,.7)]
    r = (0.008*2/math.pi**2)**.25
    return Landscape(name='balls-4', meaning='', space=_continuous(4), rho=lambda p: min(math.dist(p, c) for c in cs) - r, regions=4, region=lambda p: min(range(4), key=lambda i: math.dist(p, cs[i])), rate=.032)

def _conditional():
    space = Space((Dimension(name='weather', weights=(2, 1)), Dimension(name='dry', weights=(1,)*6, when=(Branch('weather',(0,)),)), Dimension(name='wet', weights=(1,)*3, when=(Branch('weather',(1,)),)), Dimension(name='rain', when=(Branch('weather',(1,)),)), *_continuous(3)))
    def parts(p):
        wet = space[0].bin(p[0]) == 1
        a = math.dist(p[4:6], (0.65, 0.3)) - _radius(0.06) + (0.3 if not wet else max(0, .7 - (p[3] if p[3] is not None else 0)))
        b = math.dist(p[4:6], (0.2, 0.8)) - _radius(0.05) + (0.2 if wet or p[1] is None or space[1].bin(p[1]) != 4 else 0)
        return a, b
    return Landscape(name='conditional', meaning='', space=space, rho=lambda p: min(parts(p)), regions=2, region=lambda p: 0 if parts(p)[0] <= parts(p)[1] else 1, rate=.01)
