"""``taxinet plan``: how many runs a claim takes, from the start or after those there are."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.analysis.plan import Claim, Further, Planned

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
    from taxinet_ros.analysis.plan import Claim, parse_so_far, plan_claim
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
        print(json.dumps(_json(planned), indent=2, allow_nan=False))
        return ExitCode.OK
    console = line_console()
    if not console.is_terminal:
        console.width = _PAGE_WIDTH
    _print(console, planned)
    if planned.found is not None:
        rules = () if recorded is None else recorded_rules(recorded.facts)
        _print_further(console, planned, rules)
    return ExitCode.OK


def _print(console: Console, planned: Planned) -> None:
    claim = planned.claim
    what = 'leave the runway in at most' if claim.off else 'satisfy in at least'
    console.print(
        f'claim: runs {what} {_percent(claim.threshold)}, with {100 * claim.confidence:g} % '
        'confidence',
    )
    bad = 'off the runway' if claim.off else 'failures'
    table = Table(box=None, pad_edge=False)
    for heading in (bad, 'runs'):
        table.add_column(heading, justify='right', no_wrap=True)
    if claim.if_true is not None:
        table.add_column('chance', justify='right', no_wrap=True)
    plans = {(plan.runs, plan.failures): plan for plan in planned.fixed}
    if planned.powered is not None:
        plans[planned.powered.runs, planned.powered.failures] = planned.powered
    for _, plan in sorted(plans.items()):
        chance = () if plan.chance is None else (_chance(plan.chance),)
        table.add_row(f'{plan.failures:,}', f'{plan.runs:,}', *chance)
    console.print(table, soft_wrap=False)
    if claim.if_true is not None:
        assert planned.powered is not None
        console.print(
            f'chance: that no more fail, if the true share is {_percent(claim.if_true)}; '
            f'{100 * claim.power:g} % takes {planned.powered.runs:,} runs, of which '
            f'{planned.powered.failures:,} may fail',
        )
    console.print(
        'if you look once, at a number of runs fixed beforehand, drawn by the program itself '
        f'(--sampler random): {_gate(claim)} --planned',
    )
    console.print(
        f'if you may look again: {planned.any_look:,} runs of a new campaign, a number fixed '
        f'beforehand, without a failure: {_gate(claim)}',
    )
    if planned.sequential is not None:
        one = planned.sequential
        console.print(
            f'sequential: taxinet falsify --sampler random --until {one.test} takes '
            f'{one.at_truth.mean_runs:,.0f} runs on average (passes {_chance(one.at_truth.passes)} '
            f'within {one.most:,}); {one.at_limit.mean_runs:,.0f} at the limit, where it passes '
            f'{_chance(one.at_limit.passes)}',
        )


def _print_further(
    console: Console, planned: Planned, rules: tuple[str, ...]
) -> None:
    from taxinet_ros.analysis.gate import further_runs, further_words
    from taxinet_ros.analysis.plan import hopeless, two_sided

    found, claim = planned.found, planned.claim
    assert found is not None
    low, high = two_sided(found)
    what = 'left the runway' if claim.off else 'failed'
    console.print()
    of = '' if found.drawn == found.runs else (
        f' drawn by the program itself, of {found.runs:,} runs by {found.sampler}'
    )
    console.print(
        f'so far {found.drawn_hits:,} of {found.drawn:,} runs{of} {what}, '
        f'{100 * found.drawn_hits / found.drawn:.3g} % (95 %: {100 * low:.3g} to '
        f'{100 * high:.3g} %)',
    )
    if rules:
        console.print(
            f'it may have ended by --until {" and ".join(rules)}, so this share is biased; the '
            'numbers below hold at any number of runs',
        )
    if hopeless(planned):
        console.print('these runs show that the claim is false')
    elif found.drawn_hits / found.drawn >= claim.limit:
        console.print(
            'at this share the claim is false: it takes fewer failures from now on than so far',
        )
    if planned.further[0].drawn == 0:
        console.print(f'the claim holds already: {_gate(claim)}')
        return
    for one in planned.further:
        console.print(_further_words(one))
    if planned.likely is not None:
        share = claim.if_true if claim.if_true is not None else (
            claim.bad(found.drawn_hits / found.drawn)
        )
        console.print(f'{_further_words(planned.likely)}, if the true share is {_percent(share)}')
    if found.drawn_hits:
        good = dataclasses.replace(
            found, hits=found.runs - found.hits, drawn_hits=found.drawn - found.drawn_hits)
        more = further_runs(good, 1 - claim.limit, claim.confidence)
        console.print(f'to decide: {further_words(good, more)}')
    alone = '' if planned.by_sequential is None else (
        f'; judged from its first run by --sequential alone, {planned.by_sequential:,} without a '
        'failure'
    )
    console.print(
        'these count on from the runs that you have seen, and you may look again: '
        f'{_gate(claim)}{alone}. The numbers before "so far" are for a new campaign, by itself',
    )


def _gate(claim: Claim) -> str:
    """The command that judges the claim, without the campaign's name."""
    from taxinet_ros.trials.rates import CONFIDENCE

    command = f'taxinet gate --{claim.criterion} {claim.threshold:.12g}'
    usual = claim.confidence == CONFIDENCE
    return command if usual else f'{command} --confidence {claim.confidence:g}'


def _further_words(one: Further) -> str:
    allowed = 'without a failure' if one.failures == 0 else (
        f'with at most {one.failures:,} failure{"" if one.failures == 1 else "s"}'
    )
    if one.drawn is None or one.runs is None:
        return f'{allowed}: no realistic number of runs'
    more = f'{one.runs:,} more runs'
    if one.runs != one.drawn:
        more += f', {one.drawn:,} of them drawn by the program itself'
    chance = '' if one.chance is None else f' (chance {_chance(one.chance)})'
    return f'{more}, {allowed}{chance}'


def _json(planned: Planned) -> dict[str, Any]:
    from taxinet_ros.analysis.plan import hopeless, two_sided

    claim, found = planned.claim, planned.found
    told: dict[str, Any] = {
        'claim': dataclasses.asdict(claim),
        'fixed': [dataclasses.asdict(one) for one in planned.fixed],
        'with_power': planned.powered and dataclasses.asdict(planned.powered),
        'gate_at_any_look_without_failure': planned.any_look,
        'sequential': None,
    }
    if planned.sequential is not None:
        one = planned.sequential
        told['sequential'] = {
            'test': str(one.test), 'most_runs': one.most,
            'if_true': dataclasses.asdict(one.at_truth),
            'at_limit': dataclasses.asdict(one.at_limit),
        }
    if found is not None:
        low, high = two_sided(found)
        told['campaign'] = {
            'runs': found.runs, 'drawn': found.drawn, 'bad': found.drawn_hits, 'low': low,
            'high': high, 'number_fixed': not found.anytime, 'claim_is_false': hopeless(planned),
            'further': [dataclasses.asdict(one) for one in planned.further],
            'further_by_sequential': planned.by_sequential,
            'likely': planned.likely and dataclasses.asdict(planned.likely),
        }
    return told


def _percent(share: float) -> str:
    return f'{100 * share:.6g} %'


def _chance(share: float) -> str:
    return f'{100 * share:.1f} %'
