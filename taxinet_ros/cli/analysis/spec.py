"""``taxinet spec``: how requirements are parsed."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import typer

from taxinet_ros.cli.completion import complete_gain, complete_spec
from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import UsageError


def spec(
    formulas: Annotated[
        list[str],
        typer.Argument(
            metavar='FORMULA...',
            help='phi_eventually, usable, NAME=FORMULA, a formula, or a YAML file of them',
            autocompletion=complete_spec,
        ),
    ],
    duration: Annotated[float, typer.Option(help='length of the runs to be judged [s]')] = 30,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set', metavar='steering.GAIN=VALUE', help='a controller gain, or control_rate_hz',
            autocompletion=complete_gain,
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show how requirements are parsed, and warn of likely mistakes.

    Runs nothing. Exit codes: 0 valid, with or without warnings; 2 invalid.
    """
    from taxinet_ros.core.motion.controller import SteeringGains
    from taxinet_ros.core.mtl import parse_spec
    from taxinet_ros.core.scenario import scenario_from_human
    from taxinet_ros.core.scenario_fields import CONTROL_RATE
    from taxinet_ros.core.verdict.judge import check_specs
    from taxinet_ros.trials.options import split_settings
    from taxinet_ros.trials.requirements import read_specs
    from taxinet_ros.trials.summary import requirement_lines

    specs = [parse_spec(text) for text in read_specs(formulas)]
    others, gains = split_settings(settings or ())
    for key in (key for key in others if key != CONTROL_RATE.key):
        raise UsageError(f'--set {key}: only controller gains and control_rate_hz apply here')
    scenario = scenario_from_human({'duration_s': duration, **others})
    found = check_specs(specs, scenario, SteeringGains(**gains))
    lines = tuple(map('; '.join, zip(found.lines, found.reaches, strict=True)))
    if as_json:
        print_json({
            'specs': [
                {'spec': spec.name, 'formula': spec.text, 'understood': line}
                for spec, line in zip(specs, lines, strict=True)
            ],
            'warnings': found.warnings,
        })
        return
    for line in requirement_lines(dataclasses.replace(found, lines=lines)):
        line_console().print(line)
