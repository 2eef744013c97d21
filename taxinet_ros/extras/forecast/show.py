"""``taxinet forecast``: a lower bound on the final robustness of a run in progress."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.cli.show import print_json
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


def calibrate_forecast(
    folder: Path, out: Path, *, spec: str | None, every_s: float, as_json: bool
) -> int:
    """Calibrate on a campaign and write the forecast; returns exit code 0."""
    if out.exists():
        raise UsageError(f'--out {out}: already exists; name a new file')
    if not out.parent.is_dir():
        raise UsageError(f'--out {out}: no such folder: {out.parent}')
    campaign = open_campaign(folder)
    with stage_bars(Console(stderr=True)) as bars:
        found = calibrate(
            campaign, spec=spec, every_s=every_s,
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


def check_forecast(
    path: Path, folder: Path, *, confidences: Sequence[float], as_json: bool
) -> int:
    """Measure the coverage on another campaign.

    Returns:
        Exit code: 0; 3 if the campaign is outside the guarantee, so that it tells nothing of it.
    """
    forecast, campaign = read_forecast(path), open_campaign(folder)
    for confidence in confidences:
        forecast.model.margin(confidence)
    with stage_bars(Console(stderr=True)) as bars:
        runs = read_forecast_runs(
            campaign, forecast.spec, forecast.every_steps,
            on_run=lambda done, total: bars('runs', done, total),
        )
    if runs.features.shape[1] != forecast.model.moments:
        raise UsageError(
            f'{folder}: its runs take {runs.rows[0].duration_s:g} s, those calibrated on '
            f'{forecast.last_step * STEP_S:g} s'
        )
    outside = outside_of_campaign(forecast, campaign, runs)
    chosen, unjudged = runs.left_out
    _print('checked', as_json, {
        'forecast': str(path), 'campaign': str(folder), 'runs': len(runs.rows),
        'failed': sum(row.outcome == 'FAIL' for row in runs.rows), 'chosen': chosen,
        'unjudged': unjudged, 'outside': outside,
        'coverage': [
            _coverage_json(coverage(forecast, runs, confidence)) for confidence in confidences
        ],
    })
    return ExitCode.INCOMPLETE if outside else ExitCode.OK


def _coverage_json(one: Coverage) -> dict[str, Any]:
    return {
        'confidence': one.confidence, 'held': one.held, 'held_if_violated': one.held_if_failed,
        'cleared_s': one.cleared_s, 'wrongly_cleared': one.wrongly_cleared,
    }


def show_forecast(
    path: Path, bags: Sequence[Path], *, at_s: float | None, confidence: float,
    run_id: str | None, plot: Path | None, as_json: bool,
) -> int:
    """Print the latest bound of each run, and draw all of them.

    Returns:
        Exit code: 0; 3 if a run is outside the guarantee.
    """
    forecast = read_forecast(path)
    if at_s is not None and not 0 <= at_s <= forecast.last_step * STEP_S + 1e-9:
        raise UsageError(
            f'--at {at_s:g}: needs to be within 0..{forecast.last_step * STEP_S:g} s'
        )
    if plot is not None and (plot.suffix != '.png' or not plot.parent.is_dir() or plot.exists()):
        raise UsageError(f'--plot {plot}: expected a new .png file in an existing folder')
    shown, values = [], []
    for bag in bags:
        with readable_bags():
            recording = _one_run(open_recording(bag), run_id)
            outside = outside_of_run(forecast, recording, _campaign_of(bag))
            bounds = forecast.bounds_of(recording, confidence=confidence, until_s=at_s)
        if not bounds:
            raise UsageError(f'{bag}: has no control step with a robustness yet')
        values.append(_run_json(recording, bounds, confidence, outside))
        final = _final(forecast, recording)
        shown.append(ShownRun(
            title=f'{recording.run_id}: {_ending(final)}'
                  + (f' ({NO_GUARANTEE})' if outside else ''),
            bounds=bounds, final=final,
        ))
    if plot is not None:
        picture = forecast_picture(shown, confidence=confidence, spec=forecast.spec)
        write_atomically(plot, png_bytes(picture, LIGHT))
    # Below any end that it has seen, a bound is an extrapolation that tells nobody anything.
    worst = float(forecast.model.outcomes.min())
    _print('shown', as_json, values, spec=forecast.spec, plot=plot, worst=worst)
    return ExitCode.INCOMPLETE if any(one['outside'] for one in values) else ExitCode.OK


def _print(block: str, as_json: bool, values: Any, **more: Any) -> None:
    """Print values as JSON, or by a block of the template ``show.j2``."""
    if as_json:
        print_json(values)
        return
    print(macro_text(Path(__file__).with_suffix('.j2'), block, values=plain(values), **more))


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
    return f'{"satisfied" if final > 0 else "violated"}, {final:+.2f}'


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


@dataclass(frozen=True, kw_only=True)
class ShownRun:
    """One run.

    Attributes:
        title: above its panel.
        bounds: bounds at each control step.
        final: final robustness; None if the run has not ended.
    """

    title: str
    bounds: Sequence[Bound]
    final: float | None


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
    t_s = [bound.t_s for bound in run.bounds]
    low, high = (
        np.clip([getattr(bound, name) for bound in run.bounds], 10 * _LOW, 10 * _HIGH)
        for name in ('lower', 'certain_upper')
    )
    colour = (
        theme.others[0] if run.final is None else theme.failed if run.final <= 0 else theme.passed
    )
    axes.fill_between(t_s, low, high, color=colour, alpha=0.25, linewidth=0, step='post')
    axes.step(t_s, low, where='post', color=colour, linewidth=1.8,
              label=f'lower bound, {percent} for the whole run')
    axes.step(t_s, high, where='post', color=theme.ink, linewidth=0.9, alpha=0.6,
              label='monitor: cannot end above')
    if run.final is not None and math.isfinite(run.final):
        axes.axhline(run.final, color=theme.ink, linestyle=':', linewidth=1.3,
                     label='how it ended')
    axes.axhline(0.0, color=theme.ink, linewidth=0.8)
    # Failures may be a hundred times deeper than passes are high.
    axes.set_yscale('symlog', linthresh=_LINEAR)
    axes.set_yticks(_TICKS, [f'{tick:g}' for tick in _TICKS])
    axes.set_yticks([], minor=True)
    axes.set_ylim(_LOW, _HIGH)
    axes.margins(x=0.01)
    axes.set_title(run.title, fontsize=10)
