"""The lines that shrinking a failed run prints: what is shrunk, and which parameters matter."""

from __future__ import annotations

import shlex
from typing import Any

from rich.table import Table
from rich.text import Text

from taxinet_ros.campaign.lines import scene_words, who_takes_part
from taxinet_ros.campaign.options import DEFAULT_SPECS
from taxinet_ros.campaign.shrink import End
from taxinet_ros.campaign.shrink_options import ShrinkOptions
from taxinet_ros.campaign.shrink_report import Finding, Report
from taxinet_ros.core.controller import controller_options
from taxinet_ros.core.mtl import parse_spec

_UNITS = {
    'cross_track': '{:+.1f} m', 'distance': '{:.0f} m', 'heading': '{:+.1f} deg',
    'rain': '{:.0f} %',
}
_MATTERS = {True: Text('matters', style='bold red'), False: Text('does not matter', style='dim')}


def shrink_heading(options: ShrinkOptions) -> str:
    """What is about to be done."""
    campaign, run = options.campaign, options.run
    workers = '1 worker' if options.workers == 1 else f'{options.workers} workers'
    verb = 'resuming to shrink' if options.resume else 'shrinking'
    rho = f', rho {run.rho[options.headline]:+.2f}' if options.headline in run.rho else ''
    return (
        f'{verb} {run.run_id} ({options.headline}{rho}), {who_takes_part(campaign)}, '
        f'{workers} -> {campaign.out}'
    )


def parameter_table(report: Report) -> Table:
    """Every parameter with its three values, and whether it matters."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column('parameter', no_wrap=True)
    for name in ('original', 'nominal', 'shrunk', 'rho in\noriginal', 'rho in\nshrunk'):
        table.add_column(name, justify='right', no_wrap=True)
    table.add_column('verdict', no_wrap=True)
    for one in report.findings:
        verdict = _MATTERS[one.matters]
        if one.original == one.nominal:
            verdict = Text('nominal already', style='dim')
        table.add_row(
            one.key, *(value_words(one.key, value) for value in (
                one.original, one.nominal, one.shrunk)),
            _rho(one.rho_in_original), _rho(one.rho_in_shrunk), verdict,
        )
    return table


def finding_lines(report: Report) -> list[str]:
    """How the table is to be read, and where the failure begins."""
    lines = ['rho in original, in shrunk: of that run with this one parameter made nominal']
    if report.dry:
        lines[0] += ' (a clear sky is dry too)'
    for one in report.findings:
        if one.matters and one.passes_at is not None and one.rho_passes_at is not None:
            lines.append(f'{one.key}: {edge_words(one)}')
        if one.matters and one.rho_in_original is not None and one.rho_in_original <= 0:
            lines.append(f'{one.key}: the original fails without it too, so it has another cause')
    return lines


def edge_words(one: Finding) -> str:
    """Where along one parameter the failure begins, all others as in the shrunk run."""
    fails, passes = value_words(one.key, one.shrunk), value_words(one.key, one.passes_at)
    return f'{fails} fails, {passes} passes (rho {one.rho_passes_at:+.2f})'


def off_nominal(report: Report) -> str:
    """The shrunk scenario in a few words: what in it is not nominal."""
    words = [
        f'{one.key} {value_words(one.key, one.shrunk)}' for one in report.findings if one.matters
    ]
    return ', '.join(words) or 'everything nominal'


def result_lines(report: Report, options: ShrinkOptions, runs: int, wall_s: float) -> list[str]:
    """How it ended and what it took."""
    lines = [_ended(report)] if report.state.end is not End.MINIMAL else []
    if report.shrunk is not None:
        rho = report.shrunk.rho[options.headline]
        lines.append(
            f'shrunk: run {report.shrunk.index}, rho {rho:+.2f}: {scene_words(report.shrunk)}'
        )
    ahead = runs - report.state.asked
    guesses = f' ({ahead} of them ahead on a guess)' if ahead > 0 else ''
    took = ' in all' if options.resume else f' in {wall_s:.0f} s'
    lines.append(f'{runs} runs{guesses}{took}')
    return lines


def run_command(options: ShrinkOptions, program: str) -> str:
    """What to type to run the shrunk scenario."""
    campaign = options.campaign
    words = ['taxinet', 'run', program, '--perception', campaign.perception]
    words += controller_options(campaign.controller)
    specs = [parse_spec(text) for text in campaign.specs]
    if specs != [parse_spec(text) for text in DEFAULT_SPECS]:
        words += [word for text in campaign.specs for word in ('--spec', text)]
    words += [word for name, value in campaign.gains.items()
              for word in ('--set', f'steering.{name}={value!r}')]
    return shlex.join([*words, *campaign.timing.options])


def value_words(key: str, value: Any) -> str:
    """A value as people say it."""
    if key == 'time_of_day':
        hours, minutes = divmod(round(value * 60), 60)
        return f'{hours:02d}:{minutes:02d}'
    if isinstance(value, bool):
        return 'on' if value else 'off'
    if key not in _UNITS:
        return str(value)
    words = _UNITS[key].format(value)
    return words.removeprefix('+') if value == 0 else words


def _rho(value: float | None) -> str:
    return '' if value is None else f'{value:+.2f}'


def _ended(report: Report) -> str:
    if report.state.end is End.NOMINAL_FAILS:
        return 'the nominal scenario fails itself, so no parameter matters; see --nominal'
    if report.state.end is End.SPENT:
        return 'ended before it was minimal: --runs are spent; --resume with more goes on'
    return 'ended before it was minimal; --resume goes on'
