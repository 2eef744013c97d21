"""``taxinet spec``: requirements looked at without any run."""

from __future__ import annotations

import json
from collections.abc import Iterable

from rich.console import Console

from taxinet_ros.campaign.lines import check_lines
from taxinet_ros.campaign.options import split_settings
from taxinet_ros.campaign.spec_files import read_specs
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.spec_check import check_specs
from taxinet_ros.core.steering import SteeringGains


def show_specs(
    formulas: Iterable[str], *, duration_s: float, settings: Iterable[str], as_json: bool
) -> None:
    """Print how requirements are understood, and what is to be minded.

    Args:
        formulas: requirements as text, or files of them.
        duration_s: length of the runs that they will judge [s].
        settings: gains of the controller, ``steering.<gain>=value``.
        as_json: print one JSON document.

    Raises:
        UsageError: one is none, or no run of this length can be judged by it.
    """
    specs = [parse_spec(text) for text in read_specs(formulas)]
    others, gains = split_settings(settings)
    if others:
        raise UsageError(f'--set {next(iter(others))}: only gains of the controller matter here')
    Scenario(duration_s=duration_s)
    found = check_specs(specs, duration_s, SteeringGains(**gains))
    if as_json:
        print(json.dumps({
            'specs': [
                {'spec': spec.name, 'formula': spec.text, 'understood': line}
                for spec, line in zip(specs, found.lines, strict=True)
            ],
            'warnings': list(found.warnings),
        }, indent=2))
        return
    for line in check_lines(found):
        Console(highlight=False).print(line, soft_wrap=True)
