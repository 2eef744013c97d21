"""``taxinet improve``: rounds of falsification and retraining, and their decisions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from taxinet_ros.cli.options import (
    AuditOption,
    ClusterOption,
    EngineOption,
    VariedOption,
    given_options,
    refuse_given,
)
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import json_text
from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, make_out, new_folder

if TYPE_CHECKING:
    from taxinet_ros.study.stages.stage import Stage

ROUNDS_NAME = 'rounds.json'
"""The rounds of the record, to read."""


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
) -> int:
    """Improve a network in rounds: falsify, cluster failures, retrain, evaluate, keep if better.

    Every stage does what a printed taxinet command does. Exit codes: 0 done, 130 interrupted,
    else that of the failed stage.
    """
    # These take seconds to import, which --help need not wait for.
    from taxinet_ros.cli.study.stages import call_stage
    from taxinet_ros.nodes.running.domain import check_workers
    from taxinet_ros.study.improve.loop import (
        BEST,
        COMMAND,
        ImproveOptions,
        improve_network,
        resumed,
    )
    from taxinet_ros.study.stages.run import OPTIONS, StoppedError, StudyRun, open_study
    from taxinet_ros.study.stages.stage import with_engine
    from taxinet_ros.trials.cluster.pool import check_cluster

    if resume:
        others = given_options(context).keys() - {
            'out', 'workers', 'resume', 'engine', 'audit', 'cluster',
        }
        refuse_given(context, others, 'is taken from the folder that --resume continues')
    asked = None if resume else ImproveOptions(
        program=program, start=start, rounds=rounds, budget=budget, base=base, images=images,
        validation=validation, counterexamples=counterexamples, add=tuple(add or ()),
        epochs=epochs, learning_rate=learning_rate, varied=varied, sampler=sampler, alpha=alpha,
        margin=margin, seed=seed, workers=workers,
    )
    with_engine((), engine, audit)  # checks them before anything is made
    where = check_cluster(cluster) if cluster else ''
    if asked is not None:
        check_workers(asked.workers)
    if asked is None:
        if out is None:
            raise UsageError('--resume: name the folder to continue with --out')
        options, folder = resumed(out, workers), out
    else:
        options, folder = asked.checked(), out or new_folder(DEFAULT_ROOT / COMMAND)
        check_new(folder)
        make_out(folder)
    check_workers(options.workers)
    show = line_console().print
    made: list[dict[str, Any]] = []
    with open_study(folder, show) as record:
        if OPTIONS not in record.entries:
            record.put(OPTIONS, COMMAND, dataclasses.asdict(options))
        show(
            f'improve {options.start} on {options.program}: at most {options.rounds} rounds of 3 '
            f'times {options.runs:,} runs -> {folder}'
        )
        show(f'every stage runs in {folder}')

        def run_stages(stages: Sequence[Stage]) -> None:
            StudyRun(
                folder, with_engine(stages, engine, audit, where), record=record, work=call_stage,
                workers=options.workers, show=show, again='--resume',
            ).run()

        try:
            for done in improve_network(folder, options, run_stages):
                made.append(done.to_json())
                record.put('round', str(done.number), made[-1])
                write_atomically(folder / ROUNDS_NAME, json_text(made) + '\n')
                for line in ('', *done.lines(options.rounds)):
                    show(line)
        except StoppedError as stopped:
            return stopped.code
    show(f'network: {folder / BEST}; decisions of the rounds: {folder / ROUNDS_NAME}')
    return ExitCode.OK
