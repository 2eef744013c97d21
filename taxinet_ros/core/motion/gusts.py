"""Turbulence near the ground: Dryden's spectra, MIL-F-8785C, section 3.7.

The aircraft moves through a frozen gust field carried by the mean wind (Taylor's hypothesis), so
the gust depends on the distance s travelled through the air. Along and across that path, with
scale length L::

    u: (2 sigma^2 L / pi) / (1 + (L Omega)^2),            correlation exp(-s/L)
    v: (sigma^2 L / pi) (1 + 3 (L Omega)^2) / (1 + (L Omega)^2)^2,  exp(-s/L) (1 - s/2L)

JSBSim has a Dryden model too, but its intensity follows from the wind at 20 ft, its filter is
accurate only for short steps, and its generator is global to the process. Here the intensity is
given, the correlations are exact for steps of any length, and a seed makes the gusts of a scene
reproducible. Vertical gusts are omitted: the ground suppresses them, and a taxiing aircraft has
hardly any lift.
"""

from __future__ import annotations

import math

import numpy as np

from taxinet_ros.core.types import FOOT_M

_HEIGHT_FT = 10.0
"""Lowest height covered by the specification's formulas, MIL-F-8785C figure 10."""
SCALE_LENGTH_M = _HEIGHT_FT / (0.177 + 0.000823 * _HEIGHT_FT) ** 1.2 * FOOT_M
"""Scale length of both horizontal components: 23 m."""
_C = 1.0 - 1.0 / math.sqrt(3.0)


class Gusts:
    """Gusts along one aircraft's path through the air.

    Attributes:
        sigma_mps: standard deviation of each component [m/s]; may change on the way.
    """

    def __init__(self, sigma_mps: float, seed: int) -> None:
        """Draw the initial gust.

        Args:
            sigma_mps: standard deviation of each component [m/s].
            seed: random seed.
        """
        self._draws = np.random.Generator(np.random.PCG64(seed))
        self.sigma_mps = sigma_mps
        # In units of sigma and L: u is low-pass filtered white noise; v has two low-passes in
        # series, with stationary covariance ((1/2, 1/4), (1/4, 1/4)).
        first, second, third = self._draws.standard_normal(3).tolist()
        self._u: float = first
        self._slow: float = second * math.sqrt(0.5)
        self._slower: float = 0.5 * self._slow + third * math.sqrt(0.125)

    @property
    def along_mps(self) -> float:
        """Gust velocity in the aircraft's direction of motion through the air [m/s]."""
        return self.sigma_mps * self._u

    @property
    def across_mps(self) -> float:
        """Gust velocity to the right of that direction [m/s]."""
        return self.sigma_mps * math.sqrt(3.0) * (self._slow - _C * self._slower)

    def advance(self, way_m: float) -> None:
        """Move through the air by ``way_m`` [m]."""
        step = way_m / SCALE_LENGTH_M
        decay = math.exp(-step)
        left = -math.expm1(-2.0 * step)  # 1 - decay^2
        first, second, third = self._draws.standard_normal(3).tolist()
        self._u = decay * self._u + math.sqrt(left) * first
        # Covariance that this step's noise adds to the two low-passes: P - F P F'.
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
