"""Our camera against Mitsuba's pictures of the same scenes: edges in pixels, light by the hour.

An edge of a marking is found where Mitsuba's share of paint crosses one half, along rows for steep
edges and along columns for flat ones. Its shift is the one that makes Mitsuba's share of paint,
blurred as ours is by the ground's texture, explain the colours of our picture around it best; it is
measured across the edge. Our ground is drawn fresh, without wear, rubber and mottle, by the same
projection, texture and filter as usual. Edges of the aircraft's shadow are measured in the ratio
of our pictures with and without shadow.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mitsuba_scene import Coverage, MitsubaScene
from numpy.typing import NDArray

from taxinet_ros.core.camera.airframe import drawing
from taxinet_ros.core.camera.camera import Camera, pose
from taxinet_ros.core.camera.ground.atlas import make_ground_atlas
from taxinet_ros.core.camera.ground.pavement import standard_style
from taxinet_ros.core.camera.light import GAMMA, LUMINANCE, linear_exposure, scenario_light
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.place.catalogue import find_place
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import along_words, clock_words
from taxinet_ros.core.types import AircraftState

AIM_PX = 1.0
"""Aim for the shift of markings' edges [px]."""
NEAR_M = 8.0
"""Nearer than this a texel of the ground is several pixels wide [m]."""
SURFACES = ('pavement', 'paint', 'ground', 'sky')
HOURS = tuple(np.arange(6.5, 18.0, 1.0).tolist())

_ROLLED = json.dumps({
    'name': 'rolled', 'offset_m': [1.0, -1.5, 1.2], 'roll_deg': 9.0, 'pitch_deg': 22.0,
    'yaw_deg': -20.0, 'size_px': [320, 240], 'field_of_view_deg': 60.0,
})
SCENES: tuple[Mapping[str, object], ...] = (
    {'cross_track_m': 1, 'heading_deg': 5, 'distance_m': 300, 'time_of_day_h': 15},
    {'cross_track_m': -6, 'heading_deg': -20, 'distance_m': 900, 'time_of_day_h': 10},
    {'camera': _ROLLED, 'cross_track_m': -3, 'heading_deg': 12, 'distance_m': 150,
     'time_of_day_h': 13},
    {'place': 'bikf_10', 'camera': 'tail', 'heading_deg': -8, 'distance_m': 600,
     'time_of_day_h': 14},
    {'place': 'bikf_10', 'cross_track_m': 9, 'heading_deg': 25, 'distance_m': 20,
     'time_of_day_h': 16},
    {'place': 'nzqn_05', 'camera': 'strut', 'aircraft': 'c172p', 'heading_deg': 10,
     'distance_m': 90, 'time_of_day_h': 12},
    {'place': 'nzqn_05', 'cross_track_m': -4, 'heading_deg': -15, 'distance_m': 480,
     'time_of_day_h': 11},
    {'track': 'exit_left', 'camera': 'strut', 'aircraft': 'c172p', 'distance_m': 330,
     'time_of_day_h': 10},
)
"""Default scenes, in human keys and units: places, cameras, aircraft, tracks and poses."""
LIGHT_SCENE: Mapping[str, object] = {
    'distance_m': 300, 'cross_track_m': -5, 'camera': json.dumps({
        'name': 'light', 'offset_m': [3.0, 0.0, 1.5], 'pitch_deg': 10.0, 'size_px': [120, 90],
        'field_of_view_deg': 80.0,
    }),
}
"""Scene of the curves of light: paint, pavement, open ground and sky in a small picture."""

