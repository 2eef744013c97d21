"""``taxinet monitor``: evaluate requirements on recorded runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import BoundOption, JsonOption, RateOption, RunOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.analysis.one_run.judged import RequirementNotes
    from taxinet_ros.bag.check.judge import JudgedBag
    from taxinet_ros.core.mtl import Assumptions, Spec


def monitor(
    bags: Annotated[
        list[Path],
        typer.Argument(
            metavar='BAG...', help='folders of runs, .mcap files, or folders of campaigns'
        ),
    ],
    spec: Annotated[
        list[str] | None,
        typer.Option(
            '--spec', metavar='FORMULA',
            help='phi_eventually, phi_always, on_runway, usable, NAME=FORMULA, a formula, or a '
            "YAML file of them; repeatable; default: the run's own",
        ),
    ] = None,
    run_id: RunOption = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE.png|DIR', writable=True,
            help='PNG plot of signals, bounds and robustness over time; a folder for several bags',
        ),
    ] = None,
    bound: BoundOption = None,
    rate: RateOption = None,
    add: Annotated[
        bool, typer.Option('--add', help="add a column for each new formula to a campaign's table")
    ] = False,
    explain: Annotated[
        bool,
        typer.Option(
            '--explain', help='robustness of each part of a formula, and the sample that decides'
        ),
    ] = False,
    as_json: JsonOption = False,
    workers: Annotated[int, typer.Option(min=1, help='worker processes; same results')] = 2,
) -> int:
    """Judge recorded runs by their own requirements or by new ones.

    Needs neither ROS nor camera frames. A bag of several runs, as written by ros2 bag record, gets
    one verdict per run. Re-evaluating a run's own formula reproduces the recorded robustness bit
    for bit. Exit codes: 0 all satisfied, 1 some violated, 2 bad input, 3 some bag is incomplete,
    damaged or inconsistent with its recorded verdict.
    """
    from taxinet_ros.analysis.one_run.judged import (
        RequirementNotes,
        check_others_there,
        judged_json,
        summary_lines,
    )
    from taxinet_ros.core.mtl import parse_spec
    from taxinet_ros.trials.past_runs.added_requirements import (
        add_requirements,
        addable,
        bags_at,
    )
    from taxinet_ros.trials.requirements import check_assumptions, read_specs

    chosen = [parse_spec(text) for text in read_specs(spec or ())]
    vouched = check_assumptions(bound or (), rate or (), chosen) if bound or rate else None
    found = {place: bags_at(place) for place in bags}
    paths = list(dict.fromkeys(bag for group in found.values() for bag in group))
    if run_id is not None and len(paths) > 1:
        raise UsageError(f'--run {run_id}: {len(paths)} bags given; name the one with this run')
    check_others_there(chosen, paths)
    to_add = {place: addable(place, chosen) for place in bags} if add else {}
    if add and not chosen:
        raise UsageError('--add: name the requirement to add with --spec')
    told = RequirementNotes(chosen)
    if plot is not None:
        from taxinet_ros.analysis.one_run.robustness import check_one_run, check_plot, draw_bag

        check_plot(plot, paths)
    judged = _judged(
        paths, chosen, workers, vouched, as_json=as_json, named=bags, run=run_id, told=told,
        explain=explain,
    )
    if plot is not None:
        check_one_run(plot, judged)
    notes = []
    for place, new in to_add.items():
        counts = add_requirements(place, new, {bag.path: bag for bag in judged if not bag.run})
        notes += [f'{place}: rho_{name} added for {count} runs' for name, count in counts.items()]
    if plot is not None:
        notes += [f'picture: {draw_bag(bag, vouched, plot)}' for bag in judged
                  if bag.verdicts and bag.end_s >= 0]
    if as_json:
        print_json(judged_json(judged, told.warnings))
    else:
        lines = summary_lines(judged) if len(judged) > 1 else []
        for line in (*lines, *notes):
            line_console().print(line)
    return _exit_code(judged)


def _judged(
    bags: Sequence[Path], specs: Sequence[Spec], workers: int, vouched: Assumptions | None, *,
    as_json: bool, named: Sequence[Path], run: str | None, told: RequirementNotes, explain: bool,
) -> list[JudgedBag]:
    """Judge all bags and print each verdict as soon as it is available."""
    from taxinet_ros.analysis.one_run.judged import bag_lines, check_own_read
    from taxinet_ros.bag.check.judge import judge_bags
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.trials.past_runs.recorded_campaign import BagPlaces

    console = line_console(stderr=as_json)
    chosen = None if run is None else open_recording(bags[0]).choose(run).name
    if vouched is not None and not specs:
        check_own_read(vouched, bags, chosen)
    judged: list[JudgedBag] = []
    places = BagPlaces()
    with stage_bars(console) as show:
        for bag in judge_bags(bags, specs, workers, vouched, explained=explain):
            if bag.foreign and bag.path in named:
                raise UsageError(bag.trouble)
            if chosen is not None and bag.run not in ('', chosen):
                continue
            if bag.verdicts and not bag.run:
                places.check(bag.path, whole=not bag.trouble)
            judged.append(bag)
            news = told.of(bag)
            if not as_json:
                for line in (*news, *bag_lines(bag)):
                    console.print(line)
            if len(bags) > 1:
                show('judging', len({one.path for one in judged}), len(bags))
    if not judged:
        raise UsageError(f'--run {run}: no step of it in {bags[0]}')
    return judged


def _exit_code(bags: Iterable[JudgedBag]) -> int:
    judged = list(bags)
    violated = [bag for bag in judged if any(one.verdict.failed for one in bag.verdicts)]
    # A recording of several runs usually ends during the last one; the others remain valid. A
    # missing topic does not invalidate the others; damage leaves no verdict at all.
    if any(bag.run or bag.trouble for bag in violated):
        return ExitCode.VIOLATED
    if not all(bag.sound for bag in judged):
        return ExitCode.INCOMPLETE
    return ExitCode.VIOLATED if violated else ExitCode.OK
