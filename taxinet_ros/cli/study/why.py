"""``taxinet why``: find out why a campaign or a run failed, and what to do."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from taxinet_ros.analysis.report.page import write_report_page
from taxinet_ros.campaign.cluster.connection import check_cluster
from taxinet_ros.campaign.options import DEFAULT_ROOT, make_out
from taxinet_ros.campaign.past_runs.recorded_campaign import open_campaign
from taxinet_ros.campaign.record.facts import is_campaign
from taxinet_ros.cli.study.stages import call_stage
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.study.stages.record import OPTIONS, STAGE, open_study
from taxinet_ros.study.stages.run import StudyRun
from taxinet_ros.study.stages.stage import Stage, with_engine
from taxinet_ros.study.why.investigation import Investigation, StoppedError, kind_of
from taxinet_ros.study.why.plan import Budget
from taxinet_ros.study.why.report import (
    JSON_NAME,
    PAGE_NAME,
    why_json,
    why_report,
)
from taxinet_ros.study.why.verdict import (
    Action,
    Evidence,
    Fault,
    Verdict,
    actions,
    judge,
)

_COMMAND = 'why'


@dataclass(frozen=True, kw_only=True)
class WhyOptions:
    """Options of ``taxinet why``.

    Attributes:
        path: campaign or run.
        perception: network, if its file has moved.
        budget: about how many runs to make.
        workers: processes.
        engine, audit: what makes the runs, and share of them to audit as text or None.
        cluster: a Dask cluster that makes the runs of campaigns, or None.
        out: folder; None: one below ``bags/`` named after the campaign or run.
        as_json: print ``why.json`` in place of the verdict.
    """

    path: Path
    perception: str | None
    budget: int
    workers: int
    engine: str
    audit: str | None
    cluster: str | None
    out: Path | None
    as_json: bool


def run_why(options: WhyOptions) -> int:
    """Run the stages that are not done, write the page and print the verdict.

    Returns:
        Exit code: 0 there is a verdict, 3 it is unclear or no run was judged, 130 interrupted;
        else that of the stage that broke.

    Raises:
        UsageError: bad input.
    """
    console = Console(highlight=False, stderr=options.as_json)
    budget = Budget(runs=options.budget)
    with_engine((), options.engine, options.audit)  # checks them before anything is made
    where = check_cluster(options.cluster) if options.cluster else ''
    path = options.path.absolute()
    kind = kind_of(path)
    out = (options.out or DEFAULT_ROOT / f'{path.resolve().stem}-why').absolute()
    if out.is_dir() and any(out.iterdir()) and not (out / RECORD_NAME).is_file():
        raise UsageError(f'--out {out}: contains something else; choose another folder')
    make_out(out)

    warned: set[str] = set()

    def show(line: str) -> None:
        # Every sitting of the stages would say again that others were made elsewhere.
        if line.startswith('begun ') and line in warned:
            return
        warned.add(line)
        console.print(line, soft_wrap=True, markup=False)

    show(f'why {kind} {options.path}: at most about {budget.runs} runs -> {_near(out)}')
    with open_study(out, show) as record:
        _claim(record, out, path)
        (out / 'logs').mkdir(exist_ok=True)

        def run_stages(stages: Sequence[Stage]) -> tuple[int, Mapping[str, str]]:
            sitting = StudyRun(
                out, with_engine(stages, options.engine, options.audit, where), record=record,
                work=call_stage, workers=options.workers, show=show, folder=Path.cwd(),
                logs=out / 'logs', again='the same command',
            )
            return sitting.run(), sitting.refused

        work = Investigation(
            path=path, out=out, perception=options.perception, budget=budget,
            workers=options.workers, run_stages=run_stages,
        )
        try:
            evidence = work.evidence()
        except StoppedError as stopped:
            return stopped.code
        record.check_in_place()
        verdict = judge(evidence)
        todo = tuple(_actions(evidence, verdict, path, kind))
        write_report_page(why_report(evidence, verdict, todo, out), out / PAGE_NAME)
        values = why_json(evidence, verdict, todo)
        write_atomically(out / JSON_NAME, json.dumps(values, indent=2, allow_nan=False) + '\n')
    if options.as_json:
        print(json.dumps(values, indent=2, allow_nan=False))
    else:
        _print(show, verdict, todo, out)
    unclear = verdict.fault in (Fault.UNCLEAR, Fault.BENCH)
    return ExitCode.INCOMPLETE if unclear else ExitCode.OK


def _print(
    show: Callable[[str], None], verdict: Verdict, todo: Sequence[Action], out: Path
) -> None:
    show('')
    for sentence in verdict.sentences:
        show(sentence)
    for action in todo:
        show('')
        show(action.words)
        for command in action.commands:
            show(f'  {command}')
    show('')
    show(f'page: {_near(out / PAGE_NAME)}')


def _actions(evidence: Evidence, verdict: Verdict, path: Path, kind: str) -> tuple[Action, ...]:
    campaign, kept = None, False
    folder = path if kind == 'campaign' else path.parent
    if is_campaign(folder):
        campaign = Path(_near(folder))
        recorded = open_campaign(folder)
        kept = any(recorded.bag(row) is not None for row in recorded.counterexamples)
    shown = _with_near_paths(evidence)
    return tuple(actions(
        shown, verdict.fault, campaign=campaign, kept_bags=kept,
    ))


def _with_near_paths(evidence: Evidence) -> Evidence:
    """The evidence with paths as one would type them."""
    causes = tuple(
        replace(
            cause, program=cause.program and Path(_near(cause.program)),
            bag=cause.bag and Path(_near(cause.bag)),
        ) for cause in evidence.causes
    )
    return replace(
        evidence, causes=causes, subject=_near(Path(evidence.subject)),
        scenes=evidence.scenes and Path(_near(evidence.scenes)),
        base=evidence.base and Path(_near(evidence.base)),
    )


def _claim(record: Record, out: Path, path: Path) -> None:
    """Note the subject of a new record, or check that it is about this one.

    Raises:
        UsageError: it is about something else.
    """
    mine, before = {'path': str(path)}, record.entries.get(OPTIONS, {})
    if before.get(_COMMAND, mine) != mine or (not before and record.entries.keys() - {STAGE}):
        raise UsageError(f'--out {out}: is about something else; choose another folder')
    record.put(OPTIONS, _COMMAND, mine)


def _near(path: Path) -> str:
    """A path relative to the current folder if it lies in it."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)
