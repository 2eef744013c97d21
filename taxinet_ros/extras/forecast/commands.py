"""``taxinet forecast``: a lower bound on the final robustness of a run in progress."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.cli.checked import check_new_file
from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import CampaignArgument, JsonOption, RunOption
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.cli.show import print_json
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.extras.forecast.forecast import (
    STEP_S,
    Bound,
    Coverage,
    Forecast,
    calibrate,
    coverage,
    outside_of_campaign,
    outside_of_run,
    read_forecast,
    read_forecast_runs,
    write_forecast,
)
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import plain
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign, open_campaign
from taxinet_ros.trials.past_runs.repeated_run import readable_bags
from taxinet_ros.trials.record.facts import is_campaign

NO_GUARANTEE = 'no guarantee'
_HIGH, _LOW = 3.0, -200.0
_LINEAR = 2.0
_TICKS = (-100, -10, -2, -1, 0, 1, 2)
_TEXT = Path(__file__).with_name('show.j2')
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
) -> int:
    """Calibrate a forecast on a campaign's runs.

    Takes the runs that the program itself drew, with their bags; frames are not needed. Every other
    run trains the forecast, the others calibrate it.
    """
    check_new_file(out)
    recorded = open_campaign(campaign)
    with stage_bars(Console(stderr=True)) as bars:
        found = calibrate(
            recorded, spec=spec, every_s=every,
            on_run=lambda done, total: bars('runs', done, total),
        )
    write_forecast(out, found)
    held = found.model.calibration_runs
    _print('calibrated', as_json, {
        'forecast': str(out), 'spec': found.spec, 'training_runs': len(found.model.outcomes),
        'calibration_runs': held, 'moments': found.model.moments,
        'every_s': round(found.every_steps * STEP_S, 9), 'population': dict(found.population),
        'highest_confidence': held / (held + 1),
    })
    return ExitCode.OK


@forecast_app.command('check')
def check_forecast(
    forecast: _ForecastArgument,
    campaign: CampaignArgument,
    confidence: Annotated[
        list[float] | None,
        typer.Option(metavar='SHARE', help='confidence to check; repeatable (default: 0.9, 0.95)'),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Measure on a campaign with another seed how often the bounds hold.

    Exit codes: 0 measured; 3 the campaign differs from the one calibrated on, so that there is no
    guarantee to be checked.
    """
    known, recorded = read_forecast(forecast), open_campaign(campaign)
    confidences = confidence or (0.9, 0.95)
    for one in confidences:
        known.model.margin(one)
    with stage_bars(Console(stderr=True)) as bars:
        runs = read_forecast_runs(
            recorded, known.spec, known.every_steps,
            on_run=lambda done, total: bars('runs', done, total),
        )
    if runs.features.shape[1] != known.model.moments:
        raise UsageError(
            f'{campaign}: its runs take {runs.rows[0].duration_s:g} s, those calibrated on '
            f'{known.last_step * STEP_S:g} s'
        )
    outside = outside_of_campaign(known, recorded, runs)
    chosen, unjudged = runs.left_out
    _print('checked', as_json, {
        'forecast': str(forecast), 'campaign': str(campaign), 'runs': len(runs.rows),
        'failed': int((runs.outcomes <= 0).sum()), 'chosen': chosen,
        'unjudged': unjudged, 'outside': outside,
        'coverage': [_coverage_json(coverage(known, runs, one)) for one in confidences],
    })
    return ExitCode.INCOMPLETE if outside else ExitCode.OK


def _coverage_json(one: Coverage) -> dict[str, Any]:
    return {
        'confidence': one.confidence, 'held': one.held, 'held_if_violated': one.held_if_failed,
        'cleared_s': one.cleared_s, 'wrongly_cleared': one.wrongly_cleared,
    }


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
) -> int:
    """Print and draw the bound on the final robustness of runs, as far as they have come.

    Exit codes: 0; 3 a run is of another program, network or sampler than those calibrated on, so
    that its bound has no guarantee, or that is unknown.
    """
    known = read_forecast(forecast)
    if at is not None and not 0 <= at <= known.last_step * STEP_S + 1e-9:
        raise UsageError(f'--at {at:g}: needs to be within 0..{known.last_step * STEP_S:g} s')
    if plot is not None and (plot.suffix != '.png' or not plot.parent.is_dir() or plot.exists()):
        raise UsageError(f'--plot {plot}: expected a new .png file in an existing folder')
    shown, values = [], []
    for bag in bags:
        with readable_bags():
            recording = _one_run(open_recording(bag), run_id)
            outside = outside_of_run(known, recording, _campaign_of(bag))
            bounds = known.bounds_of(recording, confidence=confidence, until_s=at)
        if not bounds:
            raise UsageError(f'{bag}: has no control step with a robustness yet')
        values.append(_run_json(recording, bounds, confidence, outside))
        final = _final(known, recording)
        title = f'{recording.run_id}: {_ending(final)}' + (f' ({NO_GUARANTEE})' if outside else '')
        shown.append((title, bounds, final))
    if plot is not None:
        picture = forecast_picture(shown, confidence=confidence, spec=known.spec)
        write_atomically(plot, png_bytes(picture, LIGHT))
    # Below any end that it has seen, a bound is an extrapolation that tells nobody anything.
    worst = float(known.model.outcomes.min())
    _print('shown', as_json, values, spec=known.spec, plot=plot, worst=worst)
    return ExitCode.INCOMPLETE if any(one['outside'] for one in values) else ExitCode.OK


