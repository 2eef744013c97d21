"""Commands that run the graph: arguments, options and help; implementations are imported on use."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import typer

from taxinet_ros.cli.completion import complete_experiment, complete_gain, complete_perception
from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import (
    AircraftOption,
    AirportOption,
    AptDatOption,
    AuditOption,
    BoundOption,
    BudgetOption,
    CameraOption,
    ClusterOption,
    ControllerCommandOption,
    ControllerOption,
    EngineOption,
    ExitZeroOption,
    FactorOption,
    FailedRunArgument,
    FallbackOption,
    FoxgloveOption,
    FreeOption,
    FromOption,
    ImagesOption,
    JsonOption,
    JsonSummaryOption,
    LagOption,
    LatencyOption,
    MonitorOption,
    MostRunsOption,
    NeededRunsOption,
    NominalOption,
    OddOption,
    OutOption,
    OwnControllerOption,
    OwnPerceptionOption,
    OwnSpecOption,
    PerceptionCommandOption,
    PerceptionOption,
    PictureOption,
    ProcessesOption,
    QuietOption,
    RateOption,
    RendererOption,
    ResumeOption,
    RunImagesOption,
    RunOption,
    RunsOption,
    RunwayOption,
    SamplerOption,
    SamplerSettingOption,
    ScenarioArgument,
    SceneArgument,
    SeedOption,
    SetOption,
    SpecOption,
    StopOnOption,
    UntilOption,
    WorkersOption,
    WorldOption,
    airport_place,
    controller_of,
    ended,
    given_options,
    refuse_given,
    renderer_of,
    scene_settings,
    word_of,
)


def run(
    context: typer.Context,
    scenario: SceneArgument = None,
    bag: FromOption = None,
    run_id: RunOption = None,
    runs: RunsOption = 1,
    workers: WorkersOption = 1,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    perception_cmd: PerceptionCommandOption = None,
    controller: ControllerOption = 'steering',
    controller_cmd: ControllerCommandOption = None,
    monitor: MonitorOption = None,
    fallback: FallbackOption = None,
    world: WorldOption = 'kmwh',
    settings: SetOption = None,
    airport: AirportOption = None,
    runway: RunwayOption = None,
    apt_dat: AptDatOption = None,
    aircraft: AircraftOption = None,
    camera: CameraOption = None,
    spec: SpecOption = None,
    out: OutOption = None,
    processes: ProcessesOption = False,
    images: RunImagesOption = None,
    stop_on: StopOnOption = 'never',
    bound: BoundOption = None,
    rate: RateOption = None,
    latency: LatencyOption = None,
    free: FreeOption = False,
    real_time_factor: FactorOption = None,
    foxglove: FoxgloveOption = None,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    quiet: QuietOption = False,
    as_json: JsonSummaryOption = False,
    exit_zero: ExitZeroOption = False,
) -> None:
    """Run a Scenic program's scenes through the graph.

    Every run writes its own bag and a row of the campaign's table. With --from, the run of a bag is
    rerun and compared instead: exit code 0 bit-identical, 1 different.
    """
    if bag is None:
        _start_scenic()
    from taxinet_ros.cli.run.campaign import run_campaign, with_run_workers
    from taxinet_ros.core.world import world_word
    from taxinet_ros.errors import UsageError
    from taxinet_ros.trials.options import LOOP, make_options

    if bag is not None and foxglove is not None:
        raise UsageError('--foxglove: not with --from; use the bag_player to show a bag')
    if bag is not None:
        raise typer.Exit(_run_from(context, bag))
    if run_id is not None:
        raise UsageError(
            '--run: selects a run of the bag given by --from; give --from, or leave --run out'
        )
    if scenario is None:
        raise UsageError('run: name a SCENARIO, or a recorded run with --from BAG')
    if foxglove is not None and engine == LOOP:
        raise UsageError(f'--foxglove: not with --engine {LOOP}, which has no topics')
    options = make_options(
        program=scenario, runs=runs, seed=seed, perception=word_of(context, 'perception'),
        settings=scene_settings(settings, airport, runway, apt_dat, aircraft, camera),
        specs=spec or (), out=out, processes=processes,
        images=images or ('all' if runs == 1 else 'failures'), stop_on=stop_on,
        bounds=bound or (), rates=rate or (), controller=controller_of(context),
        latency=latency or (), free=free, real_time_factor=real_time_factor,
        world=world_word(world, renderer_of(camera)),
        engine=engine, audit=audit,
    )
    raise ended(
        run_campaign(
            with_run_workers(options, workers, foxglove), foxglove, quiet=quiet, as_json=as_json,
        ), exit_zero,
    )


def _start_scenic() -> None:
    """Have Scenic imported in its own process while this one goes on."""
    from taxinet_ros.scenes.scenic_server import start_early

    start_early()


def _run_from(context: typer.Context, bag: Path) -> int:
    from taxinet_ros.cli.bag.input import readable_run
    from taxinet_ros.cli.bag.rerun import check_options, run_again

    given = given_options(context)
    check_options(given)
    with readable_run(bag, given.get('run_id')) as whole:
        return run_again(
            whole, perception=_word(context, given, 'perception'),
            controller=_word(context, given, 'controller'), out=given.get('out'),
            images=given.get('images'), processes=context.params['processes'],
        )


def _word(context: typer.Context, given: dict[str, Any], role: str) -> str | None:
    return word_of(context, role) if {role, f'{role}_cmd'} & given.keys() else None


def falsify(
    context: typer.Context,
    scenario: ScenarioArgument,
    runs: MostRunsOption = 100,
    sampler: SamplerOption = None,
    sampler_option: SamplerSettingOption = None,
    odd: OddOption = None,
    workers: WorkersOption = 1,
    cluster: ClusterOption = None,
    lag: LagOption = 8,
    out: OutOption = None,
    resume: ResumeOption = False,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    perception_cmd: PerceptionCommandOption = None,
    controller: ControllerOption = 'steering',
    controller_cmd: ControllerCommandOption = None,
    monitor: MonitorOption = None,
    fallback: FallbackOption = None,
    world: WorldOption = 'kmwh',
    settings: SetOption = None,
    airport: AirportOption = None,
    runway: RunwayOption = None,
    apt_dat: AptDatOption = None,
    aircraft: AircraftOption = None,
    camera: CameraOption = None,
    spec: SpecOption = None,
    until: UntilOption = None,
    budget: BudgetOption = None,
    images: ImagesOption = 'failures',
    stop_on: StopOnOption = 'never',
    bound: BoundOption = None,
    rate: RateOption = None,
    latency: LatencyOption = None,
    free: FreeOption = False,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    quiet: QuietOption = False,
    as_json: JsonSummaryOption = False,
    exit_zero: ExitZeroOption = False,
) -> None:
    """Search a Scenic program for violating scenes.

    The default sampler looks for failures unlike those already found, and draws every fourth run
    from the program itself to estimate failure rates; `--sampler ce` also learns where failures are
    likely. Can be resumed after Ctrl-C or power loss.
    """
    _start_scenic()
    from taxinet_ros.cli.run.search import run_falsify
    from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE
    from taxinet_ros.core.world import world_word
    from taxinet_ros.errors import UsageError
    from taxinet_ros.trials.options import make_options
    from taxinet_ros.trials.record.facts import missing_packages_named
    from taxinet_ros.trials.search import make_search

    if free:
        raise UsageError(
            f'--free: not in a search, which needs reproducible verdicts, and {NOT_REPRODUCIBLE}; '
            'use taxinet run --runs N --free, or search with --latency'
        )
    with missing_packages_named(out if resume else None):
        campaign = make_options(
            program=scenario, runs=runs, seed=seed, perception=word_of(context, 'perception'),
            settings=scene_settings(settings, airport, runway, apt_dat, aircraft, camera),
            specs=spec or (), out=out, images=images, resume=resume,
            stop_on=stop_on, bounds=bound or (), rates=rate or (),
            controller=controller_of(context), latency=latency or (),
            world=world_word(world, renderer_of(camera)),
            engine=engine, audit=audit,
        )
        search = make_search(
            campaign, sampler=sampler, sampler_options=sampler_option or (), workers=workers,
            until=until, budget_min=budget, lag=lag, cluster=cluster, odd=odd,
        )
    raise ended(run_falsify(search, quiet=quiet, as_json=as_json), exit_zero)


def estimate(
    scenario: ScenarioArgument,
    target_error: Annotated[float | None, typer.Option(hidden=True)] = None,
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
    airport: AirportOption = None,
    runway: RunwayOption = None,
    apt_dat: AptDatOption = None,
    aircraft: AircraftOption = None,
    camera: CameraOption = None,
    spec: SpecOption = None,
    images: ImagesOption = 'none',
    bound: BoundOption = None,
    rate: RateOption = None,
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
    _start_scenic()
    from taxinet_ros.cli.run.estimate import run_estimate
    from taxinet_ros.core.world import world_word
    from taxinet_ros.errors import UsageError
    from taxinet_ros.trials.options import make_options
    from taxinet_ros.trials.record.facts import missing_packages_named
    from taxinet_ros.trials.search import make_estimate

    if target_error is not None:
        raise UsageError(
            '--target-error: is no option any more, as intervals of estimates that stop where '
            'islands agree are too narrow; leave it out, and choose --runs'
        )

    with missing_packages_named(out if resume else None):
        campaign = make_options(
            program=scenario, runs=runs, seed=seed, perception=perception,
            settings=scene_settings(settings, airport, runway, apt_dat, aircraft, camera),
            specs=spec or (), out=out, images=images, resume=resume,
            bounds=bound or (), rates=rate or (), controller=controller,
            latency=latency or (), world=world_word(world, renderer_of(camera)), engine=engine,
            audit=audit,
        )
        search = make_estimate(
            campaign, floor=down_to, islands=islands, workers=workers
        )
    raise typer.Exit(run_estimate(search, quiet=quiet, as_json=as_json))


def shrink(
    run: FailedRunArgument,
    nominal: NominalOption = None,
    runs: NeededRunsOption = 100,
    workers: WorkersOption = 1,
    cluster: ClusterOption = None,
    out: OutOption = None,
    resume: ResumeOption = False,
    perception: OwnPerceptionOption = None,
    controller: OwnControllerOption = None,
    spec: OwnSpecOption = None,
    images: ImagesOption = 'none',
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    quiet: QuietOption = False,
) -> None:
    """Shrink a failed run to the nearest scenario that still fails.

    Moves its parameters to nominal taxiing one by one, and reports which of them matter.
    """
    from taxinet_ros.cli.run.search import run_shrink
    from taxinet_ros.trials.record.facts import missing_packages_named
    from taxinet_ros.trials.shrink.shrinking import make_shrinking

    with missing_packages_named(run.parent):
        shrinking = make_shrinking(
            run, perception=perception, specs=spec or (), nominal=nominal or (), runs=runs,
            workers=workers, out=out, resume=resume, images=images, controller=controller,
            engine=engine, audit=audit, cluster=cluster,
        )
    raise typer.Exit(run_shrink(shrinking, quiet=quiet))


place_app = command_group('Places where runs take place.')


@place_app.command('list')
def list_places() -> None:
    """List the shipped places."""
    from taxinet_ros.cli.run.place import print_places

    print_places()


@place_app.command('show')
def show_place(
    place: Annotated[
        str,
        typer.Argument(
            metavar='PLACE', help='shipped name, YAML file, or ICAO code with --runway'
        ),
    ],
    runway: RunwayOption = None,
    apt_dat: AptDatOption = None,
    out: PictureOption = None,
) -> None:
    """Describe a place, and draw it from above: runway, markings, pavements, taxi routes."""
    from taxinet_ros.cli.run.place import show_place

    if runway is not None or apt_dat is not None:
        place = airport_place(place, runway, apt_dat)
    show_place(place, out)


aircraft_app = command_group('Aircraft that taxi.')


@aircraft_app.command('list')
def list_aircraft() -> None:
    """List the shipped aircraft."""
    from taxinet_ros.cli.training.rig import print_aircraft

    print_aircraft()


@aircraft_app.command('show')
def show_aircraft(
    aircraft: Annotated[
        str, typer.Argument(metavar='AIRCRAFT', help='shipped name, or YAML file of one')
    ],
    out: PictureOption = None,
) -> None:
    """Load an aircraft, measure what its file leaves out, say what is wrong, and draw it."""
    from taxinet_ros.cli.training.rig import show_aircraft

    show_aircraft(aircraft, out)


def demo(
    out: OutOption = None,
    runs: RunsOption = 10,
    seed: SeedOption = 1,
) -> None:
    """Run ten scenes with both networks and with ground truth.

    Plots paths and camera frames.
    """
    from taxinet_ros.cli.run.demo import run_demo

    raise typer.Exit(run_demo(out, runs=runs, seed=seed))


def up(
    context: typer.Context,
    perception: PerceptionOption = 'taxinet',
    perception_cmd: PerceptionCommandOption = None,
    controller: ControllerOption = 'steering',
    controller_cmd: ControllerCommandOption = None,
    monitor: MonitorOption = None,
    fallback: FallbackOption = None,
    world: WorldOption = 'kmwh',
    camera: RendererOption = 'ours',
    out: Annotated[Path | None, typer.Option(help='folder for bags and logs; must be new')] = None,
    record: Annotated[
        bool, typer.Option('--record/--no-record', help='a bag for every run, or no recorder')
    ] = True,
    images: ImagesOption = 'all',
    latency: LatencyOption = None,
    free: FreeOption = False,
    real_time_factor: FactorOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set', metavar='KEY=VALUE',
            help='a controller gain (steering.heading_gain=1.2); repeatable',
            autocompletion=complete_gain,
        ),
    ] = None,
    restart: Annotated[
        str,
        typer.Option(
            metavar='RULE',
            help='when a node dies: on-failure restarts it, at most 3 times in 60 s; never ends '
            'the graph',
        ),
    ] = 'on-failure',
    domain: Annotated[
        int | None,
        typer.Option(
            min=0, max=232,
            help='ROS domain (default: ROS_DOMAIN_ID, else one not used by another taxinet graph)',
        ),
    ] = None,
    namespace: Annotated[
        str,
        typer.Option(
            metavar='NAME',
            help='prefix of every name in the graph, /clock included, so that several graphs can '
            'share a domain',
        ),
    ] = '',
    silent_after: Annotated[
        float,
        typer.Option(
            min=0.5, max=3600.0, metavar='SECONDS',
            help='report a node that has not answered for this long; on-failure kills it after '
            'three times as long',
        ),
    ] = 10.0,
) -> None:
    """Start every node except the sampler in its own process and keep them running.

    To run scenes, use `ros2 run taxinet_ros scenario_sampler` in another terminal, in the ROS
    domain printed. Ctrl-C ends the current run and the graph in order; a second one kills it. Exit
    code 130 after Ctrl-C, 143 after SIGTERM, 4 if a node could not be kept up.
    """
    from taxinet_ros.cli.run.up import make_up_options, run_up
    from taxinet_ros.core.world import world_word

    if not record:
        refuse_given(context, ('images',), 'has no effect with --no-record; leave one out')
    options = make_up_options(
        perception=word_of(context, 'perception'), controller=controller_of(context),
        out=out, record=record, images=images, settings=settings or (), restart=restart,
        domain=domain, silent_s=silent_after, latency=latency or (),
        free=free, real_time_factor=real_time_factor, namespace=namespace,
        world=world_word(world, None if camera == 'ours' else camera),
    )
    raise typer.Exit(run_up(options))


def check_node(
    context: typer.Context,
    command: Annotated[
        str | None,
        typer.Argument(
            metavar='COMMAND',
            help="command that starts your node, e.g. 'ros2 run my_pkg my_node'; or FILE.py:NAME",
        ),
    ] = None,
    role: Annotated[
        str | None,
        typer.Option(
            metavar='ROLE',
            help='perception or controller (default: detected; --external needs it)',
        ),
    ] = None,
    external: Annotated[
        bool, typer.Option('--external', help='you start the node yourself, without COMMAND')
    ] = False,
    domain: Annotated[
        int | None, typer.Option(min=0, max=232, help='ROS domain (default: a free one)')
    ] = None,
    frames: Annotated[
        int, typer.Option(min=8, max=500, help='number of messages in a run')
    ] = 24,
    patience: Annotated[
        float,
        typer.Option(
            min=0.1, max=3600.0, metavar='SECONDS',
            help='timeout for an answer; three times as long for READY',
        ),
    ] = 10.0,
    log: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE', writable=True, dir_okay=False, help="file for the node's output"
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
) -> None:
    """Test your own node against the lockstep protocol.

    The kit simulates all other nodes: several runs of a few frames, a malformed message, SIGINT and
        SIGTERM. It prints one line per clause of the contract in docs/own_nodes.md: PASS, FAIL with
        the expected and actual behaviour and a fix, or not tried. Exit code: 0 no clause broken, 2
        some clause broken.
    """
    from taxinet_ros.cli.run.check_node import run_check

    if external:
        refuse_given(context, ('log',), 'the output of a node that you start is not seen here')
    raise typer.Exit(run_check(
        command, role=role, external=external, domain=domain, frames=frames, patience_s=patience,
        log=log, as_json=as_json,
    ))


def plugins(
    name: Annotated[
        str | None, typer.Argument(metavar='[NAME]', help='only what stands behind this name')
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List perceptions, controllers, samplers, worlds, commands and more by name.

    Those that are shipped and those of installed packages, with the package's version and where
    in it each is; also those that cannot be used, with the reason. Exit code 0; with a NAME, 2
    where it cannot be used.
    """
    from taxinet_ros.cli.run.plugins import show_plugins

    raise typer.Exit(show_plugins(name, as_json=as_json))


