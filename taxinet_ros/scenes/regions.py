"""Uniform points in Scenic's regions by inverse transform, so that regions can be searched.

A point is given by one or two quantiles, each the share of the region on one side of it: across and
along a rectangle, radius and angle in a disc, x and then y in a polygon, distance along a line.
Uniform quantiles give the distribution from which Scenic itself draws. Regions that Scenic samples
by rejection (intersections, differences, volumes) are not supported.

Only the Scenic child may import this module.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import Any

import numpy as np
from scenic.core.distributions import MultiplexerDistribution, needsSampling
from scenic.core.geometry import averageVectors, headingOfSegment
from scenic.core.regions import (
    CircularRegion,
    GridRegion,
    PathRegion,
    PointSetRegion,
    PolygonalRegion,
    PolylineRegion,
    RectangularRegion,
    SectorRegion,
)
from scenic.core.vectors import OrientedVector, Vector

_SLABS = '_taxinet_slabs'


def coordinates(region: Any) -> tuple[str, ...]:
    """Names of the quantiles of a point in a region; empty if it has none.

    Args:
        region: may be random, or a choice among several.
    """
    region = getattr(region, '_conditioned', region)
    if isinstance(region, MultiplexerDistribution):
        names = {coordinates(option) for option in region.options}
        if () in names or not names:
            return ()
        return names.pop() if len(names) == 1 else ('u', 'v')[:max(map(len, names))]
    return _KINDS[type(region)][0] if type(region) in _KINDS else ()


def ends(region: Any, coordinate: int) -> tuple[float, float]:
    """Values [m] at quantiles 0 and 1 of a rectangle with its heading along y; else NaN."""
    if type(region) is not RectangularRegion or needsSampling(region) or region.heading != 0:
        return math.nan, math.nan
    middle, half = (
        (region.position.x, region.hw), (region.position.y, region.hl),
    )[coordinate]
    return float(middle - half), float(middle + half)


def point_at(region: Any, quantiles: Sequence[float]) -> Any:
    """The point of a sampled region at the given quantiles.

    Args:
        region: sampled from one that has :func:`coordinates`.
        quantiles: one per coordinate; further ones are ignored.
    """
    names, point = _KINDS[type(region)]
    return point(region, *quantiles[:len(names)])


def _in_rectangle(region: Any, across: float, along: float) -> Any:
    offset = Vector((2 * across - 1) * region.hw, (2 * along - 1) * region.hl, 0)
    return region.orient(region.position.offsetRotated(region.heading, offset))


def _in_disc(region: Any, radius: float, angle: float) -> Any:
    return _polar(region, radius, math.pi * (2 * angle - 1))


def _in_sector(region: Any, radius: float, angle: float) -> Any:
    return _polar(region, radius, region.angle * (angle - 0.5) + region.heading + math.pi / 2)


def _polar(region: Any, radius: float, direction: float) -> Any:
    x, y, z = region.center
    away = region.radius * math.sqrt(radius)
    return region.orient(Vector(x + away * math.cos(direction), y + away * math.sin(direction), z))


def _in_polygon(region: Any, share_x: float, share_y: float) -> Any:
    triangles, starts, widths, lengths, slopes, areas = _slabs(region)
    cumulative = np.cumsum(areas)
    number = min(int(np.searchsorted(cumulative, share_x * cumulative[-1], 'right')),
                 len(areas) - 1)
    area = share_x * cumulative[-1] - (cumulative[number] - areas[number])
    # Area up to x within the slab: length * t + slope * t^2 / 2.
    root = math.sqrt(max(lengths[number] ** 2 + 2 * slopes[number] * area, 0.0))
    whole = lengths[number] + root
    x = starts[number] + min(2 * area / whole if whole > 0 else 0.0, widths[number])
    low, high = _sections(triangles, x)
    order = np.argsort(low)
    low, size = low[order], (high - low)[order]
    sums = np.cumsum(size)
    number = min(int(np.searchsorted(sums, share_y * sums[-1], 'right')), len(size) - 1)
    y = low[number] + share_y * sums[-1] - (sums[number] - size[number])
    return region.orient(Vector(float(x), float(y), region.z))


def _slabs(region: Any) -> tuple[Any, ...]:
    """Triangles, and strips between their corners in which the section is linear in x.

    For each strip: start, width, section length at the start, slope, and area.
    """
    if _SLABS not in vars(region):
        triangles = np.array([
            triangle.exterior.coords[:3] for triangle, _ in region._samplingData[0]
        ])[:, :, :2]
        edges = np.unique(triangles[:, :, 0])
        starts, widths = edges[:-1], np.diff(edges)
        near, far = (
            np.array([_total(triangles, x) for x in starts + part * widths])
            for part in (0.25, 0.75)
        )
        slopes = (far - near) / (widths / 2)
        setattr(region, _SLABS, (
            triangles, starts, widths, near - slopes * widths / 4, slopes,
            (near + far) / 2 * widths,
        ))
    return tuple(vars(region)[_SLABS])


def _total(triangles: Any, x: float) -> float:
    low, high = _sections(triangles, x)
    return float(np.sum(high - low))


def _sections(triangles: Any, x: float) -> tuple[Any, Any]:
    """Lowest and highest y at an x of each triangle that contains it."""
    here, there = triangles, np.roll(triangles, -1, axis=1)
    with np.errstate(divide='ignore', invalid='ignore'):
        part = (x - here[:, :, 0]) / (there[:, :, 0] - here[:, :, 0])
    y = here[:, :, 1] + part * (there[:, :, 1] - here[:, :, 1])
    y = np.where((part >= 0) & (part <= 1), y, np.nan)
    present = np.isfinite(y).any(axis=1)
    return np.nanmin(y[present], axis=1), np.nanmax(y[present], axis=1)


def _on_polyline(region: Any, way: float) -> Any:
    number, part = _stretch(list(region.cumulativeLengths), way)
    start, end = region.segments[number]
    x, y = averageVectors(start, end, weight=part)
    if region._usingDefaultOrientation:
        return OrientedVector(x, y, 0, headingOfSegment(start, end))
    return region.orient(Vector(x, y, 0))


def _on_path(region: Any, way: float) -> Any:
    number, part = _stretch(list(accumulate(region.edge_lengths)), way)
    start, end = (region.vert_to_vec[corner] for corner in region.edges[number])
    return start + part * (end - start)


def _stretch(ends: list[float], way: float) -> tuple[int, float]:
    """Segment reached at a share of the total length, and the position within it."""
    at = way * ends[-1]
    number = min(bisect_right(ends, at), len(ends) - 1)
    start = ends[number - 1] if number else 0.0
    return number, min((at - start) / (ends[number] - start), 1.0)


def _among_points(region: Any, which: float) -> Any:
    return region.orient(Vector(*region.points[int(which * len(region.points))]))


_KINDS: dict[type, tuple[tuple[str, ...], Callable[..., Any]]] = {
    RectangularRegion: (('across', 'along'), _in_rectangle),
    CircularRegion: (('radius', 'angle'), _in_disc),
    SectorRegion: (('radius', 'angle'), _in_sector),
    PolygonalRegion: (('x', 'y'), _in_polygon),
    PolylineRegion: (('way',), _on_polyline),
    PathRegion: (('way',), _on_path),
    PointSetRegion: (('which',), _among_points),
    GridRegion: (('which',), _among_points),
}
"""Quantile names and point function by class; not for subclasses, which may draw differently."""
