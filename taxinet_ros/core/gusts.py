"""Turbulence near the ground: Dryden's spectra, as in MIL-F-8785C, section 3.7.

The aircraft moves through a field of gusts that is carried along by the mean wind and does not
change on the way (Taylor's hypothesis), so what it feels depends on the way that it has gone
through the air. Along this way and across it, with s the way and L the scale length::

    u: (2 sigma^2 L / pi) / (1 + (L Omega)^2),            correlation exp(-s/L)
    v: (sigma^2 L / pi) (1 + 3 (L Omega)^2) / (1 + (L Omega)^2)^2,  exp(-s/L) (1 - s/2L)

JSBSim has Dryden's model too. There the strength follows from the wind at 20 ft, the samples are
those of a filter for short steps, and the generator belongs to the process; here the strength is
given, the samples have these correlations exactly for steps of any length, and a seed says which
they are, so that the same scene has the same gusts everywhere. Vertical gusts are left out: the
ground stops them, and a taxiing aircraft has next to no lift.
"""

from __future__ import annotations

import math

import numpy as np

M_PER_FT = 0.3048
_HEIGHT_FT = 10.0
"""The least height that the specification has formulas for, MIL-F-8785C figure 10."""
SCALE_LENGTH_M = _HEIGHT_FT / (0.177 + 0.000823 * _HEIGHT_FT) ** 1.2 * M_PER_FT
"""Of either horizontal component: 23 m."""
_C = 1.0 - 1.0 / math.sqrt(3.0)


class Gusts:
    """The gusts on one aircraft's way through the air."""

    def __init__(self, sigma_mps: float, seed: int) -> None:
        """Draw the gust at the beginning.

        Args:
            sigma_mps: standard deviation of either component [m/s].
            seed: which of all gusts.
        """
        self._draws = np.random.Generator(np.random.PCG64(seed))
        self._sigma_mps = sigma_mps
        # In units of sigma and L: u is one low-pass of white noise; v has two, one after the other,
        # of which the stationary covariance is ((1/2, 1/4), (1/4, 1/4)).
        first, second, third = self._draws.standard_normal(3).tolist()
        self._u: float = first
        self._slow: float = second * math.sqrt(0.5)
        self._slower: float = 0.5 * self._slow + third * math.sqrt(0.125)

    @property
    def along_mps(self) -> float:
        """Of the air, in the direction in which the aircraft moves through it [m/s]."""
        return self._sigma_mps * self._u

    @property
    def across_mps(self) -> float:
        """To the right of that [m/s]."""
        return self._sigma_mps * math.sqrt(3.0) * (self._slow - _C * self._slower)

    def advance(self, way_m: float) -> None:
        """Go on through the air by ``way_m`` [m]."""
        step = way_m / SCALE_LENGTH_M
        decay = math.exp(-step)
        left = -math.expm1(-2.0 * step)  # 1 - decay^2
        first, second, third = self._draws.standard_normal(3).tolist()
        self._u = decay * self._u + math.sqrt(left) * first
        # What the noise of this step adds to the two low-passes: covariance P - F P F'.
        kept = decay * decay
        variance = 0.5 * left
        both = 0.25 * (left - 2.0 * step * kept)
        rest = 0.25 * (left - 2.0 * step * kept - 2.0 * step * step * kept)
        self._slower = decay * (self._slower + step * self._slow)
        self._slow *= decay
        if variance > 0.0:
            self._slow += math.sqrt(variance) * second
            gain = both / math.sqrt(variance)
            self._slower += gain * second + math.sqrt(max(rest - gain * gain, 0.0)) * third
