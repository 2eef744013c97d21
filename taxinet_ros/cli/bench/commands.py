"""``taxinet bench``: arguments, options and help; implementations are imported on use."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import asks_for_study, given_options


def bench(
    context: typer.Context,
    subjects: Annotated[
        list[str] | None,
        typer.Argument(
            metavar='[SUBJECT]...',
            help='camera, inference, physics, monitor, samplers, loop, graph, start-up, campaign, '
            'or all except campaign (the default; 3 to 5 minutes on two cores); or soak; or chaos; '
            'or intervals [SAMPLER]...; or sequential; or rare [LANDSCAPE]...; '
            'or searches [SAMPLER|LANDSCAPE]...; or processors',
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(help='number of measurements of each subject, '
    'interleaved')] = 40,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
    compare: Annotated[
        Path | None, typer.Option(metavar='OLD.json', help='earlier JSON report to compare with')
    ] = None,
    peers: Annotated[
        str | None,
        typer.Option(metavar='PYTHON', help='Python interpreter with third-party monitors '
        'installed: measure them too'),
    ] = None,
    guard: Annotated[
        bool, typer.Option('--guard', help='exit 1 if a guarded ratio is out of bounds')
    ] = False,
    runs: Annotated[int | None, typer.Option(min=1, help='soak: number of runs (default 1000); '
    'processors: of scenes (default 40); screening: budget of a search (default 100, of a network '
    '20)')] = None,
    duration: Annotated[
        float | None,
        typer.Option(help='soak, processors: simulated length of each run (default 3) [s]'),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(help='soak, chaos: wall-clock limit (default 10 with --pid and for chaos) '
        '[min]')
    ] = None,
    pid: Annotated[
        int | None, typer.Option(min=1, help='soak: watch this process and its descendants instead')
    ] = None,
    seed: Annotated[int, typer.Option(help='chaos, rare: (first) random seed')] = 0,
    trials: Annotated[int | None, typer.Option(min=1, help='chaos: number of trials')] = None,
    trial: Annotated[int | None, typer.Option(min=0, help='chaos: run only this trial')] = None,
) -> None:
    """Benchmark every component on one core, or run soak and chaos tests.

    Prints medians, spreads and ratios: the closed loop with ROS 2 (composed or one process per
    node) and without, the parts of a control step, bytes and memory.

    `taxinet bench soak` runs many short scenes in one process, or watches a running process, and
    checks memory, file descriptors, threads and shared memory for growth; exit code 1 if any grows.

    `taxinet bench intervals` searches landscapes of known failure rate and reports how often the
    intervals of `falsify` cover it and how often `gate` passes wrongly.

    `taxinet bench sequential` simulates sequential tests of known rates and reports how often they
    err and how many runs they take.

    `taxinet bench rare` estimates known probabilities of rare failures as `estimate` does, and
    reports how often the intervals hold, and on which side they miss.

    `taxinet bench searches` searches landscapes with known failure regions and reports how many of
    them each sampler finds in 200 runs.

    `taxinet bench screening` compares samplers at equal budgets, in which looks of `screening`
    count by their cost, on landscapes and, with the name of a network, in closed loops.

    `taxinet bench chaos` kills, stops, moves and damages small campaigns, resumes them and compares
    the results with undisturbed campaigns; exit code 4 if any differs.

    `taxinet bench processors` digests every frame and message of fixed runs with both networks;
    with --compare, it repeats those of another machine's --json report and exits with 1 if any bit
    differs.
    """
    words, given = subjects or [], given_options(context)
    from taxinet_ros.cli.bench.processors import asks_for_processors, run_processors

    if asks_for_processors(words, given):
        raise typer.Exit(run_processors(
            scenes=runs, duration_s=duration, old=compare, as_json=as_json,
        ))
    if asks_for_study('rare', words, given, also=('seed',)):
        from taxinet_ros.cli.bench.samplers import run_rare

        raise typer.Exit(run_rare(words[1:], repeats=repeats, seed=seed, as_json=as_json))
    from taxinet_ros.cli.bench.chaos import asks_for_chaos, run_chaos

    if asks_for_chaos(words, given):
        raise typer.Exit(run_chaos(
            seed=seed, minutes=minutes, trials=trials, trial=trial, as_json=as_json,
        ))
    if asks_for_study('intervals', words, given):
        from taxinet_ros.cli.bench.samplers import run_intervals

        raise typer.Exit(run_intervals(words[1:], repeats=repeats, as_json=as_json))
    if asks_for_study('sequential', words, given):
        from taxinet_ros.cli.bench.samplers import run_sequential

        raise typer.Exit(run_sequential(words[1:], repeats=repeats, as_json=as_json))
    if asks_for_study('searches', words, given):
        from taxinet_ros.cli.bench.samplers import run_searches

        raise typer.Exit(run_searches(words[1:], repeats=repeats, as_json=as_json))
    if asks_for_study('screening', words, given, also=('runs',)):
        from taxinet_ros.cli.bench.samplers import run_screening

        raise typer.Exit(run_screening(words[1:], repeats=repeats, runs=runs, as_json=as_json))
    from taxinet_ros.cli.bench.soak import asks_for_soak, run_soak

    if asks_for_soak(words, given):
        raise typer.Exit(run_soak(
            runs=runs, duration_s=duration, minutes=minutes, pid=pid, as_json=as_json,
        ))
    from taxinet_ros.cli.bench.subjects import run_bench

    raise typer.Exit(run_bench(
        words, repeats=repeats, as_json=as_json, old=compare, peers=peers, guard=guard,
    ))
