"""``taxinet improve``: rounds of falsification and retraining, and their decisions."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from taxinet_ros.campaign.cluster.connection import check_cluster
from taxinet_ros.campaign.options import DEFAULT_ROOT, check_new, make_out, new_folder
from taxinet_ros.campaign.rates import rate
from taxinet_ros.cli.study.stages import call_stage
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.study.improve.acceptance import Decision
from taxinet_ros.study.improve.loop import BEST, START, Improvement, Round
from taxinet_ros.study.improve.options import ImproveOptions
from taxinet_ros.study.stages.record import OPTIONS, open_study, read_options
from taxinet_ros.study.stages.run import StudyRun
from taxinet_ros.study.stages.stage import Stage, with_engine

ROUNDS_NAME = 'rounds.json'
"""The rounds of the record, to read."""
_COMMAND = 'improve'


def run_improve(
    options: ImproveOptions | None, out: Path | None, workers: int, engine: str,
    audit: str | None, cluster: str | None,
) -> int:
    """Run the rounds and print their results.

    Args:
        options: options; None to continue with those of ``out``.
        out: folder, or None for a new one.
        workers: worker processes of a resumed loop.
        engine: what makes the runs, see :class:`.CampaignOptions`.
        audit: share of the runs to audit as text, see :func:`.check_engine`.
        cluster: a Dask cluster that makes the runs of campaigns, or None.

    Returns:
        Exit code: 0 done, 130 interrupted, else that of the stage that failed.

    Raises:
        UsageError: bad input.
    """
    console = Console(highlight=False)
    from taxinet_ros.nodes.running.domain import check_workers  # ROS takes time to import

    with_engine((), engine, audit)  # checks them before anything is made
    where = check_cluster(cluster) if cluster else ''
    if options is not None:
        check_workers(options.workers)
    options, out = _begun(options, out, workers)
    check_workers(options.workers)

    def show(line: str) -> None:
        console.print(line, soft_wrap=True, markup=False)

    rounds: list[dict[str, Any]] = []
    with open_study(out, show) as record:
        if OPTIONS not in record.entries:
            record.put(OPTIONS, _COMMAND, dataclasses.asdict(options))
        show(
            f'improve {options.start} on {options.program}: at most {options.rounds} rounds of 3 '
            f'times {options.runs:,} runs -> {out}'
        )
        show(f'every stage runs in {out}')

        def run_stages(stages: Sequence[Stage]) -> int:
            return StudyRun(
                out, with_engine(stages, engine, audit, where), record=record, work=call_stage,
                workers=options.workers, show=show,
            ).run()

        def show_round(done: Round) -> None:
            rounds.append(done.to_json())
            record.put('round', str(done.number), rounds[-1])
            write_atomically(out / ROUNDS_NAME, json.dumps(rounds, indent=2) + '\n')
            for line in ('', *round_lines(done, options.rounds)):
                show(line)

        code = Improvement(out, options, run_stages, show_round).run()
    if code == ExitCode.OK:
        show(f'network: {out / BEST}; decisions of the rounds: {out / ROUNDS_NAME}')
    return code


def _begun(
    options: ImproveOptions | None, out: Path | None, workers: int
) -> tuple[ImproveOptions, Path]:
    """Options and folder of a new or resumed loop."""
    if options is None:
        if out is None:
            raise UsageError('--resume: name the folder to continue with --out')
        values = read_options(out, _COMMAND, '--resume')
        earlier = ImproveOptions(**{**values, 'add': tuple(values['add']), 'workers': workers})
        if (out / START).exists():
            earlier = dataclasses.replace(earlier, start=str(out / START))
        return earlier, out
    options = options.checked()
    if out is None:
        out = new_folder(DEFAULT_ROOT / 'improve')
    check_new(out)
    make_out(out)
    return options, out


def round_lines(done: Round, rounds: int) -> list[str]:
    """Text lines on a round's findings and decision."""
    lines = [
        f'round {done.number} of {rounds}: {done.failed} of {done.searched} runs of the search '
        'failed'
    ]
    lines += [f'  cause: {words}' for words in done.causes]
    lines += [f'  cluster: {words}' for words in done.clusters]
    if done.decision is None:
        return [*lines, '  no failures to learn from; a larger --budget may find more']
    return [*lines, *_decision_lines(done.decision)]


def _decision_lines(made: Decision) -> list[str]:
    now = rate(made.pairs - made.failed_now, made.pairs)
    return [
        f'  on {made.pairs} scenes new to both: {made.failed_before} failures before, '
        f'{made.failed_now} now ({made.only_before} only before, {made.only_now} only now); '
        f'{made.off_before} and {made.off_now} left the runway',
        f'  now satisfied: {100 * now.rate:.1f} % ({100 * now.low:.1f}-{100 * now.high:.1f} %); '
        f'rho {_change(made)}',
        f'  failure rate higher by at most {100 * max(made.more_failures, 0):.1f} points',
        f'  {"ACCEPTED" if made.accepted else "REJECTED"}: {made.why}',
    ]


def _change(made: Decision) -> str:
    if math.isnan(made.rho_low):  # too few pairs for an interval
        return f'{made.rho_change:+.3f}'
    return f'{made.rho_change:+.3f} ({made.rho_low:+.3f} to {made.rho_high:+.3f})'
