"""Camera pictures with captions, scenes by hour and weather, and what a network sees."""

from __future__ import annotations

import contextlib
import math
import textwrap
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import IdentityTransform
from numpy.typing import NDArray
from PIL import Image

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.place.catalogue import find_place
from taxinet_ros.core.renderer import OURS, find_renderer
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import along_words, clock_words

if TYPE_CHECKING:
    from taxinet_ros.core.perception.onnx.network import OnnxNetwork

Picture = NDArray[np.uint8]
DESCRIBED = Path(__file__).with_name('described.j2')
"""What is said of places, aircraft and cameras."""
_GAP_PX, _DPI = 6, 72
"""At this resolution sizes of letters are in pixels."""
_FONT_SHARE = 22
"""Tile width over the height of caption letters, chosen to be readable in a report."""
_HEADING_SHARE = 85
"""The same for the headings of a whole table of pictures."""
_LETTER = 0.64
"""Width of a letter, relative to its height: that of a digit, which is a wide one."""


def contact_sheet(
    tiles: Sequence[tuple[Picture, str]], columns: int, path: Path,
    *, title: str = '',
) -> None:
    """Arrange pictures row by row, each with its caption below.

    The same tiles give the same bytes. Every tile gets the size of the largest picture; a smaller
    one is centred in it, not stretched. A caption wraps at spaces and keeps its line breaks.

    Args:
        tiles: pictures ((H, W, 3) uint8, RGB) and their captions.
        columns: number of pictures in a row.
        path: PNG file to write.
        title: title line.
    """
    images = [image for image, _ in tiles]
    height, width = _largest(images)
    px = max(width // _FONT_SHARE, 10)
    captions = [
        '\n'.join(chain.from_iterable(
            textwrap.wrap(line, int(width / (_LETTER * px))) or [''] for line in text.split('\n')
        )) for _, text in tiles
    ]
    below_px = round(1.3 * px) * max(caption.count('\n') + 1 for caption in captions) + _GAP_PX
    rows = [images[first:first + columns] for first in range(0, len(images), columns)]
    figure, corners = _sheet(rows, (height, width), title, round(1.4 * px), below_px=below_px)
    for (left, top), caption in zip(chain.from_iterable(corners), captions, strict=True):
        figure.text(left + 2, top - height - 2, caption, fontsize=px, va='top',
                    transform=IdentityTransform())
    _save(figure, path)


def grid_sheet(
    tiles: Sequence[Sequence[Picture]], rows: Sequence[str], columns: Sequence[str], path: Path,
    *, title: str,
) -> None:
    """Arrange pictures as a table with a heading for every row and every column.

    Args:
        tiles: one sequence of pictures ((H, W, 3) uint8, RGB) per row.
        rows: row headings; they keep their line breaks.
        columns: column headings.
        path: PNG file to write.
        title: title line.
    """
    height, width = _largest([image for row in tiles for image in row])
    # A sheet is viewed as a whole, so its headings scale with it, not with its pictures.
    px = max(round(1.4 * max(width // _FONT_SHARE, 10)), len(columns) * width // _HEADING_SHARE)
    longest = max(len(line) for row in rows for line in row.split('\n'))
    figure, corners = _sheet(
        tiles, (height, width), title, px, left_px=round(_LETTER * px * longest) + 3 * _GAP_PX,
        above_px=2 * px,
    )
    for column, (left, top) in zip(columns, corners[0], strict=True):
        figure.text(left + width / 2, top + _GAP_PX, column, fontsize=px, ha='center',
                    transform=IdentityTransform())
    for row, ((left, top), *_) in zip(rows, corners, strict=True):
        figure.text(left - 2 * _GAP_PX, top - height / 2, row, fontsize=px, ha='right',
                    va='center', multialignment='right', transform=IdentityTransform())
    _save(figure, path)


def _largest(images: Sequence[Picture]) -> tuple[int, int]:
    """Height and width of a cell."""
    return max(one.shape[0] for one in images), max(one.shape[1] for one in images)


def _sheet(
    rows: Sequence[Sequence[Picture]], cell: tuple[int, int], title: str, px: int, *,
    left_px: int = 0, above_px: int = 0, below_px: int = 0,
) -> tuple[Figure, list[list[tuple[int, int]]]]:
    """A figure of pictures, pixel by pixel, and the upper left corner of each cell, y upwards."""
    height, width = cell
    head_px = above_px + (2 * px + _GAP_PX if title else 0)
    across, down = width + _GAP_PX, height + below_px + _GAP_PX
    size = (
        left_px + _GAP_PX + across * max(map(len, rows)), head_px + _GAP_PX + down * len(rows),
    )
    # Half a pixel more, as a size that is a little too small would lose a whole one.
    figure = Figure(figsize=((size[0] + 0.5) / _DPI, (size[1] + 0.5) / _DPI), dpi=_DPI)
    figure.text(_GAP_PX + 2, size[1] - 2 * _GAP_PX, title, fontsize=px, va='top',
                transform=IdentityTransform())
    corners: list[list[tuple[int, int]]] = []
    for number, row in enumerate(rows):
        top = size[1] - head_px - _GAP_PX - number * down
        corners.append([(left_px + _GAP_PX + across * at, top) for at in range(len(row))])
        for image, (left, _) in zip(row, corners[-1], strict=True):
            figure.figimage(
                image, left + (width - image.shape[1]) // 2,
                top - (height + image.shape[0]) // 2, origin='upper',
            )
    return figure, corners


def _save(figure: Figure, path: Path) -> None:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3]).save(path, format='PNG')


HOURS = (6.0, 6.5, 7.0, 9.0, 12.0, 14.0, 15.5, 17.0, 17.5)
"""Default local hours of a sheet, more closely spaced at dawn and dusk."""
POSE = {'cross_track_m': 1.0, 'heading_deg': 4.0, 'distance_m': 900.0}
"""Default pose of a sheet: it shows the centreline, both edges and our shadow after noon."""


def scene_picture(scene: Scenario, camera: str = OURS) -> Picture:
    """The first camera frame of a run of ``scene``, (200, 360, 3) uint8 RGB.

    Args:
        scene: the scene.
        camera: who takes the picture (:mod:`taxinet_ros.core.renderer`).

    Raises:
        UsageError: the camera is unknown, or cannot show the scene.
        InfraError: it failed.
    """
    state, renderer = Aircraft(scene).state, find_renderer(camera)
    if renderer is None:
        return Camera(scene).render(state, 0)
    with contextlib.closing(renderer.make(scene)) as theirs:
        return theirs.render(state, 0)


def sheet_scenes(
    settings: Mapping[str, object], hours: Sequence[float], clouds: Sequence[str],
    rains: Sequence[float],
) -> list[list[Scenario]]:
    """Scenes of one pose: one row per weather with one scene per hour.

    Args:
        settings: scenario values shared by all, in human keys and units; the default pose is
            :data:`POSE`.
        hours: local hours.
        clouds: cloud kinds.
        rains: rain [%]; one row for each under each kind of cloud.

    Raises:
        UsageError: a value that no scenario may have.
    """
    return [
        [
            scenario_from_human(
                {**POSE, **settings, 'time_of_day_h': hour, 'clouds': cloud, 'rain_percent': rain}
            )
            for hour in hours
        ]
        for cloud in clouds
        for rain in rains
    ]


def camera_sheet(
    scenes: Sequence[Sequence[Scenario]], path: Path, camera: str = OURS
) -> None:
    """Draw the scenes of :func:`sheet_scenes` as a table of pictures, into a PNG file."""
    first = scenes[0][0]
    grid_sheet(
        [[scene_picture(scene, camera) for scene in row] for row in scenes],
        [_weather(row[0]) for row in scenes],
        [clock_words(scene.time_of_day_s / 3600) for scene in scenes[0]],
        path, title=f'{find_place(first.place).title}, {first.date}, {pose_words(first)}',
    )


def _weather(scene: Scenario) -> str:
    rain = f'\nrain {100 * scene.rain_fraction:.0f} %' if scene.rain_fraction else ''
    return f'{scene.clouds}{rain}'


def pose_words(scene: Scenario) -> str:
    """The start pose of a scene in display units."""
    human = scene.to_human()
    return (
        f'{human["distance_m"]:.0f} m {along_words(scene.track)}, '
        f'CTE {human["cross_track_m"]:+.1f} m, heading {human["heading_deg"]:+.0f}°'
    )


def draw_network_view(network: OnnxNetwork, name: str, scene: Scenario, path: Path) -> str:
    """Draw the first frame of a scene, with what a network uses of it, and beside it its input.

    Args:
        network: the network.
        name: of its file.
        scene: the scene.
        path: PNG file to write.

    Returns:
        Truth and answer, a line each.
    """
    from taxinet_ros.core.perception.eye import find_eye
    from taxinet_ros.core.perception.network import usual_frame
    from taxinet_ros.core.perception.onnx.network import prepare

    sidecar, seen = network.sidecar, scene_picture(scene)
    frame = usual_frame(seen)
    seen = frame if sidecar.picture.view is None else find_eye(
        sidecar.picture.view, scene.rig).see(seen)
    picture = prepare(seen, sidecar)[0]
    if sidecar.picture.layout == 'nchw':
        picture = picture.transpose(1, 2, 0)
    picture = picture.reshape((sidecar.picture.height, sidecar.picture.width, -1))
    truth = _errors(scene.cross_track_m, scene.heading_rad)
    answer = _errors(*network.look(seen))
    figure = Figure(figsize=(11.0, 3.4), dpi=100, layout='constrained')
    before, after = figure.subplots(1, 2)
    before.imshow(frame)
    left, top, right, bottom = sidecar.picture.crop
    before.add_patch(Rectangle(
        (left - 0.5, top - 0.5), right - left, bottom - top, fill=False, edgecolor='orange',
        linewidth=1.5,
    ))
    before.set_title('the frame, and what is used of it')
    low, high = float(picture.min()), float(picture.max())
    shown = (picture - low) / max(high - low, 1e-6)
    after.imshow(shown[..., 0] if shown.shape[2] == 1 else shown, cmap='gray')
    height, width = shown.shape[:2]
    after.set_title(f'the input: {width} x {height}, {low:.2f} (black) to {high:.2f} (white)')
    for axes in (before, after):
        axes.set(xticks=[], yticks=[])
    figure.suptitle(f'truth: {truth}; {name}: {answer}')
    figure.savefig(path, format='png', metadata={'Software': None})
    return f'truth {truth}\nanswer {answer}'


def _errors(cte_m: float, he_rad: float) -> str:
    return f'CTE {cte_m:+.2f} m, HE {math.degrees(he_rad):+.1f} deg'
