"""``taxinet experiment``: the same scenes with and without what is under suspicion."""

from __future__ import annotations

import json
from pathlib import Path

from rich.console import Console

from taxinet_ros.bag.layout import write_whole
from taxinet_ros.campaign.crew import Crew
from taxinet_ros.campaign.experiment import (
    JSON_NAME,
    PAGE_NAME,
    PAIRS_NAME,
    arm_rows,
    arm_searches,
    check_paired,
)
from taxinet_ros.campaign.experiment_file import Experiment
from taxinet_ros.campaign.facts import LEDGER_NAME
from taxinet_ros.campaign.interrupts import interrupts
from taxinet_ros.campaign.lines import check_lines, row_line
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.sealed_json import write_sealed
from taxinet_ros.campaign.search import Search
from taxinet_ros.campaign.search_loop import run_search
from taxinet_ros.campaign.search_options import SearchOptions
from taxinet_ros.cli.progress import told_if_lost
from taxinet_ros.cli.search_view import search_view
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.nodes.domain import check_workers
from taxinet_ros.nodes.graph import campaign_graph
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.worker import worker_command

INTERRUPTED, BROKEN = 130, 4


def run_experiment(
    experiment: Experiment, out: Path, *, workers: int, resume: bool, as_json: bool
) -> int:
    """Run every arm, compare them, and print what came of it.

    Returns:
        Exit code: 0 done, 4 the bench broke some run, 130 interrupted; ``--resume`` goes on. No
        comparison is written before every arm has had all its runs.

    Raises:
        UsageError: bad input, or arms whose scenes are not the same.
    """
    console = Console(highlight=False, stderr=as_json)
    check_workers(workers)
    searches = arm_searches(experiment, out, workers=workers, resume=resume)
    for number, (name, options) in enumerate(searches.items(), 1):
        console.print(
            f'arm {number} of {len(searches)}: {name}, {experiment.runs} scenes -> '
            f'{options.campaign.out}', soft_wrap=True,
        )
        search = _run_arm(options, console, first=number == 1)
        if search.interrupted and len(search.rows) < options.campaign.runs:
            console.print('interrupted; --resume goes on')
            return INTERRUPTED
        if search.stopped and not search.exhausted:
            console.print(f'ended: {search.stopped}; --resume goes on', soft_wrap=True)
            return BROKEN
    rows = arm_rows(experiment, out)
    check_paired(experiment, rows)
    known = [row for arm in rows.values() for row in arm]
    with told_if_lost(console, known, shown=True):
        _report(experiment, rows, out, console, as_json=as_json)
    return BROKEN if any(row.outcome is Outcome.INFRA_ERROR for row in known) else 0


def _run_arm(options: SearchOptions, console: Console, *, first: bool) -> Search:
    """Run one arm to its end, or until it is interrupted or the bench breaks.

    The first one says how the requirements are understood, for they are the same in all.
    """
    live = console.is_terminal

    def show(row: RunRow) -> None:
        # A terminal has the bar for what goes as it should.
        if not live or not row.outcome.judged:
            console.print(row_line(row), soft_wrap=True)

    search = Search(options, PARTICIPANTS, show)
    with told_if_lost(console, search.rows, shown=not live), search:
        for line in check_lines(search.check, quiet=not first):
            console.print(line, soft_wrap=True)
        for note in (*search.notes, *filter(None, [search.warning])):
            console.print(note, soft_wrap=True, markup=False)
        with (
            interrupts(search.interrupt),
            search_view(console, search, shown=live),
            Crew(_command(search), options.workers, options.campaign.out / 'logs') as crew,
        ):
            run_search(search, crew)
    return search


def _report(
    experiment: Experiment, rows: dict[str, tuple[RunRow, ...]], out: Path, console: Console, *,
    as_json: bool,
) -> None:
    from taxinet_ros.analysis.experiment_report import (
        experiment_json,
        experiment_report,
        experiment_sentences,
    )
    from taxinet_ros.analysis.paired_arms import paired_arms, pairs_frame
    from taxinet_ros.analysis.picture_files import LIGHT, write_png
    from taxinet_ros.analysis.report_page import write_report_page

    found = paired_arms(experiment, rows)
    values, report, frame = experiment_json(found), experiment_report(found), pairs_frame(found)
    pairs = out / PAIRS_NAME
    write_whole(pairs, lambda draft: frame.to_parquet(draft, index=False))
    # Two arms that change places would be sound campaigns, each with the other's name.
    write_sealed(out / JSON_NAME, values, [pairs], [out / name / LEDGER_NAME for name in rows])
    pictures = [
        write_png(picture, out, LIGHT) for section in report.sections
        for picture in section.pictures
    ]
    write_report_page(report, out / PAGE_NAME)
    if as_json:
        print(json.dumps(values, indent=2))
        return
    names = [PAGE_NAME, *(path.name for path in pictures), PAIRS_NAME, JSON_NAME]
    lines = [*experiment_sentences(found), f'written: {out / names[0]}, {", ".join(names[1:])}']
    console.print('\n'.join(lines), soft_wrap=True, markup=False)


def _command(search: Search) -> list[str]:
    campaign = search.options.campaign
    return worker_command(campaign_graph(campaign, search.facts['controller_sha256']))