_REACH_PX, _MOST_PX, _STEP_PX = 14, 4.0, 0.1
_LEAST_ROOM_PX = 5
_LEAST_CONTRAST, _LEAST_FIT = 0.8, 0.8
_BLURS_PX = (0.5, 1.0, 2.0, 3.0, 5.0)
_WINDOW_PX = 7.0
_PURE = 0.99
_LEAST_EDGES, _LEAST_MEASURED, _LEAST_SPREAD = 20, 0.25, 0.15
_LOWEST_SUN = math.sin(math.radians(2.0))

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class Edges:
    """Edges found in one picture, and their shifts (ours minus the other's).

    Attributes:
        at_px: pixel (u, v) of each measured edge, (n, 2).
        normal: unit vectors across the edges, (n, 2), towards what is marked.
        shift_px: shifts along these, (n,).
        distance_m: distance of the ground there from the camera, (n,).
        found: number of edges found; those not measured are too faint in the other picture.
    """

    at_px: Floats
    normal: Floats
    shift_px: Floats
    distance_m: Floats
    found: int

    def summary(self) -> dict[str, float | int | None]:
        """Figures for tables, in pixels.

        Counts; what shift of all and what growth on all sides explain the edges' shifts best, None
        where edges of too few directions cannot tell them apart; and the sizes of the shifts.
        """
        sizes, far = np.abs(self.shift_px), self.distance_m >= NEAR_M
        across = down = growth = None
        if len(sizes) >= _LEAST_EDGES:
            # A larger area moves its edges against the normal, which points into it.
            factors = np.column_stack([self.normal, -np.ones(len(sizes))])
            solved, _, rank, _ = np.linalg.lstsq(factors, self.shift_px, rcond=_LEAST_SPREAD)
            if rank == 3:
                across, down, growth = solved.tolist()
        return {
            'edges': self.found, 'measured': len(sizes),
            'offset_u_px': across, 'offset_v_px': down, 'growth_px': growth,
            'median_px': _percentile(sizes, 50), 'p95_px': _percentile(sizes, 95),
            'p95_beyond_8_m_px': _percentile(sizes[far], 95),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneOpinion:
    """One scene in both cameras.

    Attributes:
        scenario: the scene.
        ours: our picture.
        theirs: the other's, without the aircraft; None if it was not wanted.
        markings: edges of paint.
        shadow: edges of the aircraft's shadow; None if the other's picture has none.
        sun_apart_deg: angle between our sun and the other's; of FlightGear's only the elevation is
            known.
    """

    scenario: Scenario
    ours: Picture
    theirs: Picture | None
    markings: Edges
    shadow: Edges | None
    sun_apart_deg: float

    @property
    def meets_aim(self) -> bool | None:
        """Whether 95 % of the edges of paint beyond :data:`NEAR_M` are within :data:`AIM_PX`.

        None if there are too few to tell. Where most edges of one picture are not in the other,
        paint is more than that away.
        """
        edges = self.markings
        far = np.abs(edges.shift_px[edges.distance_m >= NEAR_M])
        if edges.found < _LEAST_EDGES:
            return None
        if len(edges.shift_px) < _LEAST_MEASURED * edges.found:
            return False
        return bool(np.percentile(far, 95) <= AIM_PX) if len(far) >= _LEAST_EDGES else None

    def to_dict(self) -> dict[str, object]:
        """Ready for JSON."""
        human = self.scenario.to_human()
        keys = ('place', 'camera', 'aircraft', 'track', 'cross_track_m', 'heading_deg',
                'distance_m', 'date', 'time_of_day_h')
        return {
            **{key: human[key] for key in keys}, 'markings': self.markings.summary(),
            'shadow': self.shadow.summary() if self.shadow else None,
            'sun_apart_deg': self.sun_apart_deg, 'meets_aim': self.meets_aim,
        }


@dataclass(frozen=True, kw_only=True)
class LightHour:
    """Light at one hour under a clear sky.

    Attributes:
        hour: local time [h].
        sun_elevation_deg: by the other renderer.
        ours, theirs: luminance by surface, of :data:`SURFACES`, before exposure; in each one's own
            unit. None where a surface is not in the picture.
        shade_ours, shade_theirs: luminance of shaded over that of sunlit pavement; None where no
            pavement is in the picture, or the other has no shade.
    """

    hour: float
    sun_elevation_deg: float
    ours: Mapping[str, float | None]
    theirs: Mapping[str, float | None]
    shade_ours: float | None
    shade_theirs: float | None


@dataclass(frozen=True, kw_only=True)
class LightCurves:
    """Light over a day."""

    hours: tuple[LightHour, ...]

    def relative(self, surface: str) -> tuple[Floats, Floats]:
        """Luminance of a surface relative to that under the highest sun: ours and theirs, (n,)."""
        found = []
        highest = int(np.argmax([hour.sun_elevation_deg for hour in self.hours]))
        for name in ('ours', 'theirs'):
            values = np.array([getattr(hour, name)[surface] for hour in self.hours], np.float64)
            found.append(values / values[highest])
        return found[0], found[1]

    def contrast(self) -> tuple[Floats, Floats]:
        """Luminance of paint over that of pavement by hour: ours and theirs, (n,)."""
        ours, theirs = (
            np.divide(*(
                np.array([getattr(hour, name)[surface] for hour in self.hours], np.float64)
                for surface in ('paint', 'pavement')
            )) for name in ('ours', 'theirs')
        )
        return ours, theirs

    def greatest_ev(self, surface: str, least_sun_deg: float = 10.0) -> float | None:
        """Greatest difference of the relative curves in stops; None without the surface or sun.

        Args:
            surface: one of :data:`SURFACES`.
            least_sun_deg: hours with a lower sun are left out.
        """
        if not self.hours:
            return None
        ours, theirs = self.relative(surface)
        high = np.array([hour.sun_elevation_deg >= least_sun_deg for hour in self.hours])
        apart = np.abs(np.log2(ours / theirs))[high]
        return float(apart.max()) if np.isfinite(apart).any() else None

    def to_dict(self) -> dict[str, object]:
        """Ready for JSON."""
        return {
            'hours': [asdict(hour) for hour in self.hours],
            'greatest_ev_sun_above_10_deg': {
                surface: self.greatest_ev(surface) for surface in SURFACES
            },
        }


def scenes(settings: Mapping[str, object]) -> list[Scenario]:
    """The default scenes with some values set, each once; without their track at another place.

    Raises:
        UsageError: a value that no scenario may have.
    """
    lost = {'track'} if 'place' in settings else set()
    kept = [{key: one[key] for key in one if key not in lost} for one in SCENES]
    return list(dict.fromkeys(scenario_from_human({**one, **settings}) for one in kept))


def light_scenes(settings: Mapping[str, object]) -> list[Scenario]:
    """The scenes of a day's light, without the aircraft's shadow.

    Raises:
        UsageError: a value that no scenario may have.
    """
    return [
        scenario_from_human({**LIGHT_SCENE, **settings, 'shadows': 'off', 'time_of_day_h': hour})
        for hour in HOURS
    ]


def compare_scene(scenario: Scenario, *, shown: bool = False) -> SceneOpinion:
    """Render and measure one scene.

    Args:
        scenario: the scene.
        shown: whether Mitsuba's picture in daylight is wanted.

    Raises:
        UsageError: Mitsuba is not installed, or the scenario has what its scene does not show.
    """
    state = Aircraft(scenario).state
    scene = MitsubaScene(scenario, state)
    seen = scene.coverage()
    blocked = _behind_aircraft(scenario)
    distance = _distances(scenario, state)
    fresh = _rendered(replace(scenario, shadows=False), state, fresh=True).astype(np.float64)
    markings = find_edges(seen.paint, _paint_signal(fresh, seen), blocked, distance)
    lit = scene.sunlit()
    ground = seen.paint + seen.pavement + seen.ground
    ours, shadow = _rendered(scenario, state), None
    shade = np.where(ground > _PURE, 1 - lit, 0.0)
    if scenario.shadows and scene.sun[2] > _LOWEST_SUN and shade[~blocked].max(initial=0.0) > 0.5:
        bright = _rendered(replace(scenario, shadows=False), state)
        ratio = _linear(ours) / np.maximum(_linear(bright), 1e-4)
        horizon = blocked | (ground < _PURE)
        shadow = find_edges(shade, 1 - ratio, horizon, distance)
    theirs = None
    if shown:
        whole, sky = scene.radiance()
        theirs = _display(sky + (whole - sky) * np.where(ground > 0.5, lit, 1.0)[:, :, None])
    cosine = float(scenario_light(scenario).sun @ scene.sun)
    return SceneOpinion(
        scenario=scenario, ours=ours, theirs=theirs, markings=markings, shadow=shadow,
        sun_apart_deg=math.degrees(math.acos(min(1.0, cosine))),
    )


def compare_light(day: Iterable[Scenario]) -> LightCurves:
    """Compare the light of scenes that differ in their hour; those by night are left out.

    Raises:
        UsageError: Mitsuba is not installed, or a scenario has what its scene does not show.
    """
    found: list[LightHour] = []
    regions: dict[str, NDArray[np.bool_]] = {}
    for scenario in day:
        state = Aircraft(scenario).state
        scene = MitsubaScene(scenario, state)
        if scene.sun[2] < _LOWEST_SUN:
            continue
        light = scenario_light(scenario)
        codes = _rendered(scenario, state).astype(np.float64)
        ours = linear_exposure(np.minimum(codes, 254.0)) / light.exposure @ LUMINANCE
        whole, sky = (part @ LUMINANCE for part in scene.radiance())
        # The same at each hour.
        regions = regions or _regions(scene.coverage(), _behind_aircraft(scenario))
        shaded = regions['pavement']
        found.append(LightHour(
            hour=scenario.time_of_day_s / 3600,
            sun_elevation_deg=math.degrees(math.asin(scene.sun[2])),
            ours={name: _median(ours, where) for name, where in regions.items()},
            theirs={name: _median(whole, where) for name, where in regions.items()},
            shade_ours=float(LUMINANCE @ light.diffuse / (LUMINANCE @ light.total)),
            shade_theirs=float(sky[shaded].sum() / whole[shaded].sum()) if shaded.any() else None,
        ))
    return LightCurves(hours=tuple(found))


def plot_opinion(
    opinions: Sequence[SceneOpinion], curves: LightCurves | None, path: Path, other: str
) -> None:
    """Draw pictures of both, shifts by distance, and light by the hour, into a PNG file.

    Args:
        opinions: scenes; those with their picture are shown.
        curves: light over a day; None without.
        path: PNG file.
        other: name of the other renderer.
    """
    shown = [one for one in opinions if one.theirs is not None]
    figure = Figure(figsize=(14.0, 9.0), dpi=100, layout='constrained')
    FigureCanvasAgg(figure)
    halves: Any = figure.subfigures(2, 1, height_ratios=(1.25, 1.0))
    above, below = halves
    for column, (one, axes) in enumerate(zip(
        shown, above.subplots(2, len(shown), squeeze=False).T, strict=True,
    )):
        for picture, name, part in zip((one.ours, one.theirs), ('ours', other), axes,
                                       strict=True):
            assert picture is not None
            part.imshow(picture, interpolation='nearest')
            part.set_xticks([])
            part.set_yticks([])
            if not column:
                part.set_ylabel(name)
        axes[0].set_title(_title(one.scenario), fontsize=9)
    shifts, light, last = below.subplots(1, 3)
    _draw_shifts(shifts, opinions, other)
    if curves is not None and curves.hours:
        _draw_light(light, curves, other)
        shaded = any(hour.shade_theirs is not None for hour in curves.hours)
        (_draw_shade if shaded else _draw_contrast)(last, curves, other)
    figure.savefig(path, format='png', metadata={'Software': None})


def _title(scenario: Scenario) -> str:
    human = scenario.to_human()
    return (
        f'{find_place(scenario.place).name}, {scenario.camera_model.name}, '
        f'{clock_words(scenario.time_of_day_s / 3600)}\n{human["distance_m"]:.0f} m '
        f'{along_words(scenario.track)}, CTE {human["cross_track_m"]:+.0f} m, '
        f'heading {human["heading_deg"]:+.0f}°'
    )


def _draw_shifts(axes: Axes, opinions: Sequence[SceneOpinion], other: str) -> None:
    for one in opinions:
        edges = one.markings
        axes.plot(
            edges.distance_m, edges.shift_px, '.', markersize=2, alpha=0.5,
            label=f'{find_place(one.scenario.place).name}, {one.scenario.camera_model.name}',
        )
    for side in (-AIM_PX, AIM_PX):
        axes.axhline(side, color='k', linewidth=0.8, linestyle='--')
    axes.axvline(NEAR_M, color='k', linewidth=0.8, linestyle=':')
    axes.set_xscale('log')
    shown = axes.get_xlim()
    ticks = [at for at in (2, 5, 10, 20, 50, 100, 200, 500) if shown[0] < at < shown[1]]
    axes.set_xticks(ticks, [str(at) for at in ticks])
    axes.minorticks_off()
    axes.set_ylim(-4, 4)
    axes.set_xlabel('distance from the camera [m]')
    axes.set_ylabel(f'shift of edges of paint, ours minus {other} [px]')
    axes.legend(fontsize=7, markerscale=4)


def _draw_light(axes: Axes, curves: LightCurves, other: str) -> None:
    hours = [hour.hour for hour in curves.hours]
    colours = ('#555555', '#c8a000', '#2d8a2d', '#2060c0')
    for surface, colour in zip(SURFACES, colours, strict=True):
        ours, theirs = curves.relative(surface)
        axes.plot(hours, ours, color=colour, label=surface)
        axes.plot(hours, theirs, 'o', color=colour, markerfacecolor='none')
    axes.set_xlabel(f'hour (lines: ours; circles: {other})')
    axes.set_ylabel('luminance relative to that under the highest sun')
    axes.legend(fontsize=8)


def _draw_shade(axes: Axes, curves: LightCurves, other: str) -> None:
    ours = np.array([hour.shade_ours for hour in curves.hours], np.float64)
    theirs = np.array([hour.shade_theirs for hour in curves.hours], np.float64)
    _draw_both(axes, curves, ours, theirs, other)
    axes.set_ylabel('luminance of pavement in the shade over that in the sun')
    axes.set_ylim(0, 1)


def _draw_contrast(axes: Axes, curves: LightCurves, other: str) -> None:
    _draw_both(axes, curves, *curves.contrast(), other)
    axes.set_ylabel('luminance of paint over that of pavement')
    axes.set_ylim(bottom=0)


def _draw_both(
    axes: Axes, curves: LightCurves, ours: Floats, theirs: Floats, other: str
) -> None:
    hours = [hour.hour for hour in curves.hours]
    axes.plot(hours, ours, color='k', label='ours')
    axes.plot(hours, theirs, 'o', color='k', markerfacecolor='none', label=other)
    axes.set_xlabel('hour')
    axes.legend(fontsize=8)


def find_edges(
    share: Floats, signal: Floats, blocked: NDArray[np.bool_], distance_m: Floats
) -> Edges:
    """Find the edges of what is marked in one picture, and measure their shifts in another.

    Args:
        share: share of each pixel that is marked, 0..1, (height, width).
        signal: what grows with that share in the other picture.
        blocked: where one of the pictures shows something else.
        distance_m: of what each pixel shows.
    """
    down, across = np.gradient(share)
    size = np.maximum(np.hypot(across, down), 1e-9)
    down, across = down / size, across / size
    steep = np.abs(across) >= np.abs(down)
    upright = _scan(share, signal, blocked, steep)
    level = _scan(share.T, signal.T, blocked.T, ~steep.T)
    v, u = np.concatenate([upright.at, level.at[:, ::-1]]).T
    normal = np.stack([across[v, u], down[v, u]], axis=1)
    along = np.arange(len(v)) >= len(upright.at)
    return Edges(
        at_px=np.stack([u, v], axis=1).astype(np.float64), normal=normal,
        # From along a row or a column to across the edge.
        shift_px=np.concatenate([upright.shift_px, level.shift_px])
        * np.where(along, normal[:, 1], normal[:, 0]),
        distance_m=distance_m[v, u], found=upright.found + level.found,
    )


class _Scan(NamedTuple):
    """Edges along rows: number found; row and column, (n, 2), and shift of those measured."""

    found: int
    at: NDArray[np.intp]
    shift_px: Floats


def _scan(
    share: Floats, signal: Floats, blocked: NDArray[np.bool_], steep: NDArray[np.bool_]
) -> _Scan:
    """Find and measure edges along rows, where they are steep."""
    high = share > 0.5
    crossing = (high[:, 1:] != high[:, :-1]) & steep[:, :-1] & steep[:, 1:]
    found, at, shifts = 0, [], []
    width = share.shape[1]
    blurred = [
        cv2.GaussianBlur(
            share, (2 * math.ceil(4 * px) + 1, 1), px, borderType=cv2.BORDER_REPLICATE
        ) for px in _BLURS_PX
    ]
    for v, u in np.argwhere(crossing):
        room = slice(u - _LEAST_ROOM_PX, u + _LEAST_ROOM_PX + 2)
        if room.start < 0 or room.stop > width or blocked[v, room].any():
            continue
        if np.ptp(share[v, room]) < _LEAST_CONTRAST:
            continue
        found += 1
        near = np.arange(max(u - _REACH_PX, 0), min(u + _REACH_PX + 2, width))
        rows = [plane[v] for plane in blurred]
        shift, fit = _fitted(rows, signal[v], near[~blocked[v, near]], u + 0.5)
        if fit >= _LEAST_FIT:
            at.append((v, u))
            shifts.append(shift)
    return _Scan(found, np.array(at, np.intp).reshape(-1, 2), np.array(shifts, np.float64))


def _fitted(
    shares: Iterable[Floats], signal: Floats, at: NDArray[np.intp], middle: float
) -> tuple[float, float]:
    """Shift of the signal along a row and the explained part of its variance, 0..1."""
    weights = np.exp(-0.5 * ((at - middle) / _WINDOW_PX) ** 2)
    weights /= weights.sum()
    values = signal[at] - weights @ signal[at]
    spread = max(float(weights @ values**2), 1e-12)
    shifts = np.arange(-_MOST_PX, _MOST_PX + _STEP_PX / 2, _STEP_PX)
    best = 0.0, -1.0
    for share in shares:
        models = np.interp(at[None] - shifts[:, None], np.arange(len(share)), share)
        models -= (models @ weights)[:, None]
        together, own = (models * weights) @ values, (models**2) @ weights
        fits = np.where(together > 0, together**2 / (np.maximum(own, 1e-12) * spread), 0.0)
        at_best = int(fits.argmax())
        if fits[at_best] > best[1]:
            best = shifts[at_best] + _STEP_PX * _vertex(fits, at_best), float(fits[at_best])
    return float(best[0]), best[1]


def _vertex(values: Floats, at: int) -> float:
    """Top of the parabola through a greatest value and its neighbours, in steps from it."""
    if not 0 < at < len(values) - 1:
        return 0.0
    before, top, after = values[at - 1:at + 2]
    bend = before - 2 * top + after
    return float(0.5 * (before - after) / bend) if bend < 0 else 0.0


def _rendered(scenario: Scenario, state: AircraftState, *, fresh: bool = False) -> Picture:
    if not fresh:
        return Camera(scenario).render(state, 0)
    style = replace(
        standard_style(scenario.runway, crossing=scenario.crossing),
        mottle=0.0, rubber_amount=0.0, wear=0.0,
    )
    track = None if scenario.line.is_runway else scenario.line
    atlas = make_ground_atlas(style, scenario.runway, track, scenario.airport)
    return Camera(scenario, ground=atlas).render(state, 0)


def _paint_signal(picture: Floats, seen: Coverage) -> Floats:
    """Colour of the picture along the difference of paint and pavement."""
    paint, pavement = seen.paint > _PURE, seen.pavement > _PURE
    if not (paint.any() and pavement.any()):
        return np.zeros(picture.shape[:2])
    found: Floats = picture @ (picture[paint].mean(axis=0) - picture[pavement].mean(axis=0))
    return found


def _behind_aircraft(scenario: Scenario) -> NDArray[np.bool_]:
    camera = scenario.camera_model
    blocked = np.zeros(camera.shape[:2], bool)
    # The renderer's pictures may have more columns, which are cut off.
    wide = camera.height_px, camera.width_px
    parts = drawing(scenario.aircraft_model, camera, wide)
    if parts is not None:
        blocked[parts.rows, parts.columns] = (parts.behind < 255).any(axis=2)
    return blocked


def _distances(scenario: Scenario, state: AircraftState) -> Floats:
    """Distance of the ground in each pixel from the camera [m]; infinite in the sky."""
    camera = scenario.camera_model
    _, to_optical, place = pose(state, camera)
    v, u = np.mgrid[0:camera.height_px, 0:camera.width_px]
    rays = np.stack([u, v, np.ones_like(u)], axis=2) @ np.linalg.inv(camera.intrinsics).T
    rays = rays @ to_optical
    fall = -rays[:, :, 2] / np.linalg.norm(rays, axis=2)
    return np.where(fall > 0, place[2] / np.maximum(fall, 1e-9), math.inf)


def _regions(seen: Coverage, blocked: NDArray[np.bool_]) -> dict[str, NDArray[np.bool_]]:
    """Pixels of each surface, those near the horizon left out."""
    shares = {
        'pavement': seen.pavement, 'paint': seen.paint, 'ground': seen.ground,
        'sky': 1 - seen.pavement - seen.paint - seen.ground,
    }
    horizon = np.flatnonzero((shares['sky'] < 0.5).any(axis=1))
    rows = np.arange(len(blocked))[:, None]
    apart = np.abs(rows - (horizon[0] if len(horizon) else 0)) > len(blocked) // 15
    return {
        name: (share > _PURE) & ~blocked & apart for name, share in shares.items()
    }


def _median(values: Floats, where: NDArray[np.bool_]) -> float | None:
    return float(np.median(values[where])) if where.any() else None


def _linear(picture: Picture) -> Floats:
    found: Floats = (picture / 255.0) ** GAMMA @ LUMINANCE
    return found


def _display(radiance: Floats) -> Picture:
    """Display codes of a picture whose bright ground is nearly white."""
    white = max(float(np.percentile(radiance @ LUMINANCE, 90)), 1e-9)
    codes = 255 * np.clip(0.8 * radiance / white, 0, 1) ** (1 / GAMMA)
    return np.rint(codes).astype(np.uint8)


def _percentile(values: Floats, share: float) -> float | None:
    return float(np.percentile(values, share)) if len(values) else None
