"""A part of the space of scenes, such as a clear sky between 13:20 and 15:40."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from taxinet_ros.analysis.group_rates import Mask
from taxinet_ros.analysis.run_features import BY_NAME, CLOUDS_KIND, Feature

_FEW_KINDS = 3
_SWITCH_WORDS = {
    ('shadows', 'on'): 'with the shadow of the aircraft',
    ('shadows', 'off'): 'without the shadow of the aircraft',
    ('crossing', 'on'): 'with the crossing runway', ('crossing', 'off'): 'without crossing runway',
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Interval:
    """Values of a numeric feature, the ends included; None for an end that no run lies beyond."""

    feature: str
    low: float | None
    high: float | None

    def mask(self, frame: pd.DataFrame) -> Mask:
        """Which runs lie within."""
        values = frame[self.feature].to_numpy(dtype=np.float64)
        low = -np.inf if self.low is None else self.low
        high = np.inf if self.high is None else self.high
        return (values >= low) & (values <= high)

    def words(self) -> str:
        """For people."""
        return BY_NAME[self.feature].interval_words(self.low, self.high)


@dataclass(frozen=True, kw_only=True, slots=True)
class Kinds:
    """Some of a feature's words."""

    feature: str
    kinds: tuple[str, ...]

    def mask(self, frame: pd.DataFrame) -> Mask:
        """Which runs have one of them."""
        return np.isin(frame[self.feature].to_numpy(dtype=object), self.kinds)

    def words(self) -> str:
        """For people."""
        if len(self.kinds) == 1 and (self.feature, self.kinds[0]) in _SWITCH_WORDS:
            return _SWITCH_WORDS[self.feature, self.kinds[0]]
        feature = BY_NAME[self.feature]
        if feature is not CLOUDS_KIND:
            return f'{feature.title} {_listed(self.kinds)}'
        missing = tuple(kind for kind in feature.kinds if kind not in self.kinds)
        if 0 < len(missing) < _FEW_KINDS < len(self.kinds):
            return f'clouds other than {_listed(missing)}'
        return 'clear sky' if self.kinds == ('clear',) else f'{_listed(self.kinds)} clouds'


Part = Interval | Kinds


@dataclass(frozen=True, kw_only=True, slots=True)
class Region:
    """The scenes that lie in all of its parts, of which each is about another feature."""

    parts: tuple[Part, ...]

    def mask(self, frame: pd.DataFrame) -> Mask:
        """Which runs lie within."""
        masks = [part.mask(frame) for part in self.parts]
        return np.logical_and.reduce([np.ones(len(frame), dtype=bool), *masks])

    def words(self) -> str:
        """For people, such as ``clear sky, between 13:20 and 15:40``."""
        return ', '.join(part.words() for part in self.parts)

    @property
    def features(self) -> tuple[Feature, ...]:
        """What its parts are about."""
        return tuple(BY_NAME[part.feature] for part in self.parts)


def _listed(words: tuple[str, ...]) -> str:
    return words[0] if len(words) == 1 else f'{", ".join(words[:-1])} or {words[-1]}'
