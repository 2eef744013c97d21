"""``taxinet case-study``: reproduce the paper's case study, stage by stage."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from taxinet_ros.campaign.cluster.connection import check_cluster
from taxinet_ros.campaign.options import DEFAULT_ROOT, GRAPH, check_new, make_out, new_folder
from taxinet_ros.cli.study.stages import call_stage
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.study.stages.config import (
    StudyConfig,
    read_config,
    resized,
    scaled,
    shipped_config,
    study_of,
)
from taxinet_ros.study.stages.plan import stages, stages_until
from taxinet_ros.study.stages.progress import list_lines, study_heading
from taxinet_ros.study.stages.record import OPTIONS, open_study, read_options, read_stages
from taxinet_ros.study.stages.run import StudyRun
from taxinet_ros.study.stages.stage import Stage, with_engine

_COMMAND = 'case-study'


@dataclass(frozen=True, kw_only=True)
class CaseStudyOptions:
    """Options of ``taxinet case-study``.

    Attributes:
        config: configuration file; None: the shipped one, or with ``resume`` the study's own.
        scale, runs, images, workers: sizes; None: the file's.
        out: folder of the study, or None for a new one.
        resume: continue the study in ``out``.
        until: name of the last stage to run; None for all.
        listed: print the stages only.
        report_only: only write the report of the stages done.
        tables: folder of tables to write the report of, or None.
        engine, audit: what makes the runs, and share of them to audit as text or None.
        cluster: a Dask cluster that makes the runs of campaigns, or None.
    """

    config: Path | None = None
    scale: float | None = None
    runs: int | None = None
    images: int | None = None
    workers: int | None = None
    out: Path | None = None
    resume: bool = False
    until: str | None = None
    listed: bool = False
    report_only: bool = False
    tables: Path | None = None
    engine: str = GRAPH
    audit: str | None = None
    cluster: str | None = None


def run_case_study(options: CaseStudyOptions) -> int:
    """Run the study or the requested part, and print progress.

    Returns:
        Exit code: 0 done, 130 interrupted, else that of the stage that failed.

    Raises:
        UsageError: bad input.
    """
    if options.tables is not None:
        return _report_tables(options, options.tables)
    if options.report_only:
        return _report(options)
    console = Console(highlight=False)
    config = _config(options)
    where = check_cluster(options.cluster) if options.cluster else ''
    found = with_engine(stages(config), options.engine, options.audit, where)
    wanted = stages_until(found, options.until) if options.until else found
    if options.listed:
        out = options.out or Path('OUT')
        for line in list_lines(wanted, read_stages(out), out):
            console.print(line, soft_wrap=True, markup=False)
        return ExitCode.OK
    from taxinet_ros.nodes.running.domain import check_workers  # ROS takes time to import

    check_workers(config.workers)
    out = options.out or new_folder(DEFAULT_ROOT / 'case-study')
    if not options.resume:
        check_new(out)
    return _run(config, wanted, out, console)


def _run(config: StudyConfig, wanted: tuple[Stage, ...], out: Path, console: Console) -> int:
    def show(line: str) -> None:
        console.print(line, soft_wrap=True, markup=False)

    make_out(out)
    with open_study(out, show) as record:
        record.put(OPTIONS, _COMMAND, dataclasses.asdict(config))
        show(study_heading(config, wanted, out))
        show(f'every stage runs in {out}')
        return StudyRun(
            out, wanted, record=record, work=call_stage, workers=config.workers, show=show,
        ).run()


def _begun(out: Path, option: str) -> StudyConfig:
    """The configuration of the study in a folder."""
    return study_of(read_options(out, _COMMAND, option))


def _config(options: CaseStudyOptions) -> StudyConfig:
    if options.resume and options.out is None:
        raise UsageError('--resume: name the case study to continue with --out')
    begun = options.out is not None and (
        options.resume or (options.listed and (options.out / RECORD_NAME).exists())
    )
    if begun and options.config is None and options.scale is None:
        assert options.out is not None
        config = _begun(options.out, '--resume' if options.resume else '--list')
    else:
        config = read_config(options.config or shipped_config())
        config = scaled(config, 1.0 if options.scale is None else options.scale)
    return resized(
        config, runs=options.runs, images=options.images, workers=options.workers
    )


def _report(options: CaseStudyOptions) -> int:
    _check_alone(options, '--report-only', taken=('out',))
    if options.out is None:
        raise UsageError('--report-only: name the case study with --out')
    config = _begun(options.out, '--report-only')
    from taxinet_ros.study.report.report import write_study_report  # pictures take time to import

    for line in write_study_report(config, options.out):
        Console(highlight=False).print(line, soft_wrap=True, markup=False)
    return ExitCode.OK


def _report_tables(options: CaseStudyOptions, tables: Path) -> int:
    """Write the report of the tables to a new folder."""
    _check_alone(options, f'--tables {tables}', taken=('out', 'config'))
    config = read_config(options.config or shipped_config())
    out = options.out or new_folder(DEFAULT_ROOT / 'case-study')
    check_new(out)
    from taxinet_ros.study.report.report import write_study_report  # pictures take time to import

    for line in write_study_report(config, out, tables):
        Console(highlight=False).print(line, soft_wrap=True, markup=False)
    return ExitCode.OK


def _check_alone(options: CaseStudyOptions, what: str, *, taken: Collection[str]) -> None:
    """Refuse options other than those taken by one that only writes a report."""
    given = {
        '--config': options.config, '--scale': options.scale, '--runs': options.runs,
        '--images': options.images, '--workers': options.workers, '--until': options.until,
        '--resume': options.resume, '--list': options.listed,
        '--engine': options.engine != GRAPH, '--audit': options.audit, '--cluster': options.cluster,
        '--report-only': options.report_only and not what.startswith('--report-only'),
    }
    for name, value in given.items():
        if value not in (None, False) and name.removeprefix('--') not in taken:
            raise UsageError(f'{what}: runs nothing; leave {name} out')

