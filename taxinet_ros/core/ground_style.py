"""How a runway strip looks: the shades, the wear and the pattern of chance of its textures.

The shades of :data:`STANDARD` are display codes 0..255 in bright daylight (gamma-coded albedo),
measured on pictures of the real scene: clean asphalt 134, thick rubber 50, fresh paint 206.
Training may vary the look (domain randomisation); place and size of runway, edge stripes and
crossing never do, for they are what a cross-track error is read from. Only an experiment takes the
crossing away altogether.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Tint = tuple[float, float, float]

_OPTIONAL = ('threshold', 'designation', 'aiming', 'touchdown', 'centreline')


@dataclass(frozen=True, kw_only=True, slots=True)
class GroundStyle:
    """The look of the ground.

    Attributes:
        seed: of everything that chance has laid down: mottle, cracks, streaks, wear.
        asphalt, rubber, paint: display codes 0..255 in bright daylight.
        asphalt_tint, near_tint, far_tint: RGB factors of clean asphalt, and display codes of the
            bare ground beside the runway and of the grass farther out.
        mottle: strength of the asphalt's mottle, joints and cracks, 1 = as at KMWH.
        rubber_amount: how much tyre rubber lies about, 1 = as at KMWH.
        rubber_shift_m: how far left of the centreline most of it lies [m].
        wear: how much of the paint is gone, 1 = as at KMWH.
        edge_wear: the same for the edge stripes, 0 = fresh.
        dash_scale, dash_shift_m: factor on lengths along the runway, and shift [m], of all paint
            but the edge stripes.
        without: kinds of marking (see :class:`~taxinet_ros.core.runway.Marking`) left out.
        crossing: whether the crossing runway is there and interrupts pavement and paint.
    """

    seed: int = 0
    asphalt: float = 134.0
    rubber: float = 50.0
    paint: float = 206.0
    asphalt_tint: Tint = (1.05, 1.0, 0.91)
    near_tint: Tint = (164.0, 157.0, 135.0)
    far_tint: Tint = (133.0, 130.0, 97.0)
    mottle: float = 1.0
    rubber_amount: float = 1.0
    rubber_shift_m: float = 0.0
    wear: float = 1.0
    edge_wear: float = 0.0
    dash_scale: float = 1.0
    dash_shift_m: float = 0.0
    without: tuple[str, ...] = ()
    crossing: bool = True


STANDARD = GroundStyle()
"""KMWH 04 as the camera shows it in every test."""


def varied_style(rng: np.random.Generator) -> GroundStyle:
    """A look drawn at random, wide enough that real pictures should lie within (Tobin et al. 2017).

    Asphalt is kept apart from the ground beside it and from the paint, as on any runway in use.
    """
    asphalt = rng.uniform(85, 160)
    near = rng.uniform(100, 185)
    cast = 1 + rng.uniform(-0.08, 0.08, 3)
    far = near * rng.uniform(0.6, 1.05)
    return GroundStyle(
        seed=int(rng.integers(1, 2**31)),
        asphalt=asphalt,
        rubber=rng.uniform(30, 0.7 * asphalt),
        paint=min(asphalt + rng.uniform(40, 90), 235.0),
        asphalt_tint=_tint(cast * (1.03, 1.0, 0.94)),
        near_tint=_tint(near * cast * (1.06, 1.0, rng.uniform(0.75, 0.95))),
        far_tint=_tint(far * cast * (1.0, 1.0, rng.uniform(0.65, 0.9))),
        mottle=rng.uniform(0.5, 2.5),
        rubber_amount=rng.uniform(0, 1.8),
        rubber_shift_m=rng.normal(0, 0.7),
        wear=rng.uniform(0.3, 2.2),
        edge_wear=rng.uniform(0, 1.5),
        dash_scale=rng.uniform(0.4, 1.3),
        dash_shift_m=rng.uniform(-40, 40),
        without=tuple(kind for kind in _OPTIONAL if rng.uniform() < 0.25),
    )


def _tint(values: np.ndarray) -> Tint:
    red, green, blue = (float(value) for value in values)
    return red, green, blue
