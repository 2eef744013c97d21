"""A recorded run as a film, MP4 or GIF: the camera's view, with errors and robustness below.

Each frame of the film is a control step. The curves are drawn once for the whole run; in each
frame the part beyond the cursor is covered by the same axes without curves.
"""

from __future__ import annotations

import errno
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

from taxinet_ros.bag.run.facts import RunFacts
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.bag.run.trace import Column
from taxinet_ros.core.mtl.interval import (
    lower_column,
    rho_text,
    specs_with_interval,
    upper_column,
)
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import make_atomically

Picture = NDArray[np.uint8]
_GIF_EVERY = 2
_GIF_SHRINK = 2
_GIF_COLOURS = 150
_SHADES = 6


def write_mp4(frames: Iterable[Picture], path: Path, rate_hz: float) -> int:
    """Write frames, (H, W, 3) uint8 RGB of even size, as MPEG-4 video in real time.

    The codec is MPEG-4 part 2: the headless OpenCV wheels have no H.264, and VP9 takes fifty
    times as long.

    Args:
        frames: the frames.
        path: new file.
        rate_hz: frames per second.

    Returns:
        Number of frames.

    Raises:
        OSError: it cannot be written.
    """
    return make_atomically(path, lambda draft: _encode(frames, draft, rate_hz))


def write_gif(
    frames: Iterable[Picture], path: Path, rate_hz: float, accents: Sequence[str] = ()
) -> int:
    """Write every second frame at half size as an endless GIF, in real time.

    Args:
        frames: (H, W, 3) uint8 RGB.
        path: new file.
        rate_hz: frames per second.
        accents: rare but important colours such as ``#0072B2`` that must not be lost.

    Returns:
        Number of frames.

    Raises:
        OSError: it cannot be written.
    """
    return make_atomically(path, lambda draft: _animate(_small(frames, accents), draft, rate_hz))


def _encode(frames: Iterable[Picture], path: Path, rate_hz: float) -> int:
    source = iter(frames)
    first = next(source)
    size = (first.shape[1], first.shape[0])
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'mp4v'), rate_hz, size)
    if not writer.isOpened():
        raise OSError(errno.EIO, 'OpenCV opens no MPEG-4 encoder for it')
    count = 0
    for frame in itertools.chain([first], source):
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        count += 1
    writer.release()
    # OpenCV does not report a full disk.
    if (stored := _frames_in(path)) != count:
        raise OSError(errno.ENOSPC, f'{stored} of {count} frames reached the disk')
    return count


def _frames_in(path: Path) -> int:
    capture = cv2.VideoCapture(str(path))
    try:
        return int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if capture.isOpened() else 0
    finally:
        capture.release()


def _animate(pictures: Iterator[Image.Image], path: Path, rate_hz: float) -> int:
    first = next(pictures)
    count = 1

    def rest() -> Iterator[Image.Image]:
        nonlocal count
        for picture in pictures:
            count += 1
            yield picture

    first.save(
        path, save_all=True, append_images=rest(), loop=0, optimize=False,
        duration=round(1000 * _GIF_EVERY / rate_hz),
    )
    return count


