"""``taxinet localize``: find whether network or controller causes a campaign's failures."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import (
    CampaignArgument,
    ExaminedOption,
    JsonOption,
    ProcessesCountOption,
)
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode

if TYPE_CHECKING:
    from taxinet_ros.analysis.fault_localisation import Localisation
    from taxinet_ros.trials.past_runs.localisation import LocalizeOptions
    from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign


def localize(
    campaign: CampaignArgument,
    runs: Annotated[
        int | None,
        typer.Option(help='maximum number of failed runs to examine, evenly spread'),
    ] = None,
    substitutions: Annotated[
        list[str] | None,
        typer.Option(
            '--with', metavar='SUBSTITUTION',
            help='truth, truth-heading, truth-cte (default: these three), '
            'delayed:SECONDS, truth-delayed:SECONDS or noisy:SIGMA_M; repeatable',
        ),
    ] = None,
    workers: ProcessesCountOption = 1,
    out: Annotated[
        Path | None,
        typer.Option(help='output folder for table and page; finished trials in it are kept'),
    ] = None,
    perception: Annotated[
        str | None, typer.Option(metavar='FILE', help="the runs' network, if its file has moved")
    ] = None,
    spec: ExaminedOption = None,
    as_json: JsonOption = False,
) -> int:
    """Find which part causes failures: network or controller.

    Reruns a campaign's failed runs unchanged and with the truth in place of the whole estimate, of
    its heading error only and of its cross-track error only. After an interrupt, the same command
    continues.
    """
    from taxinet_ros.trials.past_runs.localisation import make_localize_options
    from taxinet_ros.trials.record.facts import missing_packages_named

    with missing_packages_named(campaign):
        options = make_localize_options(
            campaign, runs=runs, words=substitutions or (), workers=workers, out=out,
            perception=perception, spec=spec,
        )
    return run_localize(options, as_json=as_json)


def run_localize(options: LocalizeOptions, *, as_json: bool) -> int:
    """Run the trials, write the results and print a summary; return the exit code."""
    from taxinet_ros.analysis.fault_localisation import (
        localisation,
        localisation_json,
        localisation_sentences,
    )
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.processes.interrupts import interrupts
    from taxinet_ros.trials.past_runs.localisation import localize
    from taxinet_ros.trials.record.facts import stack_difference

    console = line_console(stderr=as_json)
    console.print(_heading(options))
    if warning := stack_difference(options.campaign.facts, str(options.campaign.folder)):
        console.print(warning)
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
        campaign, options.rows, trials, words=options.words, perception=options.perception,
        examined=options.examined,
    )
    unfinished = len(trials) < options.wanted
    written = _write(found, campaign, options.out)
    if as_json:
        print_json(localisation_json(found) | {'complete': not unfinished})
    else:
        lines = [*localisation_sentences(found), f'written: {", ".join(map(str, written))}']
        console.print('\n'.join(lines))
    if unfinished:
        left = options.wanted - len(trials)
        console.print(f'interrupted, {left} trials left; run it again to continue')
    return ExitCode.INTERRUPTED if unfinished else ExitCode.OK


def _heading(options: LocalizeOptions) -> str:
    rows, words = len(options.rows), ', '.join(options.words)
    campaign = options.campaign
    return (
        f'{rows} of {options.examined.failed} failed runs of {campaign.folder}, '
        f'perception {options.perception}, each with {words} -> {options.out}'
    )


def _write(found: Localisation, campaign: RecordedCampaign, out: Path) -> list[Path]:
    from taxinet_ros.analysis.fault_localisation import (
        JSON_NAME,
        localisation_json,
        localisation_report,
        worst_cases,
        write_cases,
    )
    from taxinet_ros.analysis.report.page import write_report
    from taxinet_ros.bag.errors import BagError
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.files.record import RECORD_NAME
    from taxinet_ros.files.sealed_json import write_sealed

    worst = worst_cases(found, campaign.folder)
    for case in worst:
        with contextlib.suppress(BagError):  # the page reports a damaged one
            open_recording(campaign.folder / case.row.bag).check_is(case.row.run_id)
    report = localisation_report(found, worst, campaign.folder)
    path, tables = out / JSON_NAME, write_cases(found, out)
    write_sealed(path, localisation_json(found), [*tables, out / RECORD_NAME])
    page = out / 'localize.html'
    pictures = write_report(report, page)
    return [page, *pictures, *tables, path]
