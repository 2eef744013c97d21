"""``taxinet camera shadow``: the aircraft's own shadow in the picture, compared with physics."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from taxinet_ros.cli.options import ScenarioOption
from taxinet_ros.errors import UsageError


def shadow(
    hours: Annotated[
        str, typer.Option(help='local hours, e.g. 13,15.5; one line each')
    ] = '12,12.5,13,13.5,14,15,16,17,17.5',
    turbidity: Annotated[
        float, typer.Option(help="Linke turbidity of the clear-sky reference: 3.3 is the place's "
        "in March, 2 very clear, 5 hazy", min=1.5, max=10.0)
    ] = 3.3,
    settings: ScenarioOption = None,
) -> None:
    """Report when the aircraft's own shadow is in the picture, and how dark compared with physics.

    For the first frame of a run under a clear sky, unless changed by --set. Ratios are light on
    shaded over light on sunlit ground: 0 is black, 1 no shadow.
    """
    from taxinet_ros.analysis.camera.shadow import shadow_appearances
    from taxinet_ros.cli.training.pictures import numbers
    from taxinet_ros.core.scenario_fields import clock_words
    from taxinet_ros.trials.options import read_settings

    values = read_settings(settings or ())
    for key, mend in {'time_of_day_h': 'use --hours', 'shadows': 'leave it out'}.items():
        if key in values:
            raise UsageError(f'--set {key}: varies over the table; {mend}')
    columns = numbers('--hours', hours)
    if not columns:
        raise UsageError(f'--hours {hours!r}: expected comma-separated numbers, e.g. 13,15.5')
    print("       sun        sun from  picture    in picture  renderer's  clear day:  its")
    print('time   elevation  the nose  in shadow  rendered    light       luminance   energy')
    for one in shadow_appearances(values, columns, turbidity):
        print(
            f'{clock_words(one.hour)}  {one.elevation_deg:7.1f}°  {one.from_nose_deg:6.0f}°  '
            f'{100 * one.share:8.1f}%  {_ratio(one.rendered)}       {_ratio(one.light)}       '
            f'{_ratio(one.physics)}       {_ratio(one.energy)}'
        )


def _ratio(value: float) -> str:
    return '    -' if math.isnan(value) else f'{value:5.3f}'
