"""``taxinet gate``: check a campaign against acceptance thresholds in continuous integration."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.checked import tell_doubts
from taxinet_ros.cli.options import JsonOption, refuse_given
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode, UsageError

INCONCLUSIVE_WORDS = {
    'pass': ExitCode.OK, 'fail': ExitCode.VIOLATED, 'report': ExitCode.INCOMPLETE,
}
"""Exit code of each ``--inconclusive`` word."""


def gate(
    context: typer.Context,
    campaign: Annotated[
        Path,
        typer.Argument(
            metavar='CAMPAIGN|NETWORK', help="a campaign's folder; with --baseline also a network, "
            'word or file, which is then driven through its scenes'
        ),
    ],
    min_satisfaction: Annotated[
        float | None,
        typer.Option(metavar='SHARE', help='minimum share of runs that satisfy their formulas'),
    ] = None,
    max_off_runway: Annotated[
        float | None, typer.Option(metavar='SHARE', help='maximum share of runs that leave the '
        'runway')
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(
            metavar='CAMPAIGN|TABLE', help='runs of the same scenes, which these must not be worse '
            'than'
        ),
    ] = None,
    margin: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='with --baseline: loss of satisfied scenes up to which it is no '
            'worse (default 0.05)'
        ),
    ] = None,
    confidence: Annotated[
        float,
        typer.Option(help='confidence of PASS and of FAIL, over all looks that are covered'),
    ] = 0.95,
    planned: Annotated[
        bool,
        typer.Option(
            '--planned', help='judge once, at exactly the planned number of runs, with the whole '
            'confidence (as taxinet plan counts)'
        ),
    ] = False,
    sequential: Annotated[
        bool,
        typer.Option(
            '--sequential', help='follow the runs in their order to the first decision of a '
            'sequential test, at which falsify --until stops'
        ),
    ] = False,
    design: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='with --sequential: the share that a good system has, better '
            'than the threshold; the test then takes the fewest runs for it'
        ),
    ] = None,
    inconclusive: Annotated[
        str,
        typer.Option(
            metavar='WORD', help='exit code for INCONCLUSIVE: report (3), pass (0) or fail (1)'
        ),
    ] = 'report',
    junit: Annotated[
        Path | None, typer.Option(
            metavar='FILE.xml', writable=True, dir_okay=False, help='JUnit XML file to write, one '
            'test case per criterion; the table of the runs is written beside it'
        )
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help='folder for the runs of a NETWORK; finished runs in it are kept'),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help='of a NETWORK: worker processes; same results (default 2)'),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Check a campaign against acceptance thresholds.

    PASS (exit code 0) only if the one-sided bound of each share clears its threshold, FAIL (1) if
    the whole interval of one violates it, else INCONCLUSIVE (3) with an estimate of the additional
    runs needed. Runs with an infrastructure error are excluded and counted separately; with any,
    what would be PASS or INCONCLUSIVE is INCONCLUSIVE with exit code 4.

    With --baseline, the scenes are paired with those of another campaign or table, which have to be
    the same: FAIL if satisfaction falls (McNemar's exact test), PASS if it falls by no more than
    the margin, else INCONCLUSIVE. A network in place of the campaign is driven through these scenes
    in the closed loop without ROS; after an interrupt, the same command continues.
    """
    from taxinet_ros.analysis.gate.baseline import DEFAULT_MARGIN
    from taxinet_ros.analysis.gate.criteria import GateOptions, Look, Verdict
    from taxinet_ros.analysis.gate.judged import check_junit, driven_runs, recorded_runs
    from taxinet_ros.analysis.gate.report import gate_json, gate_text
    from taxinet_ros.cli.progress import trial_bar

    if margin is not None and baseline is None:
        raise UsageError('--margin: only with --baseline')
    options = GateOptions(
        min_satisfaction=min_satisfaction, max_off_runway=max_off_runway, confidence=confidence,
        look=Look.of(planned=planned, sequential=sequential),
        design=design, margin=DEFAULT_MARGIN if baseline and margin is None else margin,
    )
    if inconclusive not in INCONCLUSIVE_WORDS:
        known = ', '.join(INCONCLUSIVE_WORDS)
        raise UsageError(f'--inconclusive {inconclusive}: unknown; known: {known}')
    if junit is not None:
        check_junit(junit, [path for path in (campaign, baseline) if path])
    if baseline is not None and not campaign.is_dir():
        judged = driven_runs(
            str(campaign), baseline, out, workers or 2,
            partial(trial_bar, line_console(stderr=True), 'runs'), tell_doubts,
            shares=min_satisfaction is not None,
        )
    else:
        refuse_given(
            context, ('out', 'workers'), 'only where a network is driven through the scenes of a '
            f'--baseline; {campaign} is not driven',
        )
        judged = recorded_runs(campaign)
    answer = judged.answer(options, baseline)
    table = judged.write_junit(junit, answer, inconclusive_passes=inconclusive == 'pass')
    if as_json:
        print_json(gate_json(answer, options, table))
    else:
        print(gate_text(answer, judged.folder, table))
    if answer.verdict is not Verdict.FAIL and answer.counts[Outcome.INFRA_ERROR]:
        return ExitCode.INFRA
    codes = {Verdict.PASS: ExitCode.OK, Verdict.FAIL: ExitCode.VIOLATED}
    return codes.get(answer.verdict, INCONCLUSIVE_WORDS[inconclusive])
