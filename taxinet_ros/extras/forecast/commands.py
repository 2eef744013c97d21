"""``taxinet forecast``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import CampaignArgument, JsonOption, RunOption

forecast_app = command_group('Lower bounds on the final robustness of runs in progress.')
_ForecastArgument = Annotated[
    Path, typer.Argument(metavar='FORECAST', help='file made by taxinet forecast calibrate')
]


@forecast_app.command('calibrate')
def calibrate_forecast(
    campaign: CampaignArgument,
    out: Annotated[
        Path,
        typer.Option(
            metavar='FILE.json', writable=True, dir_okay=False, help='file to write; must be new'
        ),
    ],
    spec: Annotated[
        str | None,
        typer.Option(metavar='NAME', help='requirement to forecast (default: the headline)'),
    ] = None,
    every: Annotated[float, typer.Option(metavar='SECONDS', help='time between bounds')] = 1.0,
    as_json: JsonOption = False,
) -> None:
    """Calibrate a forecast on a campaign's runs.

    Takes the runs that the program itself drew, with their bags; frames are not needed. Every other
    run trains the forecast, the others calibrate it.
    """
    from taxinet_ros.extras.forecast.show import calibrate_forecast

    raise typer.Exit(
        calibrate_forecast(campaign, out, spec=spec, every_s=every, as_json=as_json)
    )


@forecast_app.command('check')
def check_forecast(
    forecast: _ForecastArgument,
    campaign: CampaignArgument,
    confidence: Annotated[
        list[float] | None,
        typer.Option(metavar='SHARE', help='confidence to check; repeatable (default: 0.9, 0.95)'),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure on a campaign with another seed how often the bounds hold.

    Exit codes: 0 measured; 3 the campaign differs from the one calibrated on, so that there is no
    guarantee to be checked.
    """
    from taxinet_ros.extras.forecast.show import check_forecast

    raise typer.Exit(check_forecast(
        forecast, campaign, confidences=confidence or (0.9, 0.95), as_json=as_json
    ))


@forecast_app.command('show')
def show_forecast(
    forecast: _ForecastArgument,
    bags: Annotated[
        list[Path],
        typer.Argument(metavar='BAG...', help='folders or .mcap files of runs, also unfinished'),
    ],
    at: Annotated[
        float | None,
        typer.Option(metavar='SECONDS', help='only the run up to here (default: all there is)'),
    ] = None,
    confidence: Annotated[
        float, typer.Option(metavar='SHARE', help='that all bounds of a run hold')
    ] = 0.9,
    run_id: RunOption = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE.png', writable=True, dir_okay=False, help='picture of the bounds over '
            'time'
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Print and draw the bound on the final robustness of runs, as far as they have come.

    Exit codes: 0; 3 a run is of another program, network or sampler than those calibrated on, so
    that its bound has no guarantee, or that is unknown.
    """
    from taxinet_ros.extras.forecast.show import show_forecast

    raise typer.Exit(show_forecast(
        forecast, bags, at_s=at, confidence=confidence, run_id=run_id, plot=plot, as_json=as_json,
    ))
