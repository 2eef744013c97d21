"""Analysis commands: arguments, options and help; implementations are imported on use."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.completion import complete_gain, complete_setting, complete_spec
from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import (
    BoundOption,
    CameraOption,
    CampaignArgument,
    ControllerOption,
    JsonOption,
    LatencyOption,
    ProcessesCountOption,
    RateOption,
    RunOption,
    SetOption,
    WorldOption,
    given_among,
    renderer_of,
    scene_settings,
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
        Path | None, typer.Option(help='output folder (default CAMPAIGN/analysis)')
    ] = None,
    spec: Annotated[
        str | None, typer.Option(metavar='NAME', help='formula to analyse instead of the headline')
    ] = None,
    alpha: Annotated[
        float, typer.Option(help='accepted probability of naming a false cause')
    ] = 0.05,
    viewers: Annotated[
        int, typer.Option(min=0, help='maximum number of failed runs shown step by step on the '
        'page')
    ] = 20,
    as_json: JsonOption = False,
) -> None:
    """Find the causes of a campaign's failures, and write a report.

    Identifies hours, clouds, positions and poses (singly and in pairs) where runs fail
    significantly more often, clusters the counterexamples, plots robustness over each feature and
    compares networks. Exit code 3 if a sampler chose all runs, so that the program's failure rate
    cannot be estimated.
    """
    from taxinet_ros.cli.analysis.analyze import run_analyze

    raise typer.Exit(run_analyze(
        campaign, baseline or (), out, spec=spec, alpha=alpha, viewers=viewers, as_json=as_json
    ))


def localize(
    campaign: CampaignArgument,
    runs: Annotated[
        int | None,
        typer.Option(help='maximum number of failed runs to examine, evenly spread'),
    ] = None,
    substitutions: Annotated[
        list[str] | None,
        typer.Option(
            '--with', metavar='SUBSTITUTION',
            help='truth, truth-heading, truth-cte (default: these three), '
            'delayed:SECONDS, truth-delayed:SECONDS or noisy:SIGMA_M; repeatable',
        ),
    ] = None,
    workers: ProcessesCountOption = 1,
    out: Annotated[
        Path | None,
        typer.Option(help='output folder for table and page; finished trials in it are kept'),
    ] = None,
    perception: Annotated[
        str | None, typer.Option(metavar='FILE', help="the runs' network, if its file has moved")
    ] = None,
    engine: Annotated[
        str, typer.Option(help='loop; every unchanged rerun is compared with the recorded run')
    ] = 'loop',
    as_json: JsonOption = False,
) -> None:
    """Find which part causes failures: network or controller.

    Reruns a campaign's failed runs unchanged and with the truth in place of the whole estimate, of
    its heading error only and of its cross-track error only. After an interrupt, the same command
    continues.
    """
    from taxinet_ros.cli.analysis.localize import run_localize
    from taxinet_ros.errors import UsageError
    from taxinet_ros.trials.options import LOOP
    from taxinet_ros.trials.past_runs.localisation import make_localize_options
    from taxinet_ros.trials.record.facts import missing_packages_named

    if engine != LOOP:
        raise UsageError(
            f'--engine {engine}: localize reruns in the {LOOP} only; no node of a graph has a '
            'part of the truth'
        )
    with missing_packages_named(campaign):
        options = make_localize_options(
            campaign, runs=runs, words=substitutions or (), workers=workers, out=out,
            perception=perception,
        )
    raise typer.Exit(run_localize(options, as_json=as_json))


def compare(
    context: typer.Context,
    before: Annotated[
        str, typer.Argument(metavar='A', help='campaign or table, or a network: word or file')
    ],
    after: Annotated[str, typer.Argument(metavar='B', help='the same, to be compared with A')],
    scenes: Annotated[
        str | None,
        typer.Argument(
            metavar='[SCENES]',
            help='of two networks: a program, or a campaign, table or run whose scenes both drive',
        ),
    ] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help='number of scenes (default: 100 of a program, else '
        'all of them); fewer are spread evenly')
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help='seed of the scenes of a program (default 0)')
    ] = None,
    spec: Annotated[
        list[str] | None,
        typer.Option('--spec', metavar='FORMULA', help='requirement for the scenes of a program '
        '(default phi_eventually)'),
    ] = None,
    settings: SetOption = None,
    controller: ControllerOption = 'steering',
    world: WorldOption = 'kmwh',
    camera: CameraOption = None,
    latency: LatencyOption = None,
    bound: BoundOption = None,
    rate: RateOption = None,
    workers: ProcessesCountOption = 2,
    out: Annotated[
        Path | None,
        typer.Option(help='folder for page and tables; finished runs in it are kept'),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare two networks on the same scenes: what got better, what got worse, and why.

    Takes two campaigns or tables of the same scenes, or two networks and the scenes, which both
    then drive in the closed loop without ROS; those of a program with the settings that run takes.
    Gives the paired difference with its interval and McNemar's exact test, the scenes that changed,
    and what they have in common. After an interrupt, the same command continues.
    """
    from taxinet_ros.cli.analysis.compare import CompareOptions, run_compare
    from taxinet_ros.core.world import world_word

    raise typer.Exit(run_compare(CompareOptions(
        before=before, after=after, scenes=scenes, runs=runs, seed=seed, settings={
            'settings': scene_settings(settings, None, None, None, None, camera),
            'specs': spec or (), 'bounds': bound or (), 'rates': rate or (),
            'controller': controller, 'latency': latency or (),
            'world': world_word(world, renderer_of(camera)),
        },
        of_program=next(iter(given_among(context, (
            'seed', 'spec', 'settings', 'controller', 'world', 'camera', 'latency', 'bound', 'rate',
        ))), ''), workers=workers, out=out, as_json=as_json,
    )))


