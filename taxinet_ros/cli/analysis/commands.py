"""The commands that analyse results: arguments, options and help; the work is imported later."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import (
    BoundOption,
    CampaignArgument,
    JsonOption,
    ProcessesCountOption,
    RateOption,
    RunOption,
)


def analyze(
    campaign: Annotated[
        Path, typer.Argument(metavar='CAMPAIGN', help="a campaign's folder, or a .parquet table")
    ],
    baseline: Annotated[
        list[Path] | None,
        typer.Option(metavar='CAMPAIGN', help='another campaign to compare with; repeatable'),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help='folder to write; CAMPAIGN/analysis by default')
    ] = None,
    spec: Annotated[
        str | None, typer.Option(metavar='NAME', help='formula to analyse, not the headline')
    ] = None,
    alpha: Annotated[
        float, typer.Option(help='accepted probability of naming a false cause')
    ] = 0.05,
    viewers: Annotated[
        int, typer.Option(min=0, help='most failed runs that the page shows step by step')
    ] = 20,
    as_json: JsonOption = False,
) -> None:
    """Find the causes of a campaign's failures, and write a report.

    Names the hours, clouds, places and poses in which runs fail more than chance allows, singly and
    in pairs, groups the counterexamples, draws robustness over each feature, and compares networks.
    Exit code 3 where a sampler chose all runs, so that they tell no rate of the program.
    """
    from taxinet_ros.cli.analysis.analyze import run_analyze

    raise typer.Exit(run_analyze(
        campaign, baseline or (), out, spec=spec, alpha=alpha, viewers=viewers, as_json=as_json
    ))


def localize(
    campaign: CampaignArgument,
    runs: Annotated[
        int | None,
        typer.Option(help='examine at most so many failed runs, evenly spread over all'),
    ] = None,
    substitutions: Annotated[
        list[str] | None,
        typer.Option(
            '--with', metavar='SUBSTITUTION',
            help='truth, truth-heading, truth-cte (these three where none is named), '
            'delayed:SECONDS, truth-delayed:SECONDS or noisy:SIGMA_M; repeatable',
        ),
    ] = None,
    workers: ProcessesCountOption = 1,
    out: Annotated[
        Path | None,
        typer.Option(help='folder for table and page; what is done in it is not done again'),
    ] = None,
    perception: Annotated[
        str | None, typer.Option(metavar='FILE', help="the runs' network, where it has moved")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find which part causes failures: network or controller.

    Runs a campaign's failed runs again with the truth in place of the network's estimate, of its
    heading error alone and of its cross-track error alone, and once as they were. Interrupted, the
    same command goes on.
    """
    from taxinet_ros.campaign.past_runs.localisation import make_localize_options
    from taxinet_ros.campaign.record.facts import missing_packages_named
    from taxinet_ros.cli.analysis.localize import run_localize

    with missing_packages_named(campaign):
        options = make_localize_options(
            campaign, runs=runs, words=substitutions or (), workers=workers, out=out,
            perception=perception,
        )
    raise typer.Exit(run_localize(options, as_json=as_json))


