"""``taxinet why``: find out why a campaign or a run failed, and what to do."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import (
    AuditOption,
    ClusterOption,
    EngineOption,
    ExaminedOption,
    JsonOption,
)
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import json_text
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.trials.options import DEFAULT_ROOT, make_out

if TYPE_CHECKING:
    from taxinet_ros.analysis.report.parts import Section
    from taxinet_ros.study.stages.stage import Stage
    from taxinet_ros.study.why.verdict import Verdict


def why(
    path: Annotated[
        Path, typer.Argument(
            metavar='CAMPAIGN|RUN', help="a campaign's folder, or the bag of a run"
        )
    ],
    budget: Annotated[
        int, typer.Option(metavar='RUNS', help='about how many runs to make: a third to drive '
        'failed runs again, a fifth to shrink the worst one, the others in experiments')
    ] = 400,
    perception: Annotated[
        str | None, typer.Option(metavar='FILE', help="the runs' network, if its file has moved")
    ] = None,
    spec: ExaminedOption = None,
    workers: Annotated[
        int, typer.Option(min=1, max=8, help='worker processes; same results')
    ] = 2,
    engine: EngineOption = 'loop',
    audit: AuditOption = None,
    cluster: ClusterOption = None,
    out: Annotated[
        Path | None, typer.Option(help='folder for page and evidence (default: bags/NAME-why); '
        'what is done in it is kept')
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Find out why a campaign or a run failed, and what to do.

    Analyzes the failures, drives some again with perfect estimates, explains the worst run of each
    cause, shrinks one, and tests what is suspected on fresh scenes. Says in three sentences whether
    network, controller or requirement is at fault, and how sure that is; writes one page with links
    to all evidence, and the command that fixes it. After an interrupt, the same command continues.
    Exit codes: 0 a verdict, 3 unclear, 130 interrupted.
    """
    # These take seconds to import, which --help need not wait for.
    from taxinet_ros.analysis.report.page import write_report_page
    from taxinet_ros.cli.study.stages import call_stage
    from taxinet_ros.study.stages.run import StoppedError, StudyRun, claim_study, open_study
    from taxinet_ros.study.stages.stage import with_engine
    from taxinet_ros.study.why import verdict as found
    from taxinet_ros.study.why.investigation import Investigation, kind_of
    from taxinet_ros.study.why.plan import Budget
    from taxinet_ros.trials.cluster.pool import check_cluster

    console = line_console(stderr=as_json)
    asked = Budget(runs=budget)  # checked before anything is made
    with_engine((), engine, audit)
    where = check_cluster(cluster) if cluster else ''
    kind = kind_of(path)
    subject, path = path, path.absolute()
    name = '-'.join(filter(None, (path.resolve().stem, 'why', spec)))
    out = (out or DEFAULT_ROOT / name).absolute()
    if out.is_dir() and any(out.iterdir()) and not (out / RECORD_NAME).is_file():
        raise UsageError(f'--out {_near(out)}: contains something else; choose another folder')
    make_out(out)

    show = console.print
    show(f'why {kind} {subject}: at most about {budget} runs -> {_near(out)}')
    with open_study(out, show) as record:
        claim_study(record, 'why', {
            'path': str(path), **({'spec': spec} if spec else {}),
        })
        (out / 'logs').mkdir(exist_ok=True)
        numbers, began = itertools.count(1), time.monotonic()

        def run_stages(stages: Sequence[Stage]) -> Mapping[str, str]:
            sitting = StudyRun(
                out, with_engine(stages, engine, audit, where), record=record,
                work=call_stage, workers=workers, show=show, folder=Path.cwd(),
                logs=out / 'logs', again='the same command', numbers=numbers, began=began,
            )
            sitting.run()
            return sitting.refused

        work = Investigation(
            path=path, out=out, perception=perception, spec=spec, budget=asked,
            workers=workers, run_stages=run_stages,
        )
        try:
            evidence = work.evidence()
        except StoppedError as stopped:
            return stopped.code
        record.check_in_place()
        verdict = found.judge(evidence)
        todo = found.todo_of(evidence, verdict, path, kind)
        page = out / found.PAGE_NAME
        write_report_page(found.why_report(evidence, verdict, todo, out), page)
        values = found.why_json(evidence, verdict, todo)
        write_atomically(out / found.JSON_NAME, json_text(values) + '\n')
    if as_json:
        print_json(values)
    else:
        _print(show, verdict, todo, page)
    unclear = verdict.fault in (found.Fault.UNCLEAR, found.Fault.BENCH)
    return ExitCode.INCOMPLETE if unclear else ExitCode.OK


def _print(
    show: Callable[[str], None], verdict: Verdict, todo: Sequence[Section], page: Path
) -> None:
    show('')
    for sentence in verdict.sentences:
        show(sentence)
    for action in todo:
        show('')
        show(' '.join(action.sentences))
        for command in action.commands:
            show(f'  {command}')
    show('')
    show(f'page: {_near(page)}')


def _near(path: Path) -> str:
    """A path relative to the current folder if it lies in it."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)
