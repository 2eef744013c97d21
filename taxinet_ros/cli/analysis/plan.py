"""``taxinet plan``: how many runs a claim takes, from the start or after those there are."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console, print_json, print_table
from taxinet_ros.errors import ExitCode, UsageError

_PAGE_WIDTH = 100


def plan(
    campaign: Annotated[
        Path | None,
        typer.Argument(
            metavar='[CAMPAIGN]', help='runs there are already, drawn by the program itself',
            show_default=False,
        ),
    ] = None,
    min_satisfaction: Annotated[
        float | None,
        typer.Option(metavar='SHARE', help='claim: at least this share of runs satisfy'),
    ] = None,
    max_off_runway: Annotated[
        float | None,
        typer.Option(metavar='SHARE', help='claim: at most this share of runs leave the runway'),
    ] = None,
    so_far: Annotated[
        str | None,
        typer.Option(metavar='RUNS:FAILURES', help='runs there are already, instead of CAMPAIGN'),
    ] = None,
    confidence: Annotated[float, typer.Option(help='confidence of the claim')] = 0.95,
    failures: Annotated[
        int | None, typer.Option(help='plan for up to so many failures (default: 0 to 3)')
    ] = None,
    if_true: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='assumed true share, in the words of the claim: gives the chance '
            'of each plan, and a sequential one'
        ),
    ] = None,
    power: Annotated[
        float, typer.Option(metavar='CHANCE', help='with --if-true: wanted chance to pass')
    ] = 0.9,
    as_json: JsonOption = False,
) -> int:
    """Plan how many runs a claim takes, from the start or after those there are.

    Exact binomial numbers for each number of allowed failures, their chance to pass at a true
    share, and the runs of a sequential test. Runs nothing.
    """
    from taxinet_ros.analysis.plan import Claim, parse_so_far, plan_claim, plan_json, plan_lines
    from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
    from taxinet_ros.trials.record.facts import recorded_rules
    from taxinet_ros.trials.sequential import MAX_OFF_RUNWAY, MIN_SATISFACTION

    if (min_satisfaction is None) == (max_off_runway is None):
        raise UsageError('plan: give one claim, --min-satisfaction or --max-off-runway')
    if campaign is not None and so_far is not None:
        raise UsageError('plan: a campaign or --so-far, which stands for one; leave one out')
    threshold = max_off_runway if min_satisfaction is None else min_satisfaction
    assert threshold is not None
    claim = Claim(
        criterion=MAX_OFF_RUNWAY if min_satisfaction is None else MIN_SATISFACTION,
        threshold=threshold, confidence=confidence, failures=failures, if_true=if_true, power=power,
    )
    recorded = None if campaign is None else open_campaign(campaign)
    planned = plan_claim(claim, recorded, None if so_far is None else parse_so_far(so_far))
    if as_json:
        print_json(plan_json(planned))
        return ExitCode.OK
    rules = () if recorded is None else recorded_rules(recorded.facts)
    before, after = plan_lines(planned, rules)
    console = line_console(width=_PAGE_WIDTH)
    console.print(before)
    chance = () if planned.powered is None else ('chance',)
    print_table(
        console, ('off the runway' if claim.off else 'failures', 'runs', *chance), [
            (f'{one.failures:,}', f'{one.runs:,}',
             *(() if one.chance is None else (f'{100 * one.chance:.1f} %',)))
            for one in planned.plans
        ], left=0,
    )
    console.print(after)
    return ExitCode.OK
