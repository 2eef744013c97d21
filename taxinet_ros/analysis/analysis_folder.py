"""The folder of an analysis: tables, pictures, ``analysis.json`` and the page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

from taxinet_ros.analysis.cause_program import cause_program, program_name
from taxinet_ros.analysis.counterexamples import explained_runs
from taxinet_ros.analysis.findings import Findings
from taxinet_ros.analysis.findings_json import SCHEMA, VERSION, findings_values
from taxinet_ros.analysis.picture_files import LIGHT, write_png
from taxinet_ros.analysis.report_parts import Report, Table
from taxinet_ros.bag.layout import write_atomically, write_whole
from taxinet_ros.campaign.sealed_json import read_sealed, write_sealed
from taxinet_ros.campaign.table import CSV_NAME, PARQUET_NAME
from taxinet_ros.core.errors import UsageError

JSON_NAME, PAGE_NAME = 'analysis.json', 'report.html'
_TABLES = CSV_NAME, PARQUET_NAME


def check_folder(out: Path) -> None:
    """See that an analysis may be written to ``out``.

    Raises:
        UsageError: there is something else, which no analysis has put there.
    """
    if out.is_dir():
        if any(out.iterdir()) and _written_before(out) is None:
            raise UsageError(
                f'--out {out}: holds other files than those of an analysis; name a new folder')
    elif out.exists() or out.is_symlink():
        raise UsageError(f'--out {out}: not a folder; name another')


def write_analysis(
    findings: Findings, report: Report, out: Path, *,
    on_progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Write everything, in place of what an earlier analysis has written there.

    Args:
        findings: of the analysis.
        report: on them.
        out: folder, for which :func:`check_folder` has nothing to say.
        on_progress: is told what is being written.

    Returns:
        The values of ``analysis.json``.

    Raises:
        UsageError: the folder cannot be made.
        BagWriteError: a file cannot be written.
    """
    from taxinet_ros.analysis.report_page import write_report_page

    _begin(out)
    others = _files(out)
    _write_runs(findings, out)
    for cause in findings.causes.found:
        if (program := cause_program(findings.runs, cause)) is not None:
            write_atomically(out / program_name(cause), program)
    for section in report.sections:
        for table in section.tables:
            write_atomically(out / f'{table.name}.csv', csv_text(table))
        for picture in section.pictures:
            on_progress(f'picture {picture.name}')
            write_png(picture, out, LIGHT)
    write_report_page(report, out / PAGE_NAME, on_progress=on_progress)
    files = sorted({*_files(out) - others, JSON_NAME})
    values = {**findings_values(findings, report), 'files': files}
    write_sealed(out / JSON_NAME, values, [out / name for name in files if name in _TABLES])
    return values


def csv_text(table: Table) -> str:
    """A table as CSV with a header; empty cells are not known."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow([column.name for column in table.columns])
    writer.writerows(table.rows)
    return text.getvalue()


def json_text(values: dict[str, Any]) -> str:
    """Text of ``analysis.json``."""
    return json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + '\n'


def _begin(out: Path) -> None:
    """Make the folder, remove what an earlier analysis has written, and claim it."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name in _written_before(out) or ():
            path = PurePosixPath(name)
            if not path.is_absolute() and '..' not in path.parts:
                (out / path).unlink(missing_ok=True)
        claim = {'schema': SCHEMA, 'version': VERSION, 'files': [JSON_NAME]}
        write_sealed(out / JSON_NAME, claim)
    except OSError as error:
        raise UsageError(f'--out {out}: cannot be written: {error.strerror}') from error


def _write_runs(findings: Findings, out: Path) -> None:
    """All judged runs with cause and group: as CSV for people, as Parquet for programs."""
    frame = explained_runs(findings)
    write_whole(out / CSV_NAME, lambda path: frame.to_csv(path, index=False))
    write_whole(out / PARQUET_NAME, lambda path: frame.to_parquet(path, index=False))


def _written_before(out: Path) -> list[str] | None:
    """The files that an earlier analysis has written there; None if there was none."""
    try:
        values = read_sealed(out / JSON_NAME).values
    except (OSError, UsageError):
        return None
    if values.get('schema') != SCHEMA:
        return None
    return [str(name) for name in values.get('files', ())]


def _files(out: Path) -> set[str]:
    return {path.relative_to(out).as_posix() for path in out.rglob('*') if path.is_file()}
