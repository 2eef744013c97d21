"""``taxinet camera``: list, describe and try cameras; render frames and contact sheets."""

from __future__ import annotations

from typing import Annotated

import typer

from taxinet_ros.cli.checked import tell_doubts
from taxinet_ros.cli.completion import complete_aircraft
from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import (
    PictureOption,
    RendererOption,
    ScenarioOption,
    YamlOption,
    refuse_given,
)
from taxinet_ros.errors import UsageError

_AXES = {'time_of_day_h': '--hours', 'clouds': '--clouds', 'rain_percent': '--rain'}

camera_app = command_group('Describe cameras, and render their frames.')


@camera_app.command('show')
def show_camera(
    context: typer.Context,
    camera: Annotated[
        str | None,
        typer.Argument(metavar='[CAMERA]', help='shipped name, or YAML file of one (default: list '
                       'those that are shipped)'),
    ] = None,
    aircraft: Annotated[
        str | None,
        typer.Option(
            metavar='NAME|FILE', help='aircraft: caravan, c172p, or a YAML file of one',
            autocompletion=complete_aircraft,
        ),
    ] = None,
    out: PictureOption = None,
    yaml: YamlOption = None,
) -> None:
    """Describe a camera, and with --out draw what it sees and where it looks, or list all."""
    from taxinet_ros.analysis.camera.rig_pictures import camera_text, draw_camera
    from taxinet_ros.cli.training.pictures import new_picture, write_document, write_picture
    from taxinet_ros.core.camera.airframe import covering_doubts
    from taxinet_ros.core.motion.aircraft import checked_aircraft
    from taxinet_ros.core.rig.catalogue import AIRCRAFT, CAMERAS

    if camera is None:
        refuse_given(context, ('aircraft', 'out', 'yaml'), 'only with a CAMERA')
        for name in CAMERAS.shipped:
            found = CAMERAS.find(name)
            print(f'{name:<6} {found.width_px}x{found.height_px}  {found.title}')
        return
    found = CAMERAS.typed(camera)
    on = checked_aircraft(AIRCRAFT.typed(aircraft or AIRCRAFT.default))
    path = None if out is None else new_picture(out, '')
    if yaml is not None:
        write_document(found, yaml)
    print(camera_text(found))
    if path is not None:
        write_picture(path, lambda: draw_camera(found, on, path))
    tell_doubts(covering_doubts(on, found))


@camera_app.command('frame')
def frame(
    settings: ScenarioOption = None,
    camera: RendererOption = 'ours',
    out: PictureOption = None,
) -> None:
    """Render the first camera frame of a run of one scene, as large as its camera makes it."""
    from PIL import Image

    from taxinet_ros.analysis.camera.sheets import scene_picture
    from taxinet_ros.cli.training.pictures import new_picture, write_picture
    from taxinet_ros.core.camera.airframe import covering_doubts
    from taxinet_ros.core.scenario import scenario_from_human
    from taxinet_ros.trials.options import read_settings

    scene = scenario_from_human(read_settings(settings or ()))
    path = new_picture(out, 'camera-frame')
    write_picture(path, lambda: Image.fromarray(scene_picture(scene, camera)).save(path))
    print(f'picture: {path}')
    tell_doubts(covering_doubts(scene.aircraft_model, scene.camera_model))


@camera_app.command('sheet')
def sheet(
    hours: Annotated[str, typer.Option(help='local hours, e.g. 6,6.5,7; one column each')] = '',
    clouds: Annotated[str, typer.Option(help='cloud kinds, e.g. clear,broken; one row each')] = '',
    rain: Annotated[
        str, typer.Option(help='rain in percent, e.g. 0,25,100; one row each under every rain '
        'cloud')
    ] = '',
    settings: ScenarioOption = None,
    camera: RendererOption = 'ours',
    out: PictureOption = None,
) -> None:
    """Render one pose at many hours and skies on one contact sheet."""
    from taxinet_ros.analysis.camera.sheets import HOURS, camera_sheet, sheet_scenes
    from taxinet_ros.cli.training.pictures import new_picture, numbers, words, write_picture
    from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS
    from taxinet_ros.trials.options import read_settings

    values = read_settings(settings or ())
    for key, option in _AXES.items():
        if key in values:
            raise UsageError(f'--set {key}: varies over the sheet; use {option} {values[key]}')
    columns = numbers('--hours', hours) or HOURS
    rains = numbers('--rain', rain) or (0.0,)
    kinds = words(clouds) or (RAIN_CLOUDS if rain else CLOUDS)
    scenes = sheet_scenes(values, columns, kinds, rains)
    path = new_picture(out, 'camera-sheet')
    write_picture(path, lambda: camera_sheet(scenes, path, camera))
    print(f'sheet: {path}')