def experiment(
    file: Annotated[
        str,
        typer.Argument(
            metavar='FILE', help='shipped experiment (shadows, shadows_afternoon, crossing, '
            'light) or a YAML file', autocompletion=complete_experiment,
        ),
    ],
    out: Annotated[Path | None, typer.Option(help='folder for the arms; must be new')] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help="number of scenes (default: the file's)")
    ] = None,
    perception: Annotated[
        str | None,
        typer.Option(
            metavar='WORD|FILE', help="network (default: the file's)",
            autocompletion=complete_perception,
        ),
    ] = None,
    workers: Annotated[int, typer.Option(help='graphs run in parallel; same results')] = 1,
    cluster: ClusterOption = None,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue an interrupted command in --out')
    ] = False,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    as_json: JsonOption = False,
) -> None:
    """Confirm a cause by running the same scenes with and without it.

    Each arm of the experiment is a separate campaign; runs of the same scene are compared in pairs.
    """
    from taxinet_ros.cli.run.search import run_experiment
    from taxinet_ros.errors import UsageError
    from taxinet_ros.trials.experiment import find_experiment, read_experiment, with_network
    from taxinet_ros.trials.options import DEFAULT_ROOT, new_folder
    from taxinet_ros.trials.record.facts import missing_packages_named

    if resume and out is None:
        raise UsageError('--resume: name the experiment to continue with --out')
    with missing_packages_named(out if resume else None):
        asked = read_experiment(find_experiment(file))
    if runs is not None:
        asked = dataclasses.replace(asked, runs=runs)
    if perception is not None:
        asked = with_network(asked, perception)
    raise typer.Exit(
        run_experiment(
            asked, out or new_folder(DEFAULT_ROOT / f'experiment-{asked.name}'),
            workers=workers, resume=resume, as_json=as_json, engine=engine, audit=audit,
            cluster=cluster,
        )
    )
