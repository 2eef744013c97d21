"""``taxinet merge``: the shards of a search become one campaign."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from taxinet_ros.campaign.merge import merge_shards
from taxinet_ros.campaign.rates import count_outcomes, failure_rate
from taxinet_ros.errors import ExitCode


def run_merge(shards: Sequence[Path], out: Path, *, bags: str, quiet: bool) -> int:
    """Merge shards and print what the campaign has.

    Returns:
        Exit code: 0 merged.

    Raises:
        UsageError: they cannot be merged.
    """
    def show(bag: Path) -> None:
        if shown:
            print(f'\r\033[Kchecking {bag}', end='', file=sys.stderr, flush=True)

    shown = sys.stderr.isatty() and not quiet
    try:
        merged = merge_shards(shards, out, bags=bags, on_bag=show)
    finally:
        if shown:
            print('\r\033[K', end='', file=sys.stderr)
    for warning in merged.warnings:
        print(f'warning: {warning}; see docs/determinism.md')
    rows = merged.content.rows
    found = failure_rate(rows, merged.planned)
    rate = found.why_not if found.rate is None else (
        f'under the program itself: satisfied {found.rate.other.words()} ({found.rests_on})'
    )
    print('\n'.join([
        f'{len(shards)} shards merged: {count_outcomes(rows)}', rate,
        f'table: {out / "runs.csv"}, runs.parquet; bags: {out}/<run>/',
    ]))
    return ExitCode.OK
