"""``taxinet mine``: the tightest parameters of a formula that hold for a share of the runs."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import UsageError


def mine(
    formula: Annotated[
        str,
        typer.Argument(
            metavar='FORMULA',
            help='with one or two parameters, named by capital letters: '
            "'always[T:30](abs(cte) <= A)'",
        ),
    ],
    campaign: Annotated[Path, typer.Argument(metavar='CAMPAIGN', help='folder with its bags')],
    share: Annotated[
        float, typer.Option(help='share of the runs for which the formula has to hold')
    ] = 0.95,
    points: Annotated[
        int, typer.Option(min=2, max=1000, help='of two parameters: values of the time')
    ] = 13,
    as_json: JsonOption = False,
) -> None:
    """Find the tightest parameters with which a formula holds for a share of the runs.

    The runs are those that the program itself drew; the 95 % intervals assume nothing about the
    distribution of their values. Of two parameters, one of them a time, it is the front.
    """
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.core.mtl.mine import parse_template
    from taxinet_ros.files.plain_values import plain
    from taxinet_ros.trials.past_runs.mining import mine, order, program_traces, step_ns
    from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign

    if not 0 < share < 1:
        raise UsageError(f'--share {share:g}: needs to be between 0 and 1')
    recorded = open_campaign(campaign)
    template = parse_template(formula, step_ns(recorded))
    target, other = order(template)
    console = line_console(stderr=as_json)
    with stage_bars(console) as show:
        traces, anytime = program_traces(
            recorded, template, lambda done, total: show('reading', done, total)
        )
    found = list(mine(template, traces, share, anytime=anytime, points=points))
    if as_json:
        print_json(plain({
            'formula': formula, 'share': share, 'runs': len(traces), 'anytime': anytime,
            'parameter': target.name, 'rho_rises': target.rises,
            'other': None if other is None else other.name,
            # Which infinity it is says whether no value holds or every one.
            'values': [{name: str(end) if end in (math.inf, -math.inf) else end
                        for name, end in asdict(one).items()} for one in found],
        }))
        return

    def words(value: float) -> str:
        if math.isinf(value):
            return 'not known'
        # Rounded to the looser side, so that it holds as it is printed.
        rounded = math.ceil if target.rises else math.floor
        return f'{value:g} s' if target.mark_ns else f'{rounded(value * 1e4) / 1e4:g}'

    always = ', valid whenever a search stops' if anytime else ''
    console.print(
        f'{formula}: the {"least" if target.rises else "greatest"} {target.name} that holds for '
        f'{100 * share:g} % of the runs, from {len(traces):,} that the program itself drew; in '
        f'brackets 95 % intervals{always}'
    )
    for one in found:
        given = '' if other is None else f'{other.name} = {one.other:g} s: '
        value = words(one.value)
        if math.isinf(one.value):
            value = f'{"no" if (one.value > 0) == target.rises else "every"} value holds'
        low, high = (one.tighter, one.looser) if target.rises else (one.looser, one.tighter)
        ends = f'[{words(low)}, {words(high)}]'
        console.print(f'{given}{target.name} = {value}  {ends}')
