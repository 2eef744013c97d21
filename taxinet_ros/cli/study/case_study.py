"""``taxinet case-study``: reproduce the paper's case study, stage by stage."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import (
    AuditOption,
    ClusterOption,
    EngineOption,
    given_options,
    refuse_given,
)
from taxinet_ros.cli.show import line_console
from taxinet_ros.cli.study.stages import call_stage
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.study.stages.config import read_config, scaled, shipped_config
from taxinet_ros.study.stages.plan import COMMAND, read_study, stages, stages_until
from taxinet_ros.study.stages.run import (
    OPTIONS,
    StoppedError,
    StudyRun,
    list_lines,
    open_study,
    read_stages,
    study_heading,
)
from taxinet_ros.study.stages.stage import with_engine
from taxinet_ros.trials.cluster.pool import check_cluster
from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, make_out, new_folder


def case_study(
    context: typer.Context,
    config: Annotated[
        Path | None, typer.Option(metavar='FILE', help='YAML file of a study, with its numbers of '
        'images and runs (default: the shipped one)')
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(help='scale of the numbers of images and runs: 1 as in the paper, 0.02 for a '
        'smoke test of minutes'),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=8, help='worker processes; same results')
    ] = None,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    cluster: ClusterOption = None,
    out: Annotated[Path | None, typer.Option(help='folder of the study; must be new')] = None,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue the study in --out, with its own sizes')
    ] = False,
    until: Annotated[
        str | None, typer.Option(metavar='STAGE', help='last stage to run; --list names them')
    ] = None,
    listed: Annotated[
        bool, typer.Option('--list', help='print the stages, their commands and their progress')
    ] = False,
    report_only: Annotated[
        bool, typer.Option('--report-only', help='only write the report of the stages done in '
        '--out')
    ] = False,
    tables: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help="write the report from the tables in DIR (such as the "
        "shipped bags/), and check the paper's statements against them; runs nothing"),
    ] = None,
) -> int:
    """Run the paper's case study: falsify, debug, retrain, learn, report.

    Every stage does what a printed taxinet command does. Finished stages whose inputs are
    unchanged are kept; Ctrl-C ends a stage in order, and --resume continues. Exit codes: 0 done,
    130 interrupted, else that of the failed stage.
    """
    if tables is not None or report_only:
        from taxinet_ros.study.report.report import report_case_study  # pictures take time

        what, taken = ('--report-only', {'report_only', 'out'}) if tables is None else (
            '--tables', {'tables', 'out', 'config'})
        refuse_given(context, given_options(context).keys() - taken,
                     f'has no effect with {what}, which runs nothing')
        for line in report_case_study(out, config=config, tables=tables):
            line_console().print(line)
        return ExitCode.OK
    if resume and out is None:
        raise UsageError('--resume: name the case study to continue with --out')
    begun = resume or (listed and out is not None and (out / RECORD_NAME).exists())
    if begun and out is not None and config is None and scale is None:
        study = read_study(out, 'resume' if resume else 'list')
    else:
        study = scaled(read_config(config or shipped_config()), 1.0 if scale is None else scale)
    study = dataclasses.replace(study, workers=workers or study.workers)
    where = check_cluster(cluster) if cluster else ''
    wanted = with_engine(stages(study), engine, audit, where)
    if until:
        wanted = stages_until(wanted, until)
    show = line_console().print
    if listed:
        for line in list_lines(wanted, read_stages(out or Path('OUT')), out or Path('OUT')):
            show(line)
        return ExitCode.OK
    from taxinet_ros.nodes.running.domain import check_workers  # ROS takes time to import

    check_workers(study.workers)
    out = out or new_folder(DEFAULT_ROOT / COMMAND)
    if not resume:
        check_new(out)
    make_out(out)
    with open_study(out, show) as record:
        record.put(OPTIONS, COMMAND, dataclasses.asdict(study))
        show(study_heading(study, wanted, out))
        show(f'every stage runs in {out}')
        run = StudyRun(
            out, wanted, record=record, work=call_stage, workers=study.workers, show=show,
            again='--resume')
        try:
            run.run()
        except StoppedError as stopped:
            return stopped.code
    return ExitCode.OK