def explain(
    bag: Annotated[
        Path, typer.Argument(metavar='BAG', help="a run's folder, usually of a counterexample")
    ],
    run_id: RunOption = None,
    perception: Annotated[
        str | None,
        typer.Option(metavar='WORD|FILE', help='network to examine; default: the one of the run'),
    ] = None,
    dataset: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='training images to compare the frames with'),
    ] = None,
    frames: Annotated[
        int,
        typer.Option(
            min=1, max=20, help='examine at most so many frames: the worst, and the first'
        ),
    ] = 4,
    out: Annotated[
        Path | None, typer.Option(help='folder for page and pictures; must be new')
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find why the network failed in one run.

    Shows where its estimates are wrong, what it sees at the worst moments without shadow, crossing
    or rain, under another sky and at another hour, which part of the picture its estimate depends
    on, and the nearest training images.
    """
    from taxinet_ros.cli.analysis.explain import ExplainOptions, run_explain
    from taxinet_ros.cli.bag.input import readable_run

    with readable_run(bag, run_id) as whole:
        code = run_explain(ExplainOptions(
            recording=whole, perception=perception, dataset=dataset, frames=frames, out=out,
            as_json=as_json,
        ))
    raise typer.Exit(code)


def doctor(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar='CAMPAIGN',
            help='folder of a campaign, an experiment, a dataset, a study; anything that holds '
            'such',
        ),
    ],
    mend: Annotated[
        bool,
        typer.Option(
            '--mend',
            help='write tables and campaign.json anew from the ledger; put a damaged ledger '
            'aside and go on with its sound lines',
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check every file of a results folder against what was recorded of it.

    Every line of every ledger, tables against the ledger, each bag against its row, each picture
    of a dataset against its label, and leftovers of killed processes. Exit codes: 0 all is sound,
    3 something is incomplete or damaged, 2 nothing to check.
    """
    from taxinet_ros.cli.bag.doctor import run_results_doctor

    raise typer.Exit(run_results_doctor(folder, mended=mend, as_json=as_json))


def gate(
    campaign: CampaignArgument,
    min_satisfaction: Annotated[
        float | None,
        typer.Option(metavar='SHARE', help='least share of runs that satisfy their formulas'),
    ] = None,
    max_off_runway: Annotated[
        float | None, typer.Option(metavar='SHARE', help='largest share that leaves the runway')
    ] = None,
    max_infra: Annotated[
        int, typer.Option(help='accepted number of runs that ended in an infrastructure error')
    ] = 0,
    confidence: Annotated[float, typer.Option(help='of each one-sided bound')] = 0.95,
    inconclusive: Annotated[
        str,
        typer.Option(
            metavar='WORD', help='what INCONCLUSIVE exits with: report (3), pass (0) or fail (1)'
        ),
    ] = 'report',
    junit: Annotated[
        Path | None, typer.Option(metavar='FILE', help='JUnit XML to write, a test case per run')
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Decide whether a campaign proves what is asked of it.

    PASS (exit code 0) only if the one-sided bound of each share clears its threshold, FAIL (1) if
    the whole interval of one is beyond it, else INCONCLUSIVE (3) with about how many more runs are
    needed. Runs that ended in an infrastructure error are excluded, and counted apart.
    """
    from taxinet_ros.analysis.gate import GateOptions
    from taxinet_ros.cli.analysis.gate import run_gate

    options = GateOptions(
        min_satisfaction=min_satisfaction, max_off_runway=max_off_runway, max_infra=max_infra,
        confidence=confidence,
    )
    raise typer.Exit(
        run_gate(campaign, options, inconclusive=inconclusive, junit=junit, as_json=as_json)
    )


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
            'YAML file of them; repeatable; default: those that judged the run',
        ),
    ] = None,
    run_id: RunOption = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE.png|DIR',
            help='draw signals, bounds and robustness over time; a folder for several bags',
        ),
    ] = None,
    bound: BoundOption = None,
    rate: RateOption = None,
    add: Annotated[
        bool, typer.Option('--add', help="add a column for each new formula to a campaign's table")
    ] = False,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
    workers: Annotated[int, typer.Option(min=1, help='processes that judge; same results')] = 2,
) -> None:
    """Judge recorded runs by their own requirements or by new ones.

    Needs no ROS and no pictures. A bag of several runs, as ros2 bag record makes them, gets a
    verdict for each. A formula that judged a run gets the recorded robustness again,
    to the last bit. Exit codes: 0 all satisfied, 1 some violated, 2 bad input, 3 some bag is
    incomplete or damaged, or contradicts what was recorded in it.
    """
    from taxinet_ros.cli.analysis.monitor import run_monitor

    raise typer.Exit(
        run_monitor(
            bags, specs=spec or (), plot=plot, add=add, as_json=as_json, workers=workers,
            bounds=bound or (), rates=rate or (), run=run_id,
        )
    )


def spec(
    formulas: Annotated[
        list[str],
        typer.Argument(
            metavar='FORMULA...',
            help='phi_eventually, usable, NAME=FORMULA, a formula, or a YAML file of them',
        ),
    ],
    duration: Annotated[float, typer.Option(help='length of the runs that it will judge [s]')] = 30,
    settings: Annotated[
        list[str] | None,
        typer.Option('--set', metavar='steering.GAIN=VALUE', help='a gain of the controller'),
    ] = None,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
) -> None:
    """Show how requirements are parsed, and warn of likely mistakes.

    Nothing is run. Exit codes: 0 they can be judged, with or without warnings; 2 they cannot.
    """
    from taxinet_ros.cli.analysis.monitor import show_specs

    show_specs(formulas, duration_s=duration, settings=settings or (), as_json=as_json)
