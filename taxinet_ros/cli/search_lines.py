"""The lines that a search prints: what is searched, and what came of it."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from taxinet_ros.campaign.rates import Rate, summarise
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.samplers.estimate import Estimate
from taxinet_ros.campaign.search import Search
from taxinet_ros.campaign.search_options import SearchOptions
from taxinet_ros.campaign.stop_rule import failure_estimate, off_runway_estimate
from taxinet_ros.cli.lines import scene_words


def search_heading(options: SearchOptions) -> str:
    """What is about to run."""
    campaign = options.campaign
    workers = '1 worker' if options.workers == 1 else f'{options.workers} workers'
    verb = 'resuming' if options.resume else 'searching'
    return (
        f'{verb} {campaign.program} for failures: up to {campaign.runs} runs, sampler '
        f'{options.sampler}, seed {campaign.seed}, perception {campaign.perception}, {workers} '
        f'-> {campaign.out}'
    )


def search_summary(search: Search) -> list[str]:
    """What came of it: counts, rates with their intervals, the worst run, where the table is."""
    rows, campaign = search.rows, search.options.campaign
    counts = summarise(rows).counts
    lines = [', '.join(f'{n} {outcome}' for outcome, n in counts.items() if n) or 'no run ended']
    lines += [*_rate_lines(rows), *_worst(rows)]
    lines.append(f'table: {campaign.out / "runs.csv"}, runs.parquet; bags: {campaign.out}/<run>/')
    why = 'interrupted' if search.interrupted else search.stopped
    if why and len(rows) < campaign.runs:
        lines.append(f'ended before its {campaign.runs} runs: {why}; --resume continues it')
    return lines


def estimate_words(found: Estimate | None) -> str:
    """A rate with its interval in a few words; empty where none is known."""
    return _rate_words(found.rate) if found is not None and found.runs else ''


def _rate_lines(rows: Sequence[RunRow]) -> list[str]:
    judged = [row for row in rows if row.outcome.judged]
    if not judged:
        return []
    speed = statistics.median(row.real_time_factor for row in judged)
    failed, off = failure_estimate(rows), off_runway_estimate(rows)
    if failed is None or off is None:
        return [
            f'{sum(bool(row.left_runway) for row in judged)} off the runway, median '
            f'{speed:.1f}x real time; this sampler says nothing on how often the program fails'
        ]
    satisfied = Rate(1 - failed.rate.rate, 1 - failed.rate.high, 1 - failed.rate.low)
    drawn = all(row.weight == 1 for row in judged)
    worth = '' if drawn else f', weighted: worth {failed.effective:.0f} independent runs'
    return [
        f'under the program itself: satisfied {_rate_words(satisfied)}, off the runway '
        f'{_rate_words(off.rate)} (95 % intervals{worth})',
        f'{failed.failures} of {failed.runs} judged runs failed, median {speed:.1f}x real time',
    ]


def _rate_words(rate: Rate) -> str:
    return f'{rate.rate:.1%} [{rate.low:.1%}, {rate.high:.1%}]'


def _worst(rows: Sequence[RunRow]) -> list[str]:
    judged = [row for row in rows if row.outcome.judged]
    if not judged:
        return []
    worst = min(judged, key=lambda row: next(iter(row.rho.values())))
    rho = next(iter(worst.rho.values()))
    return [f'worst: run {worst.index}, rho {rho:+.2f}: {scene_words(worst)}']
