"""``taxinet forecast``: a lower bound on the final robustness of a run in progress."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.campaign.past_runs.recorded_campaign import RecordedCampaign, open_campaign
from taxinet_ros.campaign.rates import Rate
from taxinet_ros.campaign.record.facts import is_campaign
from taxinet_ros.cli.bag.input import readable_bags
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.extras.forecast.conformal import Guarantee
from taxinet_ros.extras.forecast.forecast import (
    STEP_S,
    Bound,
    Coverage,
    Forecast,
    calibrate,
    coverage,
    outside_of_campaign,
    outside_of_run,
    parse_guarantee,
    read_forecast,
    read_forecast_runs,
    write_forecast,
)
from taxinet_ros.extras.forecast.picture import ShownRun, forecast_picture
from taxinet_ros.files.atomic import write_atomically

_PAGE_WIDTH = 100
NO_GUARANTEE = 'no guarantee'


def calibrate_forecast(
    folder: Path, out: Path, *, spec: str | None, every_s: float, as_json: bool
) -> int:
    """Calibrate on a campaign and write the forecast.

    Returns:
        Exit code 0.

    Raises:
        UsageError: the campaign cannot calibrate one, or ``out`` exists.
    """
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
    trained, held = len(found.model.outcomes), found.model.calibration_runs
    told = {
        'forecast': str(out), 'spec': found.spec, 'training_runs': trained,
        'calibration_runs': held, 'moments': found.model.moments,
        'every_s': round(found.every_steps * STEP_S, 9), 'population': dict(found.population),
        'highest_confidence': held / (held + 1),
    }
    if as_json:
        print(json.dumps(told, indent=2))
        return ExitCode.OK
    console = _console()
    console.print(
        f'{out}: forecast of {found.spec}, {trained} runs trained and {held} calibrated; a bound '
        f'every {told["every_s"]:g} s, up to {100 * held / (held + 1):.2f} % confidence',
        soft_wrap=True,
    )
    console.print('it holds for new runs with the same', soft_wrap=True)
    for name, text in found.population.items():
        console.print(f'  {name:<13}{text}', soft_wrap=True)
    console.print('  drawn by the program itself (--sampler random)', soft_wrap=True)
    return ExitCode.OK


def check_forecast(
    path: Path, folder: Path, *, confidences: Sequence[float], as_json: bool
) -> int:
    """Measure the coverage on another campaign.

    Returns:
        Exit code: 0; 3 if the campaign is outside the guarantee, so that it tells nothing of it.

    Raises:
        UsageError: no forecast, or a campaign that cannot be compared.
    """
    forecast, campaign = read_forecast(path), open_campaign(folder)
    for confidence in confidences:
        forecast.model.margin(confidence, Guarantee.RUN)
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
    found = [
        coverage(forecast, runs, confidence, guarantee)
        for confidence in confidences for guarantee in (Guarantee.STEP, Guarantee.RUN)
    ]
    failed = sum(row.outcome == 'FAIL' for row in runs.rows)
    if as_json:
        print(json.dumps({
            'forecast': str(path), 'campaign': str(folder), 'runs': len(runs.rows),
            'failed': failed, 'outside': outside,
            'coverage': [_coverage_json(one) for one in found],
        }, indent=2))
    else:
        console = _console()
        console.print(f'{folder}: {len(runs.rows)} runs, {failed} violated', soft_wrap=True)
        chosen, unjudged = runs.left_out
        if chosen or unjudged:
            console.print(
                f'left out: {chosen} chosen by a sampler, {unjudged} without a verdict',
                soft_wrap=True,
            )
        console.print(_coverage_table(found))
        console.print(
            'one moment: mean of all moments, and its worst; whole run: every bound of a run '
            'holds. In brackets the 95 % interval of this share; the guarantee is over '
            'calibrations too. cleared: median time at which a run that passes has a bound above '
            '0; wrongly: violated runs that ever had', style='dim', soft_wrap=True,
        )
        _print_outside(console, outside)
    return ExitCode.INCOMPLETE if outside else ExitCode.OK


def _coverage_table(found: Sequence[Coverage]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column('guarantee', no_wrap=True)
    for heading in ('promised', 'held', 'worst moment', 'if violated', 'cleared', 'wrongly'):
        table.add_column(heading, justify='right', no_wrap=True)
    for one in found:
        whole = one.guarantee is Guarantee.RUN
        table.add_row(
            'whole run' if whole else 'one moment', f'{100 * one.confidence:g} %',
            _rate(one.held) if whole else f'{100 * one.held.rate:.1f} %',
            '' if one.worst is None else f'{one.worst[0]:g} s: {_rate(one.worst[1])}',
            _share(one.held_if_failed),
            'never' if one.cleared_s is None else f'{one.cleared_s:g} s',
            _share(one.wrongly_cleared),
        )
    return table


def _rate(one: Rate) -> str:
    return f'{100 * one.rate:.1f} % [{100 * one.low:.0f}, {100 * one.high:.0f}]'


def _share(one: Rate) -> str:
    return '' if math.isnan(one.rate) else f'{100 * one.rate:.1f} %'


def _coverage_json(one: Coverage) -> dict[str, Any]:
    def plain(found: Rate) -> dict[str, float | None]:
        return {
            name: None if math.isnan(value) else value for name, value in found._asdict().items()
        }

    return {
        'guarantee': one.guarantee.value, 'confidence': one.confidence, 'held': plain(one.held),
        'worst_moment_s': one.worst and one.worst[0], 'worst': one.worst and plain(one.worst[1]),
        'held_if_violated': plain(one.held_if_failed), 'cleared_s': one.cleared_s,
        'wrongly_cleared': plain(one.wrongly_cleared),
    }


def show_forecast(
    path: Path, bags: Sequence[Path], *, at_s: float | None, confidence: float, guarantee: str,
    run_id: str | None, plot: Path | None, as_json: bool,
) -> int:
    """Print the latest bound of each run, and draw all of them.

    Args:
        path: the forecast.
        bags: runs.
        at_s: only the run up to here [s]; None: all there is.
        confidence: of the bounds.
        guarantee: ``run`` or ``step``.
        run_id: which run, if a bag holds several.
        plot: picture to write, or None.
        as_json: print JSON.

    Returns:
        Exit code: 0; 3 if a run is outside the guarantee.

    Raises:
        UsageError: no forecast, or a run that it cannot be applied to.
    """
    asked = parse_guarantee(guarantee)
    forecast = read_forecast(path)
    if at_s is not None and not 0 <= at_s <= forecast.last_step * STEP_S + 1e-9:
        raise UsageError(
            f'--at {at_s:g}: needs to be within 0..{forecast.last_step * STEP_S:g} s'
        )
    if plot is not None and (plot.suffix != '.png' or not plot.parent.is_dir() or plot.exists()):
        raise UsageError(f'--plot {plot}: expected a new .png file in an existing folder')
    console = _console()
    shown, told, inside = [], [], True
    for bag in bags:
        with readable_bags():
            recording = _one_run(open_recording(bag), run_id)
            outside = outside_of_run(forecast, recording, _campaign_of(bag))
            bounds = {
                one: forecast.bounds_of(
                    recording, confidence=confidence, guarantee=one,
                    until_s=at_s,
                ) for one in Guarantee
            }
        if not bounds[asked]:
            raise UsageError(f'{bag}: has no control step with a robustness yet')
        inside = inside and not outside
        told.append(_run_json(recording, bounds[asked], asked, confidence, outside))
        final = _final(forecast, recording)
        shown.append(ShownRun(
            title=f'{recording.run_id}: {_ending(final)}'
                  + (f' ({NO_GUARANTEE})' if outside else ''),
            of_run=bounds[Guarantee.RUN], of_step=bounds[Guarantee.STEP], final=final,
        ))
        if not as_json:
            _print_run(console, forecast, told[-1], confidence, asked)
            _print_outside(console, outside)
    if as_json:
        print(json.dumps(told, indent=2, allow_nan=False))
    if plot is not None:
        picture = forecast_picture(shown, confidence=confidence, spec=forecast.spec)
        write_atomically(plot, png_bytes(picture, LIGHT))
        if not as_json:
            console.print(f'picture: {plot}', soft_wrap=True)
    return ExitCode.OK if inside else ExitCode.INCOMPLETE


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
    recording: Recording, bounds: Sequence[Bound], guarantee: Guarantee, confidence: float,
    outside: Sequence[str],
) -> dict[str, Any]:
    def plain(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        'run_id': recording.run_id, 'guarantee': None if outside else guarantee.value,
        'confidence': None if outside else confidence, 'outside': list(outside),
        't_s': bounds[-1].t_s,
        'lower': plain(bounds[-1].lower), 'certain_lower': plain(bounds[-1].certain_lower),
        'certain_upper': plain(bounds[-1].certain_upper),
        'bounds': [
            {'t_s': one.t_s, 'lower': plain(one.lower), 'certain_upper': plain(one.certain_upper)}
            for one in bounds
        ],
    }


def _print_run(
    console: Console, forecast: Forecast, told: dict[str, Any], confidence: float,
    guarantee: Guarantee,
) -> None:
    lower, upper = told['lower'], told['certain_upper']
    if upper is not None and told['certain_lower'] == upper:
        console.print(
            f'{told["run_id"]}: at {told["t_s"]:g} s, {forecast.spec} is {upper:+.3f} for certain',
            soft_wrap=True,
        )
        return
    least = 'no lower bound' if lower is None else f'at least {lower:+.3f}'
    most = '' if upper is None else f', at most {upper:+.3f} for certain'
    kind = 'at all moments of the run' if guarantee is Guarantee.RUN else 'at this moment alone'
    sure = NO_GUARANTEE if told['outside'] else f'{100 * confidence:g} %, {kind}'
    console.print(
        f'{told["run_id"]}: at {told["t_s"]:g} s, {forecast.spec} will be {least} ({sure}){most}',
        soft_wrap=True,
    )


def _print_outside(console: Console, outside: Sequence[str]) -> None:
    for why in outside:
        console.print(f'{NO_GUARANTEE}: {why}', soft_wrap=True)


def _console() -> Console:
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = _PAGE_WIDTH
    return console
