"""Commands on whole studies: ``why``, ``case-study``, ``improve``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import (
    AuditOption,
    ClusterOption,
    EngineOption,
    JsonOption,
    VariedOption,
    given_options,
    refuse_given,
)


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
) -> None:
    """Find out why a campaign or a run failed, and what to do.

    Analyzes the failures, drives some again with perfect estimates, explains the worst run of each
    cause, shrinks one, and tests what is suspected on fresh scenes. Says in three sentences whether
    network, controller or requirement is at fault, and how sure that is; writes one page with links
    to all evidence, and the command that mends it. After an interrupt, the same command continues.
    Exit codes: 0 a verdict, 3 unclear, 130 interrupted.
    """
    from taxinet_ros.cli.study.why import WhyOptions, run_why

    raise typer.Exit(run_why(WhyOptions(
        path=path, perception=perception, budget=budget, workers=workers, engine=engine,
        audit=audit, cluster=cluster, out=out, as_json=as_json,
    )))


def case_study(
    config: Annotated[
        Path | None, typer.Option(metavar='FILE', help='YAML file of a study (default: the shipped '
        'one)')
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(help='scale of the numbers of images and runs: 1 as in the paper, 0.02 for a '
        'smoke test of minutes'),
    ] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help='evaluation scenes per network')
    ] = None,
    images: Annotated[
        int | None, typer.Option(min=1, help='training images per network')
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
) -> None:
    """Run the paper's case study: falsify, debug, retrain, learn, report.

    Every stage does what a printed taxinet command does. Finished stages whose inputs are
    unchanged are kept; Ctrl-C ends a stage in order, and --resume continues. Exit codes: 0 done,
    130 interrupted, else that of the failed stage.
    """
    from taxinet_ros.cli.study.case_study import CaseStudyOptions, run_case_study

    raise typer.Exit(run_case_study(CaseStudyOptions(
        config=config, scale=scale, runs=runs, images=images, workers=workers, out=out,
        resume=resume, until=until, listed=listed, report_only=report_only, tables=tables,
        engine=engine, audit=audit, cluster=cluster,
    )))


def improve(
    context: typer.Context,
    program: Annotated[
        str, typer.Argument(metavar='[SCENARIO]', help='program whose scenes the network should '
        'handle')
    ] = 's_falsif',
    start: Annotated[str, typer.Option(help='initial network: word or file')] = 'taxinet',
    rounds: Annotated[int, typer.Option(help='most rounds')] = 3,
    budget: Annotated[
        int, typer.Option(help='runs of all rounds: one third each for the search, the old and the '
        'new network')
    ] = 3600,
    base: Annotated[
        str, typer.Option(help='program whose images are trained on in addition to the failures')
    ] = 'training_full',
    images: Annotated[int, typer.Option(help='images of it per round')] = 12_000,
    validation: Annotated[int, typer.Option(help='additional validation images')] = 1_500,
    counterexamples: Annotated[
        int, typer.Option(help="images along each round's failed runs")
    ] = 4_000,
    add: Annotated[
        list[str] | None,
        typer.Option(metavar='PROGRAM=COUNT', help='additional image folder; repeatable'),
    ] = None,
    epochs: Annotated[int, typer.Option(help='epochs')] = 8,
    learning_rate: Annotated[float, typer.Option(help='maximum learning rate of the '
    'schedule')] = 1e-3,
    varied: VariedOption = False,
    sampler: Annotated[str, typer.Option(help='sampler of the searches for failures')] = 'ce',
    alpha: Annotated[
        float,
        typer.Option(help='probability of accepting a network that is not better, or worse by a '
        'margin'),
    ] = 0.05,
    margin: Annotated[
        float, typer.Option(help='tolerated increase of failures, as a share of all scenes')
    ] = 0.01,
    place_margin: Annotated[
        float, typer.Option(help='the same within any part of runway, day, pose or sky')
    ] = 0.05,
    seed: Annotated[int, typer.Option(help='random seed')] = 1,
    workers: Annotated[
        int, typer.Option(min=1, max=8, help='worker processes; same results')
    ] = 2,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    cluster: ClusterOption = None,
    out: Annotated[Path | None, typer.Option(help='folder; must be new')] = None,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue in --out, with its own options')
    ] = False,
) -> None:
    """Improve a network in rounds: falsify, cluster failures, retrain, evaluate, keep if better.

    Every stage does what a printed taxinet command does. Exit codes: 0 done, 130 interrupted,
    else that of the failed stage.
    """
    from taxinet_ros.cli.study.improve import run_improve
    from taxinet_ros.study.improve.options import ImproveOptions

    if resume:
        others = given_options(context).keys() - {
            'out', 'workers', 'resume', 'engine', 'audit', 'cluster',
        }
        refuse_given(context, others, 'is taken from the folder that --resume continues')
    options = None if resume else ImproveOptions(
        program=program, start=start, rounds=rounds, budget=budget, base=base, images=images,
        validation=validation, counterexamples=counterexamples, add=tuple(add or ()),
        epochs=epochs, learning_rate=learning_rate, varied=varied, sampler=sampler, alpha=alpha,
        margin=margin, place_margin=place_margin, seed=seed, workers=workers,
    )
    raise typer.Exit(run_improve(options, out, workers, engine, audit, cluster))
