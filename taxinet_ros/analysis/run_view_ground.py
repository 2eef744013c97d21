"""The runway seen from above, as shapes for the viewer's map."""

from __future__ import annotations

import math
from typing import Any

from taxinet_ros.analysis.report_text import plain_number
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.runway import (
    CROSSING_WIDTH_M,
    CROSSING_X_M,
    CROSSING_YAW_RAD,
    HALF_WIDTH_M,
    LENGTH_M,
    Polygon,
    markings,
)

_CROSSING_REACH_M = 400.0
"""How far to each side the crossing runway is drawn; runs stay nearer."""


def ground_name(*, crossing: bool) -> str:
    """What runs call the ground that they took place on."""
    return 'crossed' if crossing else 'plain'


def ground_shapes(*, crossing: bool) -> dict[str, Any]:
    """Polygons in ``map`` [m] as JSON values: pavement and paint, and the tolerated band's half."""
    runway = ((0.0, -HALF_WIDTH_M), (LENGTH_M, -HALF_WIDTH_M), (LENGTH_M, HALF_WIDTH_M),
              (0.0, HALF_WIDTH_M))
    pavement = (runway, _crossing()) if crossing else (runway,)
    return {
        'pavement': [_corners(polygon) for polygon in pavement],
        'paint': [_corners(marking.polygon) for marking in markings(crossing=crossing)],
        'tolerance': CENTRELINE_TOLERANCE_M,
        'length': LENGTH_M,
        'halfWidth': HALF_WIDTH_M,
    }


def _crossing() -> Polygon:
    cos, sin = math.cos(CROSSING_YAW_RAD), math.sin(CROSSING_YAW_RAD)
    half = CROSSING_WIDTH_M / 2
    return tuple(
        (CROSSING_X_M + along * cos - across * sin, along * sin + across * cos)
        for along, across in (
            (-_CROSSING_REACH_M, -half), (_CROSSING_REACH_M, -half),
            (_CROSSING_REACH_M, half), (-_CROSSING_REACH_M, half),
        )
    )


def _corners(polygon: Polygon) -> list[list[Any]]:
    return [[plain_number(x, 2), plain_number(y, 2)] for x, y in polygon]
