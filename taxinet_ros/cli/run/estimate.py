"""``taxinet estimate``: the probability of rare failures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import (
    AuditOption,
    BoundOption,
    ControllerOption,
    EngineOption,
    ImagesOption,
    JsonOption,
    LatencyOption,
    MostRunsOption,
    OutOption,
    PerceptionOption,
    QuietOption,
    RateOption,
    ResumeOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    SpecOption,
    WorkersOption,
    WorldCameraOption,
    WorldOption,
    campaign_of,
)
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode

if TYPE_CHECKING:
    from taxinet_ros.trials.engine import Engine
    from taxinet_ros.trials.search import Search



def estimate(
    context: typer.Context,
    program: ScenarioArgument,
    down_to: Annotated[
        float,
        typer.Option(metavar='PROBABILITY', help='least probability that the runs suffice for'),
    ] = 1e-5,
    runs: MostRunsOption = 4000,
    islands: Annotated[
        int,
        typer.Option(
            min=4, max=100, help='independent populations; their mean gives the lower end'
        ),
    ] = 8,
    workers: WorkersOption = 1,
    out: OutOption = None,
    resume: ResumeOption = False,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    controller: ControllerOption = 'steering',
    world: WorldOption = 'kmwh',
    settings: SetOption = None,
    camera: WorldCameraOption = None,
    specs: SpecOption = None,
    images: ImagesOption = 'none',
    bounds: BoundOption = None,
    rates: RateOption = None,
    latency: LatencyOption = None,
    engine: EngineOption = 'loop',
    audit: AuditOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Estimate the probability of rare failures, down to one in a hundred thousand.

    Half of the runs are plain draws, for the upper end. For the lower one, the way to a failure is
    split into levels of robustness, each reached from the one before by Markov chains in the
    program's own distribution. Its headline is the first requirement, or the only one. Prints a
    95 % interval, and draws P(robustness <= r). Exit codes: 0 estimated, 3 a wide interval.
    """
    from taxinet_ros.trials.record.facts import missing_packages_named
    from taxinet_ros.trials.search import make_estimate

    with missing_packages_named(out if resume else None):
        campaign = campaign_of(context)
        search = make_estimate(campaign, floor=down_to, islands=islands, workers=workers)
    raise typer.Exit(run_estimate(search, quiet=quiet, as_json=as_json))


def run_estimate(asked: Search, *, quiet: bool, as_json: bool) -> int:
    """Run the chains, and print and write the estimate.

    Args:
        asked: the search, by the sampler ``splitting``.
        quiet: print warnings and the result only.
        as_json: print the result as JSON, and all else on standard error.
    """
    from taxinet_ros.analysis.search.rare import (
        estimate_of,
        estimate_text,
        estimate_values,
        next_text,
        unfinished_words,
        write_estimate,
    )
    from taxinet_ros.cli.run.campaign import run_on_workers, search_view
    from taxinet_ros.cli.run.search import open_search
    from taxinet_ros.samplers.splitting import State
    from taxinet_ros.trials.search_summary import heading_lines
    from taxinet_ros.trials.summary import requirement_lines

    console = line_console(stderr=as_json)
    with open_search(asked, console, quiet=True) as search:
        warnings = [search.book.warning] if search.book.warning else []
        heading = [] if quiet else heading_lines(asked)
        for line in (*warnings, *heading, *requirement_lines(asked.check, quiet=quiet)):
            console.print(line)
        with search_view(console, search, shown=console.is_terminal and not quiet):
            run_on_workers(search)
        if unfinished := unfinished_words(search):
            if as_json:
                print_json({'state': 'unfinished', 'low': None, 'high': None, 'why': unfinished})
            console.print(unfinished)
            return _exit_code(search, ExitCode.INCOMPLETE)
        found = estimate_of(search)
        table, *pictures = write_estimate(found, search)
        values, text = estimate_values(found, search), estimate_text(found, search)
    if as_json:
        print_json(values)
    written = ', '.join([f'written: {table}', *(path.name for path in pictures)])
    console.print('\n'.join([text, written, next_text(found, search)]))
    estimated = found.state is State.ESTIMATED
    return _exit_code(search, ExitCode.OK if estimated else ExitCode.INCOMPLETE)


def _exit_code(search: Engine[Search], otherwise: ExitCode) -> ExitCode:
    """What ended the search before its end, or the code of its result."""
    if search.exhausted:
        return otherwise
    if search.interrupted:
        return ExitCode.INTERRUPTED
    return ExitCode.INFRA if search.stopped else otherwise
