"""``taxinet localize``: find whether network or controller causes a campaign's failures."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

from rich.console import Console

from taxinet_ros.analysis.fault_localisation import (
    JSON_NAME,
    Localisation,
    localisation,
    localisation_json,
    localisation_report,
    localisation_sentences,
    worst_cases,
    write_cases,
)
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.errors import ExitCode
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.files.sealed_json import write_sealed
from taxinet_ros.processes.interrupts import interrupts
from taxinet_ros.trials.past_runs.localisation import LocalizeOptions, localize
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign
from taxinet_ros.trials.record.facts import stack_difference


def run_localize(options: LocalizeOptions, *, as_json: bool) -> int:
    """Run the trials, write the results and print a summary.

    Returns:
        Exit code: 0 done, 130 interrupted; the same command continues.

    Raises:
        UsageError: bad input.
        InfraError: worker processes end one after the other.
    """
    console = Console(highlight=False, stderr=as_json)
    console.print(_heading(options), soft_wrap=True, markup=False)
    if warning := stack_difference(options.campaign.facts, str(options.campaign.folder)):
        console.print(warning, soft_wrap=True, markup=False)
    asked: list[bool] = []
    with (
        stage_bars(console) as show,
        interrupts(lambda: asked.append(True)),
    ):
        trials = localize(
            options, lambda done: show('trials', done, options.wanted), lambda: bool(asked)
        )
    campaign = options.campaign
    found = localisation(
        campaign, options.rows, trials, words=options.words, perception=options.perception
    )
    unfinished = len(trials) < options.wanted
    written = _write(found, campaign, options.out)
    if as_json:
        print(json.dumps(localisation_json(found) | {'complete': not unfinished}, indent=2))
    else:
        lines = [*localisation_sentences(found), f'written: {", ".join(map(str, written))}']
        console.print('\n'.join(lines), soft_wrap=True, markup=False)
    if unfinished:
        left = options.wanted - len(trials)
        console.print(f'interrupted, {left} trials left; run it again to continue', soft_wrap=True)
    return ExitCode.INTERRUPTED if unfinished else ExitCode.OK


def _heading(options: LocalizeOptions) -> str:
    rows, words = len(options.rows), ', '.join(options.words)
    campaign = options.campaign
    return (
        f'{rows} of {len(campaign.counterexamples)} failed runs of {campaign.folder}, '
        f'perception {options.perception}, each with {words} -> {options.out}'
    )


def _write(found: Localisation, campaign: RecordedCampaign, out: Path) -> list[Path]:
    from taxinet_ros.analysis.report.page import write_report_page
    from taxinet_ros.analysis.report.pictures import LIGHT, write_png

    worst = worst_cases(found, campaign.folder)
    for case in worst:
        with contextlib.suppress(BagError):  # the page reports a damaged one
            open_recording(campaign.folder / case.row.bag).check_is(case.row.run_id)
    report = localisation_report(found, worst, campaign.folder)
    path, tables = out / JSON_NAME, write_cases(found, out)
    write_sealed(path, localisation_json(found), [*tables, out / RECORD_NAME])
    pictures = [
        write_png(picture, out, LIGHT) for section in report.sections
        for picture in section.pictures
    ]
    page = out / 'localize.html'
    write_report_page(report, page)
    return [page, *pictures, *tables, path]
