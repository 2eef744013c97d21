"""The report on a campaign: the text of ``page.j2``, the pictures and the tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any

import pandas as pd

from taxinet_ros.analysis.campaign.figures import (
    causes_picture,
    rates_picture,
    rho_picture,
)
from taxinet_ros.analysis.campaign.findings import Findings, bag_folders, failures_to_inspect
from taxinet_ros.analysis.campaign.tables import (
    bins_table,
    causes_table,
    failures_table,
    ranking_table,
    rates_table,
)
from taxinet_ros.analysis.causes.program import confirmation_command, why_no_program
from taxinet_ros.analysis.causes.scan import DISCOUNT, SHUFFLES
from taxinet_ros.analysis.report.parts import Picture, Report, Table
from taxinet_ros.analysis.report.text import fill_report
from taxinet_ros.analysis.runs.features import (
    CLOUDS_KIND,
    CROSS_TRACK,
    DISTANCE,
    HEADING,
    TIME_OF_DAY,
    varied,
)
from taxinet_ros.core.provenance import differences, words

TEXT = Path(__file__).with_name('page.j2')
VIEWERS = 20
"""Most failed runs that the page has step by step."""


def campaign_report(findings: Findings) -> Report:
    """Present findings as sentences, tables and pictures.

    Args:
        findings: result of :func:`~taxinet_ros.analysis.campaign.findings.analyse`.
    """
    runs, failures = findings.runs, failures_to_inspect(findings)
    shown = min(len(failures), 2 * VIEWERS)
    commands = [confirmation_command(runs, cause) for cause in findings.causes.found]
    specs = runs.facts.get('specs')
    return fill_report(
        TEXT, {
            'f': findings, 'different': differences(
                *(stack for one in findings.campaigns for stack in one.stacks)),
            'formula': specs.get(runs.spec, '') if isinstance(specs, dict) else '',
            'quantiles': runs.frame['rho'].quantile([0.05, 0.5, 0.95]).tolist(),
            'constant': [
                feature.title
                for feature in (TIME_OF_DAY, CLOUDS_KIND, DISTANCE, HEADING, CROSS_TRACK)
                if not varied(runs.frame, (feature,))
            ],
            'discount': DISCOUNT, 'shuffles': SHUFFLES,
            'commands': [command for command in commands if command is not None],
            'chosen': runs.examined.chosen if runs.examined else '',
            'also': runs.examined.also(f'taxinet analyze {quote(str(runs.path))}')
            if runs.examined else '',
            'no_program': why_no_program(runs), 'failed': len(failures), 'shown': shown,
        },
        _figures(findings, failures, shown),
        **_worst_first(bag_folders(runs, failures, VIEWERS), failures),
        made_on='; '.join(map(words, runs.stacks)),
    )


def _figures(
    findings: Findings, failures: pd.DataFrame, shown: int
) -> dict[str, Sequence[Picture | Table]]:
    runs, campaigns = findings.runs, findings.campaigns
    found: dict[str, Sequence[Picture | Table]] = {
        'rates': (rates_picture(campaigns), rates_table(findings), bins_table(runs)),
        'day': (rho_picture(campaigns, TIME_OF_DAY, 'rho_by_hour'),),
        'runway': (rho_picture(campaigns, DISTANCE, 'rho_by_distance'),),
    }
    causes: list[Picture | Table] = []
    if findings.causes.found:
        causes += [causes_picture(findings), causes_table(findings, failures)]
    if findings.ranking:
        causes.append(ranking_table(findings))
    found['causes'] = causes
    if shown:
        found['counterexamples'] = (failures_table(failures, shown),)
    return found


def _worst_first(runs: Mapping[str, Path], failures: pd.DataFrame) -> dict[str, Any]:
    """The runs to look at in order of robustness, and the worst of them for the first screen."""
    rho = dict(zip(failures['run_id'], failures['rho'].astype(float), strict=True))
    ordered = {run: runs[run] for run in sorted(runs, key=lambda run: (rho[run], run))}
    return {
        'runs': ordered, 'worst': next(iter(ordered), ''),
        'rho': {run: rho[run] for run in ordered},
    }
