"""Scenes through our camera: one picture of one scene, or a sheet of hours and kinds of weather."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from taxinet_ros.analysis.contact_sheet import Picture, grid_sheet
from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera import Camera
from taxinet_ros.core.scenario import Scenario, scenario_from_human

HOURS = (6.0, 6.5, 7.0, 9.0, 12.0, 14.0, 15.5, 17.0, 17.5)
"""Local hours of a sheet where none are named: dawn and dusk closer together than the day."""

POSE = {'cross_track': 1.0, 'heading': 4.0, 'distance': 900.0}
"""Pose of a sheet where none is named: centreline, both edges and, after noon, our own shadow."""


def scene_picture(scene: Scenario) -> Picture:
    """The first camera frame of a run of ``scene``, (200, 360, 3) uint8 RGB."""
    return Camera(scene).render(Aircraft(scene).state, 0)


def sheet_scenes(
    settings: Mapping[str, object], hours: Sequence[float], clouds: Sequence[str],
    rains: Sequence[float],
) -> list[list[Scenario]]:
    """Scenes of one pose: a row per weather, in it a scene per hour.

    Args:
        settings: scenario values that all share, human keys and units; the pose is :data:`POSE`
            where they do not say.
        hours: local hours.
        clouds: cloud kinds.
        rains: rain [%]; a row for each under each kind of cloud.

    Raises:
        UsageError: a value that no scenario may have.
    """
    return [
        [
            scenario_from_human(
                {**POSE, **settings, 'time_of_day': hour, 'clouds': cloud, 'rain': rain}
            )
            for hour in hours
        ]
        for cloud in clouds
        for rain in rains
    ]


def camera_sheet(scenes: Sequence[Sequence[Scenario]], path: Path) -> None:
    """Draw the scenes of :func:`sheet_scenes` as a table of pictures, into a PNG file."""
    first = scenes[0][0]
    state = Aircraft(first).state
    grid_sheet(
        [[Camera(scene).render(state, 0) for scene in row] for row in scenes],
        [_weather(row[0]) for row in scenes],
        [clock(scene.time_of_day_s) for scene in scenes[0]],
        path, title=f'Grant County (KMWH) runway 04, {first.date}, {pose_words(first)}',
    )


def _weather(scene: Scenario) -> str:
    return f'{scene.clouds}\nrain {100 * scene.rain:.0f} %' if scene.rain else scene.clouds


def clock(time_s: float) -> str:
    """Time of day as hours and minutes."""
    hours, minutes = divmod(round(time_s / 60), 60)
    return f'{hours:02d}:{minutes:02d}'


def pose_words(scene: Scenario) -> str:
    """The start pose of a scene in the units people read."""
    human = scene.to_human()
    return (
        f'{human["distance"]:.0f} m past the threshold, CTE {human["cross_track"]:+.1f} m, '
        f'heading {human["heading"]:+.0f}°'
    )
