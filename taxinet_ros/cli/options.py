"""Arguments and options shared by several commands."""

from __future__ import annotations

import inspect
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from taxinet_ros.cli.completion import (
    complete_controller,
    complete_fallback,
    complete_odd,
    complete_perception,
    complete_program,
    complete_renderer,
    complete_sampler,
    complete_sampler_option,
    complete_setting,
    complete_signal,
    complete_spec,
    complete_world,
    one_of,
)
from taxinet_ros.cli.help import LATER
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.trials.options import CampaignOptions


def given_options(context: typer.Context) -> dict[str, Any]:
    """Parameters given on the command line, by name."""
    return {
        name: value for name, value in context.params.items()
        if getattr(context.get_parameter_source(name), 'name', '') == 'COMMANDLINE'
    }


def refuse_given(context: typer.Context, names: Collection[str], why: str) -> None:
    """Refuse parameters that would have no effect.

    Args:
        context: context of the command.
        names: names of its parameters.
        why: reason, put behind the option.

    Raises:
        UsageError: one of them is given on the command line.
    """
    if given := given_among(context, names):
        raise UsageError(f'{given[0]}: {why}')


def given_among(context: typer.Context, names: Collection[str]) -> list[str]:
    """Those of some parameters that are given on the command line, as options."""
    given = given_options(context)
    return [
        max(parameter.opts, key=len) for parameter in context.command.params
        if parameter.name in names and parameter.name in given
    ]


def ended(code: int, exit_zero: bool) -> typer.Exit:
    """The end of a command; with ``--exit-zero``, violated requirements are not its exit code."""
    return typer.Exit(ExitCode.OK if exit_zero and code == ExitCode.VIOLATED else code)


def controller_of(context: typer.Context) -> str:
    """Word of the controller, under its monitor if one is named.

    Raises:
        UsageError: options exclude each other, or one has no effect.
    """
    from taxinet_ros.core.assurance.switch import monitored

    params = context.params
    return monitored(params['controller'], params.get('monitor'), params.get('fallback'))


def campaign_of(context: typer.Context, **own: Any) -> CampaignOptions:
    """Campaign that the parameters of a command ask for.

    A parameter with the name of a field of :class:`.CampaignOptions`, or of a parameter of
    :func:`.make_options`, is passed on, except ``workers`` and ``cluster``, which are checked
    against the finished campaign.

    Args:
        context: context of the command.
        own: values that the command sets itself.

    Raises:
        UsageError: one line on the first error.
    """
    from taxinet_ros.core.world import world_word
    from taxinet_ros.trials.options import CampaignOptions, make_options

    names = {
        name for asked in (make_options, CampaignOptions)
        for name in inspect.signature(asked).parameters
    } - {'workers', 'cluster'}
    params = {
        name: value for name, value in context.params.items()
        if name in names and value is not None
    }
    given = {
        **params, 'controller': controller_of(context),
        'world': world_word(context.params['world'], context.params['camera']), **own,
    }
    return make_options(**{**given, 'out': Path(given['out']) if 'out' in given else None})