def _small(frames: Iterable[Picture], accents: Sequence[str]) -> Iterator[Image.Image]:
    """Every second frame at half size, with its most frequent colours and the accents."""
    fixed = [channel for accent in accents for channel in _fading(accent)]
    palette = Image.new('P', (1, 1))
    for frame in itertools.islice(frames, 0, None, _GIF_EVERY):
        height, width = frame.shape[:2]
        size = (width // _GIF_SHRINK, height // _GIF_SHRINK)
        picture = Image.fromarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA))
        own = picture.quantize(_GIF_COLOURS).getpalette() or []
        colours = own[:3 * _GIF_COLOURS] + fixed
        palette.putpalette(colours + colours[-3:] * (256 - len(colours) // 3))
        yield picture.quantize(palette=palette, dither=Image.Dither.NONE)


def _fading(colour: str) -> list[int]:
    """RGB values of a colour and of its shades towards white."""
    pure = np.array(ImageColor.getrgb(colour)[:3])
    return [
        int(channel)
        for share in np.linspace(0, 0.85, _SHADES)
        for channel in pure + (255 - pure) * share
    ]


_SHAPE_PX = (1080, 600)
"""Width and height of the picture, three times the camera's."""
PANEL_HEIGHT_PX = 360
_DPI = 100
_MOST_STEERING_DEG = 30.0
# Okabe-Ito colours, distinguishable with all common colour vision deficiencies.
_TRUTH, _ESTIMATE, _RHO, _BAND = '#0072B2', '#D55E00', '#7A4D9E', '#009E73'
_STEERING = '#F0E442'
ACCENTS = (_TRUTH, _ESTIMATE, _RHO, _BAND, _STEERING)
"""Colours with a meaning, although few pixels have them."""
_WHITE, _SHADE, _CURSOR = (255, 255, 255), (0, 0, 0, 150), (40, 40, 40)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Panel:
    """The plots, with and without curves, and the positions of their time axes.

    Attributes:
        empty, full: (H, W, 3) uint8.
        spec: name of the formula whose robustness is shown, or ''.
        axes: left, right, top and bottom of each plot [px].
        span_s: time at the two ends [s].
    """

    empty: Picture
    full: Picture
    spec: str
    axes: tuple[tuple[float, float, float, float], ...]
    span_s: tuple[float, float]

    def at(self, row: Mapping[str, Any]) -> Picture:
        """The panel with curves up to a row of the trace, a cursor there, and its values."""
        picture = self.empty.copy()
        low, high = self.span_s
        t_s = row['t_ns'] / NS_PER_S
        for left, right, top, bottom in self.axes:
            x = round(left + (right - left) * (t_s - low) / (high - low))
            first = round(left)
            picture[:, first:x + 1] = self.full[:, first:x + 1]
            cv2.line(picture, (x, round(top)), (x, round(bottom)), _CURSOR, 1)
        written = Image.fromarray(picture)
        self._write_numbers(ImageDraw.Draw(written), row)
        return np.asarray(written)

    def _write_numbers(self, draw: ImageDraw.ImageDraw, row: Mapping[str, Any]) -> None:
        (_, right, top, _), (_, rho_right, _, _) = self.axes
        y = top - 14
        for x, word, column, colour in (
            (right - 170, 'truth', 'cte_m', _TRUTH), (right, 'estimate', 'est_cte_m', _ESTIMATE)
        ):
            words = f'{word} {row[column]:+.2f} m'.replace('inf', '∞')
            draw.text((x, y), words, colour, _font(16), anchor='rm')
        if self.spec:
            ends = (row[column(self.spec)] for column in (lower_column, upper_column))
            words = f'[{", ".join(map(rho_text, ends))}]'.replace('inf', '∞')
            draw.text((rho_right, y), words, _RHO, _font(16), anchor='rm')


def film_frames(recording: Recording) -> Iterator[Picture]:
    """The frames of a run's film, (960, 1080, 3) uint8 RGB, one for each control step.

    Pictures of another size, but of this shape, are filmed in the same size.

    Raises:
        UsageError: the bag contains no camera frames, or such of another shape.
        BagError: it is damaged, not ours, or contains no truth.
    """
    bag, trace, facts = recording.path, recording.columns, recording.facts
    panel = _draw_panel(trace, recording.scenario.line.half_width_m)
    rows = {int(stamp): row for row, stamp in enumerate(trace['t_ns'])}
    shown = 0
    for frame in recording.frames(render=False):
        if (row := rows.get(frame.stamp_ns)) is None:
            continue
        shown += 1
        height, width = frame.image.shape[:2]
        if width * _SHAPE_PX[1] != height * _SHAPE_PX[0]:
            raise UsageError(f'{bag}: camera frames of {width} x {height}; a film takes 360 x 200')
        now = {name: column[row] for name, column in trace.items()}
        view = _view(frame.image, now, facts)
        yield np.vstack([view, panel.at(now)])
    if not shown:
        raise UsageError(
            f'{bag}: holds no camera frames; restore them with: taxinet bag render {bag}'
        )


def _view(pixels: Picture, row: Mapping[str, Any], facts: RunFacts | None) -> Picture:
    """The enlarged camera frame with text and the steering angle."""
    size = _SHAPE_PX
    large = Image.fromarray(cv2.resize(pixels, size, interpolation=cv2.INTER_CUBIC))
    shade = Image.new('RGBA', size, (0, 0, 0, 0))
    draw = ImageDraw.Draw(shade)
    draw.rectangle((0, 0, size[0], 46), fill=_SHADE)
    draw.text((16, 23), f't = {row["t_ns"] / NS_PER_S:4.1f} s', _WHITE, _font(22), anchor='lm')
    draw.text((size[0] // 2, 23), _title(facts), _WHITE, _font(22), anchor='mm')
    words = f'{row["speed_mps"]:.1f} m/s at {row["distance_m"]:.0f} m'
    draw.text((size[0] - 16, 23), words, _WHITE, _font(22), anchor='rm')
    _draw_steering(draw, size, float(np.rad2deg(row['steering_rad'])))
    large.paste(shade, mask=shade)
    return np.asarray(large)


def _draw_steering(draw: ImageDraw.ImageDraw, size: tuple[int, int], angle_deg: float) -> None:
    """Draw a bar at the lower edge, from the middle towards the side of the steering."""
    half, middle, y = 180, size[0] // 2, size[1] - 26
    draw.rectangle((middle - half - 20, y - 52, middle + half + 20, size[1]), fill=_SHADE)
    draw.rectangle((middle - half, y - 6, middle + half, y + 6), fill=(255, 255, 255, 60))
    if np.isfinite(angle_deg):
        side = 'left' if angle_deg > 0 else 'right'
        words = f'steering {abs(angle_deg):.1f}° {side}'
        end = middle - half * float(np.clip(angle_deg / _MOST_STEERING_DEG, -1, 1))
        draw.rectangle((min(middle, end), y - 6, max(middle, end), y + 6), fill=_STEERING)
    else:
        words = 'no command'
    draw.line((middle, y - 10, middle, y + 10), fill=_WHITE, width=2)
    draw.text((middle, y - 32), words, _WHITE, _font(20), anchor='mm')


def _title(facts: RunFacts | None) -> str:
    if facts is None:
        return ''
    perception = facts.nodes.get('perception')
    eyes = perception.implementation if perception is not None else ''
    return '  ·  '.join(word for word in (facts.run_id, eyes, facts.outcome) if word)

_fonts: dict[int, ImageFont.FreeTypeFont] = {}


def _font(size: int) -> ImageFont.FreeTypeFont:
    if size not in _fonts:
        _fonts[size] = ImageFont.truetype(findfont('DejaVu Sans'), size)
    return _fonts[size]


def _draw_panel(trace: Mapping[str, Column], half_width_m: float) -> _Panel:
    t_s = np.asarray(trace['t_ns'], dtype=np.int64) / NS_PER_S
    figure = Figure(figsize=(_SHAPE_PX[0] / _DPI, PANEL_HEIGHT_PX / _DPI), dpi=_DPI)
    canvas = FigureCanvasAgg(figure)
    plots = (figure.add_axes((0.07, 0.15, 0.5, 0.72)), figure.add_axes((0.66, 0.15, 0.32, 0.72)))
    spec = next(iter(specs_with_interval(trace)), '')
    curves = _draw_errors(plots[0], t_s, trace, half_width_m)
    if spec:
        curves += _draw_robustness(plots[1], t_s, trace, spec)
    else:
        plots[1].set_title('no robustness in the bag', fontsize=11, loc='left')
    span_s = (float(t_s[0]), float(max(t_s[-1], t_s[0] + 0.1)))
    for plot in plots:
        plot.set_xlim(*span_s)
        plot.set_xlabel('time [s]', labelpad=1)
    full = _pixels(canvas)
    for curve in curves:
        curve.set_visible(False)
    empty = _pixels(canvas)
    height = full.shape[0]
    boxes = [plot.get_window_extent() for plot in plots]
    return _Panel(
        empty=empty, full=full, span_s=span_s, spec=spec,
        axes=tuple((box.x0, box.x1, height - box.y1, height - box.y0) for box in boxes),
    )


def _draw_errors(
    plot: Axes, t_s: Column, trace: Mapping[str, Column], half_width_m: float
) -> list[Any]:
    limit = CENTRELINE_TOLERANCE_M
    plot.axhspan(-limit, limit, color=_BAND, alpha=0.18, linewidth=0)
    for side in (-1, 1):
        plot.axhline(side * half_width_m, color='0.25', linewidth=1.4)
    estimate = plot.plot(t_s, trace['est_cte_m'], color=_ESTIMATE, linewidth=1.1)
    truth = plot.plot(t_s, trace['cte_m'], color=_TRUTH, linewidth=2.0)
    seen = np.abs(np.concatenate([trace['cte_m'], trace['est_cte_m']]))
    most = float(np.max(seen[np.isfinite(seen)], initial=2 * CENTRELINE_TOLERANCE_M))
    plot.set_ylim(-1.1 * most, 1.1 * most)
    plot.set_title('cross-track error [m], left is up', fontsize=11, loc='left')
    return [*estimate, *truth]


def _draw_robustness(
    plot: Axes, t_s: Column, trace: Mapping[str, Column], spec: str
) -> list[Any]:
    """Draw the robustness interval of one formula."""
    upper = np.asarray(trace[upper_column(spec)], dtype=float)
    lower = np.asarray(trace[lower_column(spec)], dtype=float)
    known = np.concatenate([upper, lower, [0.0]])
    known = known[np.isfinite(known)]
    margin = 0.12 * max(float(np.ptp(known)), 1.0)
    low, high = float(known.min()) - margin, float(known.max()) + margin
    plot.set_ylim(low, high)
    plot.axhline(0, color='0.25', linewidth=1.0)
    beyond = np.clip(lower, low - 1, high + 1), np.clip(upper, low - 1, high + 1)
    area = plot.fill_between(t_s, *beyond, color=_RHO, alpha=0.25, linewidth=0)
    lines = [line for ends in beyond for line in plot.plot(t_s, ends, color=_RHO, linewidth=1.6)]
    plot.set_title(f'ρ of {spec}', fontsize=11, loc='left')
    return [area, *lines]


def _pixels(canvas: FigureCanvasAgg) -> Picture:
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
