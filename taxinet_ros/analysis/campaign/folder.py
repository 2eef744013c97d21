"""Output folder of an analysis: tables, pictures, programs of causes, ``analysis.json``, page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

from taxinet_ros.analysis.campaign.findings import BaselineComparison, Findings, explained_runs
from taxinet_ros.analysis.causes.causes import Cause
from taxinet_ros.analysis.causes.program import (
    cause_program,
    program_name,
    why_no_program,
    write_scenes_program,
)
from taxinet_ros.analysis.report.parts import Report, Table
from taxinet_ros.analysis.runs.campaign import CampaignRuns
from taxinet_ros.core.provenance import provenance
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import make_atomically, make_folder, write_atomically, write_parquet
from taxinet_ros.files.plain_values import plain
from taxinet_ros.files.sealed_json import read_sealed, write_sealed
from taxinet_ros.trials.record.table import CSV_NAME, PARQUET_NAME

SCHEMA, VERSION = 'taxinet-analysis', 1


def findings_values(findings: Findings, report: Report) -> dict[str, Any]:
    """All findings as plain values; shares are fractions 0..1, unknown or non-finite ones None.

    Args:
        findings: findings of an analysis.
        report: report on them.
    """
    return plain({
        'schema': SCHEMA, 'version': VERSION, 'title': report.title, 'facts': dict(report.facts),
        'summary': list(report.summary), 'alpha': findings.alpha,
        'made_on': dict(provenance()),
        'campaign': _campaign(findings.runs),
        'ranking': [
            {'feature': one.feature.name, 'information_bit': one.information_bit,
             'explained': one.explained, 'p': one.p} for one in findings.ranking
        ],
        'causes': [_cause(one) for one in findings.causes.found],
        'causes_why_not': findings.causes.why_not,
        'causes_searched': findings.causes.searched, 'scenes_again': findings.causes.again,
        'outside_causes': findings.causes.rest, 'candidates': findings.causes.candidates,
        'baselines': [_baseline(one) for one in findings.comparisons],
        'runs_to_look_at': report.runs,
    })


def _campaign(runs: CampaignRuns) -> dict[str, Any]:
    return {
        'label': runs.label, 'path': runs.path, 'program': runs.program,
        'perception': runs.perception, 'sampler': runs.sampler, 'spec': runs.spec,
        'stacks': [dict(stack) for stack in runs.stacks],
        'weighting': runs.weighting.value, 'judged': len(runs.frame),
        'without_verdict': dict(runs.others), 'undecided': runs.undecided,
        'uncounted': runs.uncounted, 'rate_bounds': list(runs.bounds),
        'stopped_early': runs.stopped, 'warnings': list(runs.warnings),
        'failed': runs.rate(), 'left_runway': runs.off_runway(),
    }


def _baseline(one: BaselineComparison) -> dict[str, Any]:
    return {
        **_campaign(one.baseline), 'difference': one.difference, 'paired': one.paired,
        'differing': one.differing, 'changed': one.changed, 'in_causes': one.in_causes,
        'outside_causes': one.off_causes,
    }


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        'rank': cause.rank, 'words': cause.region.words(),
        'region': cause.region.parts, 'inside': cause.inside,
        'outside': cause.outside, 'all_runs': cause.whole,
        'share': cause.share, 'explained': cause.added,
        'associated': dict(zip(('value', 'low', 'high'), cause.associated, strict=True)),
        'p': cause.p, 'p_is_bound': cause.p_is_bound,
    }


JSON_NAME, PAGE_NAME = 'analysis.json', 'report.html'
_TABLES = CSV_NAME, PARQUET_NAME


def check_folder(out: Path) -> None:
    """Check that an analysis may be written to ``out``.

    Raises:
        UsageError: it contains files that are not from an analysis.
    """
    if out.is_dir():
        if any(out.iterdir()) and _written_before(out) is None:
            raise UsageError(
                f'out {out}: contains files other than those of an analysis; choose a new folder')
    elif out.exists() or out.is_symlink():
        raise UsageError(f'out {out}: not a folder; choose another')


def write_analysis(
    findings: Findings, report: Report, out: Path, *,
    on_progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Write all results, replacing those of an earlier analysis.

    Args:
        findings: findings of the analysis.
        report: report on the findings.
        out: folder that passes :func:`check_folder`.
        on_progress: called with the name of each output.

    Returns:
        The values of ``analysis.json``.

    Raises:
        UsageError: the folder cannot be created.
        OSError: a file cannot be written.
    """
    from taxinet_ros.analysis.report.page import write_report

    _begin(out)
    others = _files(out)
    _write_runs(findings, out)
    runs = findings.runs
    for cause in () if why_no_program(runs) else findings.causes.found:
        write_scenes_program(runs, cause_program(runs, cause), out / program_name(cause))
    for section in report.sections:
        for table in section.tables:
            write_atomically(out / f'{table.name}.csv', csv_text(table))
    write_report(report, out / PAGE_NAME, on_progress=on_progress)
    files = sorted({*_files(out) - others, JSON_NAME})
    values = {**findings_values(findings, report), 'files': files}
    write_sealed(out / JSON_NAME, values, [out / name for name in files if name in _TABLES])
    return values


def csv_text(table: Table) -> str:
    """A table as CSV with a header; unknown cells are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow([column.name for column in table.columns])
    writer.writerows(table.rows)
    return text.getvalue()


def json_text(values: dict[str, Any]) -> str:
    """Text of ``analysis.json``."""
    return json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + '\n'


def _begin(out: Path) -> None:
    """Create the folder, remove the files of an earlier analysis, and mark it."""
    try:
        make_folder(out)
        for name in _written_before(out) or ():
            path = PurePosixPath(name)
            if not path.is_absolute() and '..' not in path.parts:
                (out / path).unlink(missing_ok=True)
        claim = {'schema': SCHEMA, 'version': VERSION, 'files': [JSON_NAME]}
        write_sealed(out / JSON_NAME, claim)
    except OSError as error:
        raise UsageError(f'out {out}: cannot be written: {error.strerror}') from error


def _write_runs(findings: Findings, out: Path) -> None:
    """All judged runs with their causes, as CSV and Parquet."""
    frame = explained_runs(findings)
    make_atomically(out / CSV_NAME, lambda path: frame.to_csv(path, index=False))
    write_parquet(out / PARQUET_NAME, frame)


def _written_before(out: Path) -> list[str] | None:
    """The files written there by an earlier analysis; None if there was none."""
    try:
        values = read_sealed(out / JSON_NAME).values
    except (OSError, UsageError):
        return None
    if values.get('schema') != SCHEMA:
        return None
    return [str(name) for name in values.get('files', ())]


def _files(out: Path) -> set[str]:
    return {path.relative_to(out).as_posix() for path in out.rglob('*') if path.is_file()}
