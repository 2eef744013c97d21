"""The commands that run many others: ``taxinet case-study`` and ``taxinet improve``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import VariedOption


def case_study(
    config: Annotated[
        Path | None, typer.Option(metavar='FILE', help='YAML file of a study; else the shipped one')
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(help='of images and runs: 1 as in the paper, 0.02 a smoke run of minutes'),
    ] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help='scenes that every network is evaluated on')
    ] = None,
    images: Annotated[
        int | None, typer.Option(min=1, help='pictures that every network learns from')
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=8, help='processes that work at once; same results')
    ] = None,
    out: Annotated[Path | None, typer.Option(help='folder of the study; must be new')] = None,
    resume: Annotated[
        bool, typer.Option('--resume', help='go on with the study in --out, with its own sizes')
    ] = False,
    until: Annotated[
        str | None, typer.Option(metavar='STAGE', help='the last stage to do; --list names them')
    ] = None,
    listed: Annotated[
        bool, typer.Option('--list', help='print the stages, their commands, and how far they are')
    ] = False,
    report_only: Annotated[
        bool, typer.Option('--report-only', help='write the report of what is done in --out')
    ] = False,
    tables: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='write the report of the tables in DIR, as the shipped '
                     "bags/, and judge the paper's statements by them; runs nothing"),
    ] = None,
) -> None:
    """Run the paper's case study: falsify, debug, retrain, learn, report.

    Every stage is a taxinet command that you may run yourself. What is done and still fits its
    inputs is kept; Ctrl-C ends a stage in order, and --resume goes on. Exit codes: 0 done, 130
    interrupted, else that of the stage that failed.
    """
    from taxinet_ros.cli.study.case_study import CaseStudyOptions, run_case_study

    raise typer.Exit(run_case_study(CaseStudyOptions(
        config=config, scale=scale, runs=runs, images=images, workers=workers, out=out,
        resume=resume, until=until, listed=listed, report_only=report_only, tables=tables,
    )))


def improve(
    program: Annotated[
        str, typer.Argument(metavar='[SCENARIO]', help='where the network has to do well')
    ] = 's_falsif',
    start: Annotated[str, typer.Option(help='network to begin with: word or file')] = 'taxinet',
    rounds: Annotated[int, typer.Option(help='most rounds')] = 3,
    budget: Annotated[
        int, typer.Option(help='runs of all rounds; a third each to search, to judge old and new')
    ] = 3600,
    base: Annotated[
        str, typer.Option(help='program whose pictures are learned beside the failures')
    ] = 'training_full',
    images: Annotated[int, typer.Option(help='pictures of it in every round')] = 12_000,
    validation: Annotated[int, typer.Option(help='further ones held back')] = 1_500,
    counterexamples: Annotated[
        int, typer.Option(help="pictures along each round's failed runs")
    ] = 4_000,
    add: Annotated[
        list[str] | None,
        typer.Option(metavar='PROGRAM=COUNT', help='further pictures; repeatable'),
    ] = None,
    epochs: Annotated[int, typer.Option(help='passes over the training pictures')] = 8,
    learning_rate: Annotated[float, typer.Option(help='highest of the schedule')] = 1e-3,
    varied: VariedOption = False,
    sampler: Annotated[str, typer.Option(help='sampler of the searches for failures')] = 'ce',
    alpha: Annotated[
        float,
        typer.Option(help='probability of accepting a network that is no better, or worse by a '
                     'margin'),
    ] = 0.05,
    margin: Annotated[
        float, typer.Option(help='failures more that count as none, as a share of all scenes')
    ] = 0.01,
    place_margin: Annotated[
        float, typer.Option(help='the same of the scenes in a part of runway, day, pose or sky')
    ] = 0.05,
    seed: Annotated[int, typer.Option(help='seed of all random choices')] = 1,
    workers: Annotated[
        int, typer.Option(min=1, max=8, help='processes that work at once; same results')
    ] = 2,
    out: Annotated[Path | None, typer.Option(help='folder; must be new')] = None,
    resume: Annotated[
        bool, typer.Option('--resume', help='go on in --out, with its own options')
    ] = False,
) -> None:
    """Improve a network in rounds: falsify, group failures, learn from them, judge, keep if better.

    Every stage is a taxinet command that you may run yourself. Exit codes: 0 done, 130 interrupted,
    else that of the stage that failed.
    """
    from taxinet_ros.cli.study.improve import run_improve
    from taxinet_ros.study.improve.options import ImproveOptions

    options = None if resume else ImproveOptions(
        program=program, start=start, rounds=rounds, budget=budget, base=base, images=images,
        validation=validation, counterexamples=counterexamples, add=tuple(add or ()),
        epochs=epochs, learning_rate=learning_rate, varied=varied, sampler=sampler, alpha=alpha,
        margin=margin, place_margin=place_margin, seed=seed, workers=workers,
    )
    raise typer.Exit(run_improve(options, out, workers))