def bisect(
    networks: Annotated[
        list[str],
        typer.Argument(
            metavar='GOOD ... BAD', help='networks or checkpoints in order: words or files'
        ),
    ],
    scene: Annotated[
        Path, typer.Option(metavar='BAG|TABLE|CAMPAIGN', help='the scenes')
    ],
    every: Annotated[
        bool, typer.Option('--every', help='run every network in every scene, so that a scene '
        'that breaks more than once is seen')
    ] = False,
    runs: Annotated[
        int | None, typer.Option(min=1, help='at most so many scenes, evenly spread')
    ] = None,
    workers: ProcessesCountOption = 2,
    out: Annotated[
        Path | None, typer.Option(help='folder for the results; finished runs in it are kept')
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find which of several networks in order broke which scenes.

    For every scene that the first one satisfies and the last one violates, finds a network that
    violates it right after one that satisfies it. Exit codes: 0 done, 3 some run could not be
    judged, 130 interrupted; the same command continues.
    """
    from taxinet_ros.cli.analysis.compare import BisectOptions, run_bisect

    raise typer.Exit(run_bisect(BisectOptions(
        networks=tuple(networks), scene=scene, every=every, runs=runs, workers=workers, out=out,
        as_json=as_json,
    )))


def explain(
    bag: Annotated[
        Path, typer.Argument(metavar='BAG', help='folder of a run, usually a counterexample')
    ],
    run_id: RunOption = None,
    perception: Annotated[
        str | None,
        typer.Option(metavar='WORD|FILE', help="network to examine (default: the run's)"),
    ] = None,
    frames: Annotated[
        int,
        typer.Option(
            min=1, max=20, help='maximum number of frames to examine: the worst ones and the first'
        ),
    ] = 4,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar='NAME|FILE',
            help="the run's camera, if that is not ours: asked for pictures of the changed scenes "
            '(default: they are not changed)',
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help='output folder for page and images; must be new')
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Explain why the network failed in one run.

    Shows where its estimates are wrong; what it would estimate at the worst moments without shadow,
    crossing or rain, under another sky and at another hour; and which image region the estimate
    depends on.
    """
    from taxinet_ros.cli.analysis.explain import ExplainOptions, run_explain
    from taxinet_ros.cli.bag.input import readable_run

    with readable_run(bag, run_id) as whole:
        code = run_explain(ExplainOptions(
            recording=whole, perception=perception, frames=frames, camera=camera,
            out=out, as_json=as_json,
        ))
    raise typer.Exit(code)


def fork(
    bag: Annotated[
        Path, typer.Argument(metavar='BAG', help='folder of a run, usually a counterexample')
    ],
    run_id: RunOption = None,
    at: Annotated[
        float | None, typer.Option(metavar='SECONDS', help='from when it is changed')
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set', metavar='KEY=VALUE',
            help='scenario value (rain=0, clouds=clear, wind_speed=6, …) or gain '
            '(steering.heading_gain=1.2) from then on; repeatable',
            autocompletion=complete_setting,
        ),
    ] = None,
    state: Annotated[
        list[str] | None,
        typer.Option(
            metavar='OFFSET=VALUE',
            help='place the aircraft anew, off by cte_m, heading_deg, distance_m or speed_mps: '
            'cte_m=+0.5 is half a metre left; repeatable',
        ),
    ] = None,
    perception: Annotated[
        str | None,
        typer.Option(metavar='WORD|FILE', help="from then on (default: the run's)"),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(metavar='WORD|FILE', help="from then on (default: the run's)"),
    ] = None,
    sweep: Annotated[
        str | None,
        typer.Option(
            metavar='KEY=LOW:HIGH:STEP', help='robustness over a value changed then, rain=0:100:5'
        ),
    ] = None,
    find: Annotated[
        bool,
        typer.Option(
            '--find', help='the last moment at which the change (default: --perception truth) '
            'still saves the run'
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help='output folder for bag and picture; must be new')
    ] = None,
    images: Annotated[
        str, typer.Option(help='camera frames in the new bag: all or none')
    ] = 'all',
    as_json: JsonOption = False,
) -> None:
    """Repeat a recorded run up to a moment, and go on in a changed world.

    Up to the moment the run is repeated to the bit, which is checked; then the scene, the place of
    the aircraft, the perception or the controller changes. Writes a bag, and a picture of both
    runs. Exit code 1 if the forked run violates its requirements.
    """
    from taxinet_ros.cli.analysis.fork import ForkOptions, run_fork
    from taxinet_ros.cli.bag.input import readable_run
    from taxinet_ros.errors import UsageError

    if images not in ('all', 'none'):
        raise UsageError(f'--images {images}: unknown; known: all, none')
    options = ForkOptions(
        at_s=at, settings=settings or (), moved=state or (), perception=perception,
        controller=controller, sweep=sweep, find=find, out=out, images=images == 'all',
        as_json=as_json,
    )
    with readable_run(bag, run_id) as whole:
        code = run_fork(whole, options)
    raise typer.Exit(code)


def doctor(
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar='CAMPAIGN',
            help='folder of a campaign, experiment, dataset or study, or a folder that contains '
            'some; without it, this machine is checked',
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check this machine, or every file in a results folder.

    Without a folder: Python, compiler, packages, ROS, messages, domain, discovery, memory, limits,
    disk, browser, FlightGear and a short run, each with its mend; exit code 4 if something is
    broken.

    With a folder: checks every record, each bag against its row and each dataset image against its
    label, makes tables again that do not say what their record says, and finds leftovers of killed
    processes. Exit codes: 0 no
    findings, 3 something is incomplete or damaged, 2 nothing to check. The command that made it
    goes on with `--resume`.
    """
    if folder is None:
        from taxinet_ros.cli.system import run_system_doctor

        raise typer.Exit(run_system_doctor(as_json=as_json))
    from taxinet_ros.cli.bag.doctor import run_results_doctor

    raise typer.Exit(run_results_doctor(folder, as_json=as_json))


def gate(
    campaign: Annotated[
        Path,
        typer.Argument(
            metavar='CAMPAIGN|NETWORK', help="a campaign's folder; with --baseline also a network, "
            'word or file, which is then driven through its scenes'
        ),
    ],
    min_satisfaction: Annotated[
        float | None,
        typer.Option(metavar='SHARE', help='minimum share of runs that satisfy their formulas'),
    ] = None,
    max_off_runway: Annotated[
        float | None, typer.Option(metavar='SHARE', help='maximum share of runs that leave the '
        'runway')
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(
            metavar='CAMPAIGN|TABLE', help='runs of the same scenes, which these must not be worse '
            'than'
        ),
    ] = None,
    margin: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='with --baseline: loss of satisfied scenes up to which it is no '
            'worse (default 0.05)'
        ),
    ] = None,
    max_infra: Annotated[
        int, typer.Option(help='maximum number of runs with an infrastructure error')
    ] = 0,
    confidence: Annotated[
        float,
        typer.Option(help='confidence of PASS and of FAIL, over all looks that are covered'),
    ] = 0.95,
    planned: Annotated[
        bool,
        typer.Option(
            '--planned', help='judge once, at exactly the planned number of runs, with the whole '
            'confidence (as taxinet plan counts)'
        ),
    ] = False,
    sequential: Annotated[
        bool,
        typer.Option(
            '--sequential', help='follow the runs in their order to the first decision of a '
            'sequential test, at which falsify --until stops'
        ),
    ] = False,
    design: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='with --sequential: the share that a good system has, better '
            'than the threshold; the test then takes the fewest runs for it'
        ),
    ] = None,
    inconclusive: Annotated[
        str,
        typer.Option(
            metavar='WORD', help='exit code for INCONCLUSIVE: report (3), pass (0) or fail (1)'
        ),
    ] = 'report',
    junit: Annotated[
        Path | None, typer.Option(
            metavar='FILE', writable=True, dir_okay=False, help='JUnit XML file to write, one test '
            'case per criterion; the table of the runs is written beside it'
        )
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help='folder for the runs of a NETWORK; finished runs in it are kept'),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help='of a NETWORK: worker processes; same results (default 2)'),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check a campaign against acceptance thresholds.

    PASS (exit code 0) only if the one-sided bound of each share clears its threshold, FAIL (1) if
    the whole interval of one violates it, else INCONCLUSIVE (3) with an estimate of the additional
    runs needed. Runs with an infrastructure error are excluded and counted separately.

    With --baseline, the scenes are paired with those of another campaign or table, which have to be
    the same: FAIL if satisfaction falls (McNemar's exact test), PASS if it falls by no more than
    the margin, else INCONCLUSIVE. A network in place of the campaign is driven through these scenes
    in the closed loop without ROS; after an interrupt, the same command continues.
    """
    from taxinet_ros.analysis.campaign.baseline import DEFAULT_MARGIN
    from taxinet_ros.analysis.gate import GateOptions, Look
    from taxinet_ros.cli.analysis.gate import GateInput, run_gate
    from taxinet_ros.errors import UsageError

    if planned and sequential:
        raise UsageError('gate: --planned and --sequential do not go together; leave one out')
    if margin is not None and baseline is None:
        raise UsageError('--margin: only with --baseline')
    if baseline is not None and margin is None:
        margin = DEFAULT_MARGIN
    look = Look.PLANNED if planned else Look.SEQUENTIAL if sequential else Look.ANY
    options = GateOptions(
        min_satisfaction=min_satisfaction, max_off_runway=max_off_runway, max_infra=max_infra,
        confidence=confidence, look=look, design=design, margin=margin,
    )
    raise typer.Exit(run_gate(
        GateInput(
            campaign=campaign, baseline=baseline, out=out, workers=workers,
            inconclusive=inconclusive, junit=junit, as_json=as_json,
        ), options,
    ))


def check(
    networks: Annotated[
        list[str],
        typer.Argument(
            metavar='NETWORK...', help='words or files: .safetensors, .onnx, or FILE.py:NAME'
        ),
    ],
    runs: Annotated[
        int, typer.Option(min=1, help='so many of the fixed scenes, from the first')
    ] = 50,
    allow: Annotated[
        int, typer.Option(min=0, metavar='SCENES', help='accepted number of violated scenes')
    ] = 0,
    workers: ProcessesCountOption = 2,
    quiet: Annotated[
        bool, typer.Option('--quiet', help='print a line for a network that is not good, else '
        'nothing')
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Drive networks through 50 fixed scenes, as a quick check before a commit.

    The scenes are the same for everybody: drawn from s_falsif with a fixed seed, driven in the
    closed loop without ROS. Exit code 0 if no more scenes violate phi_eventually than allowed, 1 if
    more do, 3 if runs without a verdict leave it open. A smoke test; for a statement about all
    scenes use gate.
    """
    from taxinet_ros.cli.analysis.check import run_check

    raise typer.Exit(run_check(
        networks, runs=runs, allowed=allow, workers=workers, quiet=quiet, as_json=as_json,
    ))


def plan(
    campaign: Annotated[
        Path | None,
        typer.Argument(
            metavar='[CAMPAIGN]', help='runs there are already, drawn by the program itself',
            show_default=False,
        ),
    ] = None,
    min_satisfaction: Annotated[
        float | None,
        typer.Option(metavar='SHARE', help='claim: at least this share of runs satisfy'),
    ] = None,
    max_off_runway: Annotated[
        float | None,
        typer.Option(metavar='SHARE', help='claim: at most this share of runs leave the runway'),
    ] = None,
    so_far: Annotated[
        str | None,
        typer.Option(metavar='RUNS:FAILURES', help='runs there are already, instead of CAMPAIGN'),
    ] = None,
    confidence: Annotated[float, typer.Option(help='confidence of the claim')] = 0.95,
    failures: Annotated[
        int | None, typer.Option(help='plan for up to so many failures (default: 0 to 3)')
    ] = None,
    if_true: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='assumed true share, in the words of the claim: gives the chance '
            'of each plan, and a sequential one'
        ),
    ] = None,
    power: Annotated[
        float, typer.Option(metavar='CHANCE', help='with --if-true: wanted chance to pass')
    ] = 0.9,
    as_json: JsonOption = False,
) -> None:
    """Plan how many runs a claim takes, from the start or after those there are.

    Exact binomial numbers for each number of allowed failures, their chance to pass at a true
    share, and the runs of a sequential test. Runs nothing.
    """
    from taxinet_ros.analysis.plan import Claim
    from taxinet_ros.cli.analysis.plan import run_plan
    from taxinet_ros.errors import UsageError
    from taxinet_ros.trials.sequential import MAX_OFF_RUNWAY, MIN_SATISFACTION

    if (min_satisfaction is None) == (max_off_runway is None):
        raise UsageError('plan: give one claim, --min-satisfaction or --max-off-runway')
    threshold = max_off_runway if min_satisfaction is None else min_satisfaction
    assert threshold is not None
    claim = Claim(
        criterion=MAX_OFF_RUNWAY if min_satisfaction is None else MIN_SATISFACTION,
        threshold=threshold, confidence=confidence, failures=failures, if_true=if_true, power=power,
    )
    raise typer.Exit(run_plan(claim, campaign, so_far=so_far, as_json=as_json))


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
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
    workers: Annotated[int, typer.Option(min=1, help='worker processes; same results')] = 2,
) -> None:
    """Judge recorded runs by their own requirements or by new ones.

    Needs neither ROS nor camera frames. A bag of several runs, as written by ros2 bag record, gets
    one verdict per run. Re-evaluating a run's own formula reproduces the recorded robustness bit
    for bit. Exit codes: 0 all satisfied, 1 some violated, 2 bad input, 3 some bag is incomplete,
    damaged or inconsistent with its recorded verdict.
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
            autocompletion=complete_spec,
        ),
    ],
    duration: Annotated[float, typer.Option(help='length of the runs to be judged [s]')] = 30,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set', metavar='steering.GAIN=VALUE', help='a controller gain',
            autocompletion=complete_gain,
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
) -> None:
    """Show how requirements are parsed, and warn of likely mistakes.

    Runs nothing. Exit codes: 0 valid, with or without warnings; 2 invalid.
    """
    from taxinet_ros.cli.analysis.monitor import show_specs

    show_specs(formulas, duration_s=duration, settings=settings or (), as_json=as_json)


odd_app = command_group('Operational design domains (ODD), and what campaigns cover of one.')
_OddArgument = Annotated[
    str, typer.Argument(metavar='ODD', help='name of a shipped ODD, or a YAML file (docs/odd.md)')
]


@odd_app.command('show')
def show_odd(odd: _OddArgument, as_json: JsonOption = False) -> None:
    """Check an ODD, and print its parameters, cells and exclusions."""
    from taxinet_ros.cli.analysis.odd import show_odd

    raise typer.Exit(show_odd(odd, as_json=as_json))


@odd_app.command('coverage')
def cover_odd(
    campaigns: Annotated[
        list[Path],
        typer.Argument(
            metavar='CAMPAIGN...', help='folders of campaigns, or .parquet tables, of one system'
        ),
    ],
    odd: Annotated[
        str, typer.Option(metavar='NAME|FILE.yaml', help='the operational design domain')
    ],
    spec: Annotated[
        str | None,
        typer.Option(metavar='NAME', help='formula that defines failure (default: the headline)'),
    ] = None,
    below: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='also count the cells and combinations that fail less often than '
            'this, at 95 %'
        ),
    ] = None,
    strength: Annotated[
        int, typer.Option(min=1, max=3, help='largest number of cells in a combination')
    ] = 3,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE.png', writable=True, dir_okay=False, help='picture of cells and pairs '
            'of cells'
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure what the judged runs of campaigns cover of an ODD.

    Runs inside and outside; runs and failure rate of each cell; the share of all pairs and triples
    of cells with a run; the gaps; the largest hole between runs; parameters that were never varied,
    or that the ODD does not mention.
    """
    from taxinet_ros.cli.analysis.odd import CoverageOptions, run_coverage

    raise typer.Exit(run_coverage(campaigns, CoverageOptions(
        odd=odd, spec=spec, below=below, strength=strength, plot=plot, as_json=as_json
    )))


@odd_app.command('export')
def export_odd(
    odd: _OddArgument,
    out: Annotated[
        Path,
        typer.Option(
            metavar='FILE.yaml', writable=True, dir_okay=False, help='file to write; must be new'
        ),
    ],
) -> None:
    """Write an ODD as ASAM OpenODD 1.0 YAML, with a binding file for openodd-py beside it."""
    from taxinet_ros.cli.analysis.odd import export_odd

    raise typer.Exit(export_odd(odd, out))
