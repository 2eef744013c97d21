"""A region of the space of scenes, such as a clear sky between 13:20 and 15:40.

A scan cuts features into cells with about equal numbers of runs and combines cells into regions.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from taxinet_ros.analysis.runs.features import BY_NAME, CLOUDS_KIND, Feature, Floats, Mask

Ints = npt.NDArray[np.int64]
Floats32 = npt.NDArray[np.float32]


def interval_cells(values: Floats, most: int) -> tuple[Floats, Floats, Ints]:
    """Cut a feature into cells with about equal numbers of runs.

    Equal values stay together. The ends of a cell are values of runs.

    Returns:
        Minimum and maximum of each cell, and the cell of each value.
    """
    ordered = np.sort(values)
    firsts = np.unique(ordered[(np.arange(most) * len(ordered)) // most])
    # A value shared by many runs, such as no rain, is a separate cell.
    common, counts = np.unique(ordered, return_counts=True)
    many = common[counts > len(ordered) / most]
    after = common[np.minimum(np.searchsorted(common, many) + 1, len(common) - 1)]
    firsts = np.unique(np.concatenate([firsts, many, after]))
    places = np.searchsorted(firsts, values, side='right') - 1
    ends = np.append(np.searchsorted(ordered, firsts[1:]), len(ordered)) - 1
    return firsts, ordered[ends], places.astype(np.int64)


@functools.cache
def neighbours(cells: int) -> Floats32:
    """All ranges of adjacent cells except the full range: (candidates, cells)."""
    pairs = [(low, high) for low in range(cells) for high in range(low + 1, cells + 1)
             if high - low < cells]
    numbers = np.arange(cells)
    chosen = [(numbers >= low) & (numbers < high) for low, high in pairs]
    return np.array(chosen, dtype=np.float32).reshape(-1, cells)


@functools.cache
def around_the_clock(cells: int) -> Floats32:
    """Like :func:`neighbours`, with the last cell adjacent to the first."""
    inner = neighbours(cells)
    without_ends = inner[(inner[:, 0] == 0) & (inner[:, -1] == 0)]
    return np.concatenate([inner, 1 - without_ends])


@functools.cache
def subsets(kinds: int) -> Floats32:
    """All subsets except the empty and the full one: (candidates, kinds)."""
    chosen = list(itertools.product((0, 1), repeat=kinds))[1:-1]
    return np.array(chosen, dtype=np.float32).reshape(-1, kinds)


@functools.cache
def beginnings(cells: int) -> Floats32:
    """The first cell, the first two and so on, except all: (candidates, cells)."""
    return np.tri(cells, dtype=np.float32)[:-1]


_FEW_KINDS = 3
_SWITCH_WORDS = {
    ('shadows', 'on'): 'with the shadow of the aircraft',
    ('shadows', 'off'): 'without the shadow of the aircraft',
    ('crossing', 'on'): 'with the crossing runway', ('crossing', 'off'): 'without crossing runway',
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Interval:
    """Closed interval of a numeric feature; None for an end beyond which no run lies.

    If ``low`` is above ``high``, it contains values above ``low`` or below ``high``, such as a
    night, which extends over midnight.
    """

    feature: str
    low: float | None
    high: float | None

    def mask(self, frame: pd.DataFrame) -> Mask:
        """Mask of the runs within."""
        values = frame[self.feature].to_numpy(dtype=np.float64)
        low = -np.inf if self.low is None else self.low
        high = np.inf if self.high is None else self.high
        if low > high:
            return (values >= low) | (values <= high)
        return (values >= low) & (values <= high)

    @property
    def names(self) -> tuple[str, ...]:
        """Features that it restricts."""
        return (self.feature,)

    def words(self) -> str:
        """Display text."""
        feature = BY_NAME[self.feature]
        if self.low is not None and self.high is not None and self.low > self.high:
            above, below = (feature.interval_words(self.low, None),
                            feature.interval_words(None, self.high))
            return f'{above} or {below}'
        return feature.interval_words(self.low, self.high)


@dataclass(frozen=True, kw_only=True, slots=True)
class Kinds:
    """A subset of a feature's words."""

    feature: str
    kinds: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Features that it restricts."""
        return (self.feature,)

    def mask(self, frame: pd.DataFrame) -> Mask:
        """Mask of the runs that have one of them."""
        return np.isin(frame[self.feature].to_numpy(dtype=object), self.kinds)

    def words(self) -> str:
        """Display text."""
        if len(self.kinds) == 1 and (self.feature, self.kinds[0]) in _SWITCH_WORDS:
            return _SWITCH_WORDS[self.feature, self.kinds[0]]
        feature = BY_NAME[self.feature]
        if feature is not CLOUDS_KIND:
            return f'{feature.title} {_listed(self.kinds)}'
        missing = tuple(kind for kind in feature.kinds if kind not in self.kinds)
        if 0 < len(missing) < _FEW_KINDS < len(self.kinds):
            return f'clouds other than {_listed(missing)}'
        return 'clear sky' if self.kinds == ('clear',) else f'{_listed(self.kinds)} clouds'


@dataclass(frozen=True, kw_only=True, slots=True)
class Slant:
    """Closed interval of the sum of a numeric feature and a multiple of another one."""

    feature: str
    other: str
    factor: float
    low: float | None
    high: float | None

    @property
    def names(self) -> tuple[str, ...]:
        """Features that it restricts."""
        return (self.feature, self.other)

    def values(self, frame: pd.DataFrame) -> Floats:
        """The sum for each run, in the unit of ``feature``."""
        first, other = (frame[name].to_numpy(dtype=np.float64) for name in self.names)
        total: Floats = first + self.factor * other
        return total

    def mask(self, frame: pd.DataFrame) -> Mask:
        """Mask of the runs within."""
        values = self.values(frame)
        low = -np.inf if self.low is None else self.low
        high = np.inf if self.high is None else self.high
        return (values >= low) & (values <= high)

    def words(self) -> str:
        """Display text."""
        first, other = (BY_NAME[name].axis for name in self.names)
        sign = '−' if self.factor < 0 else '+'
        total = f'{first} {sign} {abs(self.factor):g} × {other}'
        if self.low is None:
            return f'{total} at most {self.high:g}'
        if self.high is None:
            return f'{total} {self.low:g} or more'
        return f'{total} of {self.low:g} to {self.high:g}'.replace(' -', ' −')


@dataclass(frozen=True, kw_only=True, slots=True)
class Either:
    """Exclusive or of two parts that restrict different features."""

    either: tuple[Interval | Kinds, Interval | Kinds]

    @property
    def feature(self) -> str:
        """The first feature that it restricts."""
        return self.either[0].feature

    @property
    def names(self) -> tuple[str, ...]:
        """Features that it restricts."""
        return (self.either[0].feature, self.either[1].feature)

    def mask(self, frame: pd.DataFrame) -> Mask:
        """Mask of the runs within."""
        first, second = self.either
        return first.mask(frame) ^ second.mask(frame)

    def words(self) -> str:
        """Display text."""
        one, other = self.either
        return (
            f'{one.words()} and not {other.words()}, or {other.words()} and not {one.words()}'
        ).replace('not no ', 'with ')


Part = Interval | Kinds | Slant | Either


def part_of(values: Mapping[str, Any]) -> Part:
    """The part with these values, as :func:`dataclasses.asdict` gives them."""
    if 'either' in values:
        first, second = (part_of(each) for each in values['either'])
        assert isinstance(first, Interval | Kinds)
        assert isinstance(second, Interval | Kinds)
        return Either(either=(first, second))
    if 'kinds' in values:
        return Kinds(feature=values['feature'], kinds=tuple(values['kinds']))
    return Slant(**values) if 'factor' in values else Interval(**values)


@dataclass(frozen=True, kw_only=True, slots=True)
class Region:
    """Intersection of parts; no two restrict the same feature."""

    parts: tuple[Part, ...]

    def mask(self, frame: pd.DataFrame) -> Mask:
        """Mask of the runs within."""
        masks = [part.mask(frame) for part in self.parts]
        return np.logical_and.reduce([np.ones(len(frame), dtype=bool), *masks])

    def words(self) -> str:
        """Display text, such as ``clear sky, between 13:20 and 15:40``."""
        return ', '.join(part.words() for part in self.parts)

    @property
    def features(self) -> tuple[Feature, ...]:
        """Features that its parts restrict."""
        return tuple(BY_NAME[name] for part in self.parts for name in part.names)


def _listed(words: tuple[str, ...]) -> str:
    return words[0] if len(words) == 1 else f'{", ".join(words[:-1])} or {words[-1]}'
