"""The commands that find out what a campaign's results mean."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.option_types import RunOption

CampaignArgument = Annotated[Path, typer.Argument(metavar='CAMPAIGN', help="a campaign's folder")]
ProcessesCountOption = Annotated[
    int, typer.Option('--workers', help='processes that work at once; same results')
]
JsonOption = Annotated[bool, typer.Option('--json', help='print JSON')]


def analyze(
    campaign: Annotated[
        Path, typer.Argument(metavar='CAMPAIGN', help="a campaign's folder, or a .parquet table")
    ],
    baseline: Annotated[
        list[Path] | None,
        typer.Option(metavar='CAMPAIGN', help='another one to hold it against; repeatable'),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help='folder to write; CAMPAIGN/analysis by default')
    ] = None,
    spec: Annotated[
        str | None, typer.Option(metavar='NAME', help='formula to analyse, not the headline')
    ] = None,
    alpha: Annotated[
        float, typer.Option(help='how often a cause may be named where there is none')
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
    from taxinet_ros.cli.analyze import run_analyze

    raise typer.Exit(run_analyze(
        campaign, baseline or (), out, spec=spec, alpha=alpha, viewers=viewers, as_json=as_json
    ))


def localize(
    campaign: CampaignArgument,
    runs: Annotated[
        int | None,
        typer.Option(help='most failed runs to look into, evenly spread over all of them'),
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
        str | None, typer.Option(metavar='FILE', help='where the network of the runs is now')
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find whose fault failures are: network or controller.

    Runs a campaign's failed runs again with the truth in place of the network's estimate, of its
    heading error alone and of its cross-track error alone, and once as they were. Interrupted, the
    same command goes on.
    """
    from taxinet_ros.campaign.localize import make_localize_options
    from taxinet_ros.cli.localize import run_localize

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
        typer.Option(
            metavar='WORD|FILE', help='network to ask; the one that took part where not named'
        ),
    ] = None,
    dataset: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='training images to hold the frames against'),
    ] = None,
    frames: Annotated[
        int, typer.Option(min=1, max=20, help='most frames to look into: the worst, and the start')
    ] = 4,
    out: Annotated[
        Path | None, typer.Option(help='folder for page and pictures; must be new')
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find why the network failed in one run.

    Shows where its estimates are wrong, what it sees at the worst moments without shadow, crossing
    or rain, under another sky and at another hour, which part of the picture it goes by, and the
    training images that come nearest.
    """
    from taxinet_ros.cli.bag_input import readable_run
    from taxinet_ros.cli.explain import ExplainOptions, run_explain

    with readable_run(bag, run_id) as whole:
        code = run_explain(ExplainOptions(
            bag=whole, perception=perception, dataset=dataset, frames=frames, out=out,
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
    """Check all that lies in a folder of results: is it what was written there?

    Every line of every ledger, the tables against it, each bag against its row, each picture of a
    dataset against its label, and what killed processes have left. Exit code: 0 all is sound, 3
    something is not whole, 2 there is nothing to check.
    """
    from taxinet_ros.cli.doctor import run_doctor

    raise typer.Exit(run_doctor(folder, mended=mend, as_json=as_json))


def gate(
    campaign: CampaignArgument,
    min_satisfaction: Annotated[
        float | None,
        typer.Option(metavar='SHARE', help='least share of runs that satisfy their formulas'),
    ] = None,
    max_off_runway: Annotated[
        float | None, typer.Option(metavar='SHARE', help='largest share that leaves the runway')
    ] = None,
    max_infra: Annotated[int, typer.Option(help='most runs that the bench broke')] = 0,
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
    the whole interval of one is beyond it, else INCONCLUSIVE (3) with how many runs more are needed
    about. Runs that the bench broke are in no share and are counted apart.
    """
    from taxinet_ros.analysis.gate import GateOptions
    from taxinet_ros.cli.gate import run_gate

    options = GateOptions(
        min_satisfaction=min_satisfaction, max_off_runway=max_off_runway, max_infra=max_infra,
        confidence=confidence,
    )
    raise typer.Exit(
        run_gate(campaign, options, inconclusive=inconclusive, junit=junit, as_json=as_json)
    )


def experiment(
    file: Annotated[
        str,
        typer.Argument(
            metavar='FILE', help='shipped experiment (shadows, shadows_afternoon, crossing, '
            'light) or a YAML file'
        ),
    ],
    out: Annotated[Path | None, typer.Option(help='folder for the arms; must be new')] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help="number of scenes, instead of the file's")
    ] = None,
    perception: Annotated[
        str | None, typer.Option(metavar='WORD|FILE', help="network, instead of the file's")
    ] = None,
    workers: Annotated[int, typer.Option(help='graphs that run at once; same results')] = 1,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue what was interrupted in --out')
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Confirm a cause: run the same scenes with and without it.

    Each arm of the experiment is a campaign of its own; the runs of a scene are compared in pairs.
    """
    from taxinet_ros.campaign.experiment import of_network
    from taxinet_ros.campaign.experiment_file import find_experiment, read_experiment
    from taxinet_ros.campaign.options import DEFAULT_ROOT, new_folder
    from taxinet_ros.cli.experiment import run_experiment
    from taxinet_ros.core.errors import UsageError

    if resume and out is None:
        raise UsageError('--resume: say with --out which experiment to continue')
    asked = read_experiment(find_experiment(file))
    if runs is not None:
        asked = dataclasses.replace(asked, runs=runs)
    if perception is not None:
        asked = of_network(asked, perception)
    raise typer.Exit(
        run_experiment(
            asked, out or new_folder(DEFAULT_ROOT / f'experiment-{asked.name}'),
            workers=workers, resume=resume, as_json=as_json,
        )
    )