def _print(block: str, as_json: bool, values: Any, **more: Any) -> None:
    """Print values as JSON, or by a block of the template ``show.j2``."""
    if as_json:
        print_json(values)
        return
    print(macro_text(_TEXT, block, values=plain(values), **more))


def _one_run(recording: Recording, run_id: str | None) -> Recording:
    if run_id is not None:
        return recording[run_id]
    if len(recording.runs) > 1:
        recording.choose(None)  # raises, with the names of its runs
    return recording


def _campaign_of(bag: Path) -> RecordedCampaign | None:
    """The campaign in whose folder a bag is; it may still be running."""
    whole = bag.resolve()
    run = whole.parent if whole.is_file() else whole
    return open_campaign(run.parent) if is_campaign(run.parent) else None


def _final(forecast: Forecast, recording: Recording) -> float | None:
    facts = recording.facts
    judged = None if facts is None else facts.judged.get(forecast.spec)
    if judged is None or not judged.final or not judged.interval.exact:
        return None
    return judged.interval.lower


def _ending(final: float | None) -> str:
    if final is None:
        return 'in progress'
    return f'{"satisfied" if final > 0 else "violated"}, {rho_text(final)}'


def _run_json(
    recording: Recording, bounds: Sequence[Bound], confidence: float, outside: Sequence[str],
) -> dict[str, Any]:
    return {
        'run_id': recording.run_id, 'confidence': None if outside else confidence,
        'outside': list(outside),
        't_s': bounds[-1].t_s,
        'lower': bounds[-1].lower, 'certain_lower': bounds[-1].certain_lower,
        'certain_upper': bounds[-1].certain_upper,
        'bounds': [
            {'t_s': one.t_s, 'lower': one.lower, 'certain_upper': one.certain_upper}
            for one in bounds
        ],
    }


# Picture ----------------------------------------------------------------------------------------


ShownRun = tuple[str, Sequence[Bound], float | None]
"""Title, bounds at each control step, and final robustness; None if the run has not ended."""


def forecast_picture(runs: Sequence[ShownRun], *, confidence: float, spec: str) -> Picture:
    """The band of each run over time, one panel for each, narrowing to what comes out."""
    percent = f'{100 * confidence:g} %'

    def draw(figure: Figure, theme: Theme) -> None:
        panels = np.asarray(figure.subplots(len(runs), 1, sharex=True, squeeze=False))[:, 0]
        for axes, run in zip(panels, runs, strict=True):
            _draw(axes, theme, run, percent)
            axes.set_ylabel(f'robustness of\n{spec}')
        panels[-1].set_xlabel('time [s]')
        panels[0].legend(loc='upper right', fontsize=8)

    return Picture(
        name='forecast', title=f'Final robustness, forecast during the run ({percent})', draw=draw,
        size_in=(8.5, 0.6 + 3.0 * len(runs)),
        caption='The band reaches from the conformal lower bound, which holds at all moments of '
                f"the run with a probability of {percent}, to the upper end of the monitor's "
                'interval, which is certain.',
    )


def _draw(axes: Axes, theme: Theme, run: ShownRun, percent: str) -> None:
    title, bounds, final = run
    t_s = [bound.t_s for bound in bounds]
    low, high = (
        np.clip([getattr(bound, name) for bound in bounds], 10 * _LOW, 10 * _HIGH)
        for name in ('lower', 'certain_upper')
    )
    colour = (
        theme.others[0] if final is None else theme.failed if final <= 0 else theme.passed
    )
    axes.fill_between(t_s, low, high, color=colour, alpha=0.25, linewidth=0, step='post')
    axes.step(t_s, low, where='post', color=colour, linewidth=1.8,
              label=f'lower bound, {percent} for the whole run')
    axes.step(t_s, high, where='post', color=theme.ink, linewidth=0.9, alpha=0.6,
              label='monitor: cannot end above')
    if final is not None and math.isfinite(final):
        axes.axhline(final, color=theme.ink, linestyle=':', linewidth=1.3,
                     label='how it ended')
    axes.axhline(0.0, color=theme.ink, linewidth=0.8)
    # Failures may be a hundred times deeper than passes are high.
    axes.set_yscale('symlog', linthresh=_LINEAR)
    axes.set_yticks(_TICKS, [f'{tick:g}' for tick in _TICKS])
    axes.set_yticks([], minor=True)
    axes.set_ylim(_LOW, _HIGH)
    axes.margins(x=0.01)
    axes.set_title(title, fontsize=10)
