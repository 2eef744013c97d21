"""``taxinet frame``: the picture of a scene, or a contact sheet of hours and skies."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.checked import tell_doubts
from taxinet_ros.cli.options import PictureOption, RendererOption, ScenarioOption
from taxinet_ros.errors import UsageError

_AXES = {'time_of_day_h': '--hours', 'clouds': '--clouds', 'rain_percent': '--rain'}


def frame(
    settings: ScenarioOption = None,
    hours: Annotated[
        str, typer.Option(metavar='LIST', help='local hours, e.g. 6,6.5,7; a sheet with one column '
                          'each')
    ] = '',
    clouds: Annotated[
        str, typer.Option(metavar='LIST', help='cloud kinds, e.g. clear,broken; a sheet with one '
                          'row each')
    ] = '',
    rain: Annotated[
        str, typer.Option(metavar='LIST', help='rain in percent, e.g. 0,25,100; a sheet with one '
                          'row each under every rain cloud')
    ] = '',
    camera: RendererOption = 'ours',
    out: PictureOption = None,
) -> None:
    """Render the first camera frame of a scene, or one pose at many hours and skies on a sheet.

    A sheet has nine hours and all skies, where they are not given.
    """
    from PIL import Image

    from taxinet_ros.analysis.camera.sheets import scene_picture
    from taxinet_ros.cli.training.pictures import new_picture, write_picture
    from taxinet_ros.core.camera.airframe import covering_doubts
    from taxinet_ros.core.scenario import scenario_from_human
    from taxinet_ros.trials.options import read_settings

    values = read_settings(settings or ())
    if hours or clouds or rain:
        _draw_sheet(values, hours, clouds, rain, camera, out)
        return
    scene = scenario_from_human(values)
    path = new_picture(out, 'camera-frame')
    write_picture(path, lambda: Image.fromarray(scene_picture(scene, camera)).save(path))
    print(f'picture: {path}')
    tell_doubts(covering_doubts(scene.aircraft_model, scene.camera_model))


def _draw_sheet(
    values: Mapping[str, object], hours: str, clouds: str, rain: str, camera: str,
    out: Path | None,
) -> None:
    from taxinet_ros.analysis.camera.sheets import HOURS, camera_sheet, sheet_scenes
    from taxinet_ros.cli.training.pictures import new_picture, numbers, words, write_picture
    from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS

    for key, option in _AXES.items():
        if key in values:
            raise UsageError(f'--set {key}: varies over the sheet; use {option} {values[key]}')
    columns = numbers('--hours', hours) or HOURS
    rains = numbers('--rain', rain) or (0.0,)
    kinds = words(clouds) or (RAIN_CLOUDS if rain else CLOUDS)
    scenes = sheet_scenes(values, columns, kinds, rains)
    path = new_picture(out, 'camera-sheet')
    write_picture(path, lambda: camera_sheet(scenes, path, camera))
    print(f'picture: {path}')