_PROGRAM = typer.Argument(
    metavar='SCENARIO', help='shipped program (s_falsif, …) or a .scenic file',
    autocompletion=complete_program,
)
ScenarioArgument = Annotated[str, _PROGRAM]
SceneArgument = Annotated[str | None, _PROGRAM]
FromOption = Annotated[
    Path | None,
    typer.Option(
        '--from', metavar='BAG',
        help="rerun a bag's scenario, with its own perception unless --perception is given, and "
        'compare; or the folder of a `taxinet score --simulate`: start where that recording began',
    ),
]
BagArgument = Annotated[
    Path, typer.Argument(metavar='BAG', help='folder of a run, or an .mcap file')
]
RunOption = Annotated[
    str | None,
    typer.Option(
        '--run', rich_help_panel=LATER, metavar='RUN_ID',
        help='which run, if the bag holds several',
    ),
]
RunsOption = Annotated[int, typer.Option(min=1, help='number of scenes to draw and run')]
SeedOption = Annotated[int, typer.Option(min=0, help='seed of the scenes')]
PictureOption = Annotated[
    Path | None,
    typer.Option(
        metavar='FILE.png', writable=True, dir_okay=False,
        help='picture to write; must be new (default: below bags/)',
    ),
]
YamlOption = Annotated[
    Path | None,
    typer.Option(
        '--yaml', metavar='FILE.yaml', writable=True, dir_okay=False,
        help='also write it as a YAML file, to be changed; must be new',
    ),
]
OutOption = Annotated[Path | None, typer.Option(help='folder for bags and table; must be new')]
PerceptionOption = Annotated[
    str,
    typer.Option(
        help='truth; taxinet, original or another shipped network; a .safetensors weights file; an '
        '.onnx network; a function in a Python file, FILE.py:NAME; a name that a package adds; a '
        "node of your own, by the command that starts it in every graph, 'cmd:ros2 run my_pkg "
        "my_node'; or external, a node you start yourself",
        autocompletion=complete_perception,
    ),
]
ControllerOption = Annotated[
    str,
    typer.Option(
        help='steering, the shipped law; hold_short, which also stops at hold lines; a function in '
        'a Python file, FILE.py:NAME; a name that a package adds; cmd:COMMAND, which starts a node '
        'of your own; or external, a node you start yourself',
        autocompletion=complete_controller,
    ),
]
MonitorOption = Annotated[
    str | None,
    typer.Option(
        '--monitor', rich_help_panel=LATER, metavar='MONITOR',
        help='judge each estimate as it comes: original, taxinet, a file of `taxinet assure '
        'calibrate`, or a function, FILE.py:NAME',
        autocompletion=one_of('original', 'taxinet'),
    ),
]
FallbackOption = Annotated[
    str | None,
    typer.Option(
        '--fallback', rich_help_panel=LATER, metavar='WHAT',
        help="after the monitor's first alarm: stop (default), slow, second:PERCEPTION, or watch, "
        'which changes nothing',
        autocompletion=complete_fallback,
    ),
]
WorldOption = Annotated[
    str,
    typer.Option(
        rich_help_panel=LATER, metavar='NAME',
        help='where runs take place: kmwh, the simulated airport, or a name that a package adds',
        autocompletion=complete_world,
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        '--set', metavar='KEY=VALUE',
        help='fix a scenario value (clouds=clear, time_of_day_h=9.5, heading_deg=-20, '
        'duration_s=10, …) or a gain (steering.heading_gain=1.2), with its unit or another (9:30, '
        '30 %, 1.2 km, 10 deg); repeatable',
        autocompletion=complete_setting,
    ),
]
ScenarioOption = Annotated[
    list[str] | None,
    typer.Option(
        '--set', metavar='KEY=VALUE',
        help='a scenario value (cross_track_m=-3, heading_deg=10, distance_m=900, '
        'time_of_day_h=16, clouds=broken, rain_percent=50, shadows=off, date=2020-06-21, …); '
        'repeatable',
        autocompletion=complete_setting,
    ),
]
_CAMERA = typer.Option(
    '--camera', metavar='NAME|FILE',
    help="who takes the pictures: ours, a name that a package adds, or FILE.py:NAME (a scenario's "
    'key camera mounts another of ours)', autocompletion=complete_renderer,
)
RendererOption = Annotated[str, _CAMERA]
WorldCameraOption = Annotated[str | None, _CAMERA]
SpecOption = Annotated[
    list[str] | None,
    typer.Option(
        '--spec', metavar='FORMULA',
        help='phi_eventually (default), phi_always, on_runway, usable, NAME=FORMULA, a formula '
        'such as "always[10 s:inf](abs(steering) <= 3 deg)", or a YAML file of them; repeatable, '
        'the first is the headline',
        autocompletion=complete_spec,
    ),
]
ExaminedOption = Annotated[
    str | None,
    typer.Option(
        '--spec', metavar='NAME',
        help='requirement to look into (default: the headline if a run violates it, else the one '
        'that most runs violate)',
    ),
]
StopOnOption = Annotated[
    str,
    typer.Option(
        metavar='RULE',
        help='end a run early: never; violated, when the headline is; decided, when every formula '
        'is',
        autocompletion=one_of('never', 'violated', 'decided'),
    ),
]
BoundOption = Annotated[
    list[str] | None,
    typer.Option(
        '--bound', rich_help_panel=LATER, metavar='SIGNAL=LOW:HIGH',
        help='assume that a signal stays in this range, e.g. cte=-25:25 [m], so that verdicts come '
        'earlier; dropped in a run that leaves the range; repeatable',
        autocompletion=complete_signal,
    ),
]
RateOption = Annotated[
    list[str] | None,
    typer.Option(
        '--rate', rich_help_panel=LATER, metavar='SIGNAL=CHANGE',
        help='assume that a signal changes by no more than this per second, e.g. cte=3; '
        'repeatable',
        autocompletion=complete_signal,
    ),
]
LatencyOption = Annotated[
    list[str] | None,
    typer.Option(
        rich_help_panel=LATER, metavar='NAME=LATENCY',
        help='latency of perception= or controller=: SECONDS, uniform(LOW,HIGH) or '
        'normal(MEAN,SD), drawn at each step, rounded up to control steps; repeatable',
        autocompletion=one_of('perception=', 'controller='),
    ),
]
FreeOption = Annotated[
    bool,
    typer.Option(
        '--free',
        rich_help_panel=LATER,
        help='simulated time follows the wall clock and waits for no node; every node is a '
        'process; shows timing problems of the loop; results are not reproducible',
    ),
]
FactorOption = Annotated[
    str | None,
    typer.Option(
        '--real-time-factor', rich_help_panel=LATER, metavar='R',
        help='with --free: simulated seconds per wall-clock second, 0.1 to 100 (default 1), or max',
    ),
]
ProcessesOption = Annotated[
    bool,
    typer.Option(
        '--processes', rich_help_panel=LATER,
        help='run every node in its own process; same results',
    ),
]
EngineOption = Annotated[
    str,
    typer.Option(
        metavar='ENGINE',
        help='what makes the runs: graph, the nodes on ROS topics; or loop, the closed loop in one '
        'process without ROS, with the same rows and bags',
        autocompletion=one_of('graph', 'loop'),
    ),
]
AuditOption = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=LATER, metavar='PERCENT',
        help='with --engine loop: share of the runs to repeat on the graph; a difference ends the '
        'command (default: 1 %)',
    ),
]
FoxgloveOption = Annotated[
    int | None,
    typer.Option(
        metavar='PORT',
        help="show the runs live in the Foxglove app, at ws://127.0.0.1:PORT (the app's default "
        'is 8765); same results',
    ),
]
_IMAGES = one_of('all', 'failures', 'none')
ImagesOption = Annotated[
    str,
    typer.Option(
        help='runs whose camera frames are recorded (35 MB a run): all, failures or none; taxinet '
        'bag render adds them later, bit for bit',
        autocompletion=_IMAGES,
    ),
]
RunImagesOption = Annotated[
    str | None,
    typer.Option(
        help='runs whose camera frames are recorded (35 MB a run): all, failures or none (default: '
        'all for a single run, else failures); taxinet bag render adds them later, bit for bit',
        autocompletion=_IMAGES,
    ),
]
MostRunsOption = Annotated[
    int, typer.Option(min=1, help='maximum number of runs; with --resume, including earlier ones')
]
SamplerOption = Annotated[
    str | None,
    typer.Option(
        help='how scenes are chosen: active (finds rare failures in all failure regions), '
        'random, halton, sobol, grid, coverage (where no run has been), ce, mab, bo, '
        'tpe, cmaes, stress (towards the likeliest failure), or a name that a package adds '
        "(default: the program's verifaiSamplerType, else active)",
        autocompletion=complete_sampler,
    ),
]
SamplerSettingOption = Annotated[
    list[str] | None,
    typer.Option(
        '--sampler-option', rich_help_panel=LATER, metavar='KEY=VALUE',
        help='option of the sampler; repeatable',
        autocompletion=complete_sampler_option,
    ),
]
OddOption = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=LATER, metavar='NAME|FILE.yaml',
        help='with --sampler coverage: cover the cells of this operational design domain '
        '(docs/odd.md), not those of the program',
        autocompletion=complete_odd,
    ),
]
ObjectiveOption = Annotated[
    str | None,
    typer.Option(
        metavar='RULES', help='what the sampler minimises, of several --spec: a rulebook, the '
        "most important first, as 'no_collision > on_runway, usable' (default: the first --spec)",
    ),
]
WorkersOption = Annotated[int, typer.Option(help='graphs run in parallel; same results')]
LagOption = Annotated[
    int,
    typer.Option(
        rich_help_panel=LATER, metavar='RUNS',
        help='how many runs may be under way while the next scene is chosen; changing it changes '
        'which scenes are drawn',
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        rich_help_panel=LATER, metavar='WHERE',
        help='make the runs on a Dask cluster, with the same results: tcp://HOST:PORT or '
        'tls://HOST:PORT of its scheduler, the FILE of dask scheduler --scheduler-file, or local:N',
    ),
]
ResumeOption = Annotated[
    bool, typer.Option('--resume', help='continue an interrupted command in --out')
]
UntilOption = Annotated[
    str | None,
    typer.Option(
        metavar='RULE',
        help='stop early: failures=K; half-width=W of the interval of the failure rate; or as soon '
        'as a sequential test decides, min-satisfaction=SHARE or max-off-runway=SHARE with '
        ',design=SHARE and ,confidence=SHARE if wanted (then taxinet gate --sequential)',
        autocompletion=one_of(
            'failures=', 'half-width=', 'min-satisfaction=', 'max-off-runway=',
        ),
    ),
]
BudgetOption = Annotated[
    float | None, typer.Option(metavar='MINUTES', help='start no new run after this time')
]
FailedRunArgument = Annotated[
    Path, typer.Argument(metavar='RUN', help='a failed run: <campaign>/<run>, the path of its bag')
]
OwnPerceptionOption = Annotated[
    str | None, typer.Option(
        '--perception', help="default: the run's own",
        autocompletion=complete_perception,
    )
]
OwnControllerOption = Annotated[
    str | None, typer.Option(
        '--controller', help="default: the run's own",
        autocompletion=complete_controller,
    )
]
OwnSpecOption = Annotated[
    list[str] | None,
    typer.Option(
        '--spec', metavar='FORMULA',
        help="formulas instead of the run's; the first must stay violated",
        autocompletion=complete_spec,
    ),
]
NominalOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar='KEY=VALUE',
        help='nominal value of a scenario key (time_of_day_h=12, shadows=off, …); repeatable',
        autocompletion=complete_setting,
    ),
]
NeededRunsOption = Annotated[int, typer.Option(help='maximum number of runs of the search')]
QuietOption = Annotated[bool, typer.Option('--quiet', help='print warnings and the summary only')]
VariedOption = Annotated[
    bool, typer.Option('--varied', help='vary the appearance of the rendered world')
]


CampaignArgument = Annotated[Path, typer.Argument(metavar='CAMPAIGN', help="a campaign's folder")]
ProcessesCountOption = Annotated[
    int, typer.Option('--workers', help='worker processes; same results')
]
ExitZeroOption = Annotated[
    bool,
    typer.Option(
        '--exit-zero', rich_help_panel=LATER,
        help='exit with 0 also if runs violate their requirements',
    ),
]
JsonSummaryOption = Annotated[
    bool,
    typer.Option('--json', help='print the summary as JSON; all else goes to standard error'),
]
JsonOption = Annotated[bool, typer.Option('--json', help='print JSON')]
