"""Report of a case study, side by side with the paper: page, tables, pictures and JSON."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pandas as pd

from taxinet_ros.analysis.report.parts import Report
from taxinet_ros.analysis.report.values import plain_values
from taxinet_ros.core.provenance import provenance
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.sealed_table import write_table
from taxinet_ros.study.report.claim import Claim
from taxinet_ros.study.report.paper import judge_claims
from taxinet_ros.study.report.results import Results, read_results, read_tables
from taxinet_ros.study.report.sections import (
    StudyFindings,
    study_facts,
    study_sections,
    study_summary,
)
from taxinet_ros.study.report.tables import (
    distances_frame,
    hours_frame,
    learned_frame,
    networks_frame,
    pairs_frame,
    stages_frame,
)
from taxinet_ros.study.stages.config import StudyConfig
from taxinet_ros.study.stages.plan import REPORT, stages
from taxinet_ros.study.stages.record import read_stages
from taxinet_ros.version import __version__

PAGE_NAME, JSON_NAME = 'case_study.html', 'case_study.json'
SCHEMA, VERSION = 'taxinet-case-study', 1


def write_study_report(
    config: StudyConfig, out: Path, tables: Path | None = None
) -> list[str]:
    """Write the report of the stages done so far, replacing an earlier one.

    Args:
        config: configuration of the study.
        out: folder of the study.
        tables: folder of tables to report instead of the contents of ``out``, or None.

    Returns:
        Lines to print: the summary, with ``tables`` every claim, and the path of the report.

    Raises:
        UsageError: no network has been evaluated, or a file of the study is damaged.
        OSError: a file cannot be written.
    """
    from taxinet_ros.analysis.report.page import write_report_page
    from taxinet_ros.analysis.report.pictures import write_pictures

    found = gather_findings(config, out, tables)
    folder = out / REPORT
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f'{folder}: cannot be made: {error.strerror}') from error
    for name, frame in found.frames().items():
        _write_table(frame, folder / f'{name}.parquet')
    report = study_report(found)
    write_pictures(report, folder)
    write_report_page(report, folder / PAGE_NAME)
    text = json.dumps(study_values(found), indent=2, allow_nan=False, ensure_ascii=False)
    write_atomically(folder / JSON_NAME, text + '\n')
    claims = [f'{claim.name}: {claim.sentence()}' for claim in found.claims] if tables else []
    return [*report.summary, *claims, f'report: {folder / PAGE_NAME}']


def gather_findings(config: StudyConfig, out: Path, tables: Path | None = None) -> StudyFindings:
    """Collect the contents of the report; without stages if only tables are given.

    Raises:
        UsageError: no network has been evaluated, or a file of the study is damaged.
    """
    results = read_results(config, out) if tables is None else read_tables(config, tables)
    if not results.networks:
        raise UsageError(f'{out}: no network was evaluated yet, so there is nothing to report')
    found = [stage for stage in stages(config) if stage.name != REPORT and tables is None]
    if tables is not None:  # the planned number is the actual one, so no run is pending
        runs = min(len(network.table) + network.unjudged for network in results.networks.values())
        config = dataclasses.replace(config, runs=runs)
    return StudyFindings(
        config=config, out=out, results=results, claims=judge_claims(results),
        networks=networks_frame(results), hours=hours_frame(results),
        distances=distances_frame(results), pairs=pairs_frame(results),
        learned=learned_frame(results), stages=stages_frame(found, read_stages(out)),
    )


def study_report(found: StudyFindings) -> Report:
    """Report on the findings."""
    return Report(
        title="The paper's case study, run again", facts=study_facts(found),
        summary=study_summary(found), sections=study_sections(found),
    )


def study_values(found: StudyFindings) -> dict[str, Any]:
    """The findings as plain values; shares are fractions, unknown values None."""
    return plain_values({
        'schema': SCHEMA, 'version': VERSION, 'taxinet_ros_version': __version__,
        'made_on': dict(provenance()),
        'config': dataclasses.asdict(found.config), 'summary': list(study_summary(found)),
        'claims': [_claim(claim) for claim in found.claims],
        **{name: _records(frame) for name, frame in found.frames().items()},
        'localized': _localized(found.results),
        'experiments': {
            name: values['comparisons'] for name, values in found.results.experiments.items()
        },
    })


def _claim(claim: Claim) -> dict[str, str | float]:
    return {
        'name': claim.name, 'statement': claim.statement, 'source': claim.source,
        'verdict': claim.verdict.name.lower(), 'p': claim.p_value, 'evidence': claim.evidence,
    }


def _localized(results: Results) -> dict[str, Any] | None:
    names = ('failed', 'judged', 'looked_into', 'counted', 'substitutions')
    found = results.localized
    return None if found is None else {name: found[name] for name in names}


def _records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table, with None for missing values."""
    return [
        {str(name): None if pd.isna(value) else value for name, value in line.items()}
        for line in frame.to_dict('records')
    ]


def _write_table(frame: pd.DataFrame, path: Path) -> None:
    write_table(path, frame)
