"""One scenario as a Scenic program, so that it can be run, looked at and varied like any other."""

from __future__ import annotations

import math
from collections.abc import Mapping

from taxinet_ros.campaign.programs import MODEL
from taxinet_ros.core.scenario import Scenario, scenario_from_human


def scenario_program(scenario: Scenario, about: str, remarks: Mapping[str, str]) -> str:
    """Text of a program whose every scene is ``scenario``.

    Args:
        scenario: what to write down; what is read back is equal but for the last bit of an angle.
        about: heads the text: what it is and where it comes from.
        remarks: comments by key of the scenario.
    """
    values = {**scenario.to_human(), **_exact(scenario)}
    parameters = (
        'time_of_day', 'clouds', 'rain', 'date', 'shadows', 'crossing', 'aircraft', 'duration',
    )
    lines = [f'"""{_quotable(about)}"""', f'model {MODEL}', '']
    lines += [
        f'param {key} = {_written(values[key])}{_comment(remarks, key)}' for key in parameters
    ]
    place = ('cross_track', 'distance', 'heading')
    lines += ['', *(f'# {key} {remarks[key]}' for key in place if key in remarks)]
    right, along = _written(0 - values['cross_track']), _written(values['distance'])
    lines.append(
        f'ego = new Plane at ({right}, {along}), facing {_written(values["heading"])} deg'
    )
    return '\n'.join(lines) + '\n'


def _exact(scenario: Scenario) -> dict[str, float]:
    """Numbers that rounding for people would change."""
    read = scenario_from_human(scenario.to_human())
    exact = {
        'cross_track': (scenario.cross_track_m, read.cross_track_m, 1.0),
        'distance': (scenario.distance_m, read.distance_m, 1.0),
        'heading': (scenario.heading_rad, read.heading_rad, math.pi / 180),
        'rain': (scenario.rain, read.rain, 0.01),
        'time_of_day': (scenario.time_of_day_s, read.time_of_day_s, 3600.0),
        'duration': (scenario.duration_s, read.duration_s, 1.0),
    }
    return {key: value / unit for key, (value, back, unit) in exact.items() if value != back}


def _written(value: float | str | bool) -> str:
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return repr(value)


def _comment(remarks: Mapping[str, str], key: str) -> str:
    return f'  # {remarks[key]}' if key in remarks else ''


def _quotable(text: str) -> str:
    return text.strip().replace('\\', '\\\\').replace('"""', "'''") + '\n'
