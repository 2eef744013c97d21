"""Arguments and options that several commands take, and which of them somebody has typed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from taxinet_ros.core.user_code import COMMAND
from taxinet_ros.errors import UsageError


def given_options(context: typer.Context) -> dict[str, Any]:
    """The parameters of a command that its command line sets, by name."""
    return {
        name: value for name, value in context.params.items()
        if getattr(context.get_parameter_source(name), 'name', '') == 'COMMANDLINE'
    }


def asks_for_study(word: str, words: Sequence[str], given: Collection[str]) -> bool:
    """Whether the words after ``taxinet bench`` ask for a study of the samplers.

    Args:
        word: that asks for it.
        words: the subjects.
        given: names of the parameters that the command line sets.

    Raises:
        UsageError: the word is not the first, or options do not belong to it.
    """
    if word not in words:
        return False
    if words[0] != word:
        raise UsageError(f'bench: {word} goes first, and what it is to study after it')
    wrong = set(given) - {'repeats', 'as_json', 'subjects'}
    if wrong:
        raise UsageError(f'bench: --{min(wrong)}: not with {word}')
    return True


def word_of(context: typer.Context, role: str) -> str:
    """Who plays a role in the graph: the word of its option, or of the command for it.

    Args:
        context: of a command that has the options ``--ROLE`` and ``--ROLE-cmd``.
        role: ``perception`` or ``controller``.

    Raises:
        UsageError: both are given.
    """
    command = context.params[f'{role}_cmd']
    if command is None:
        return str(context.params[role])
    if role in given_options(context):
        raise UsageError(f'--{role}: not with --{role}-cmd, which says who it is; leave one out')
    return f'{COMMAND}{command}'


ScenarioArgument = Annotated[
    str, typer.Argument(metavar='SCENARIO', help='shipped program (s_falsif, …) or a .scenic file')
]
SceneArgument = Annotated[
    str | None,
    typer.Argument(metavar='SCENARIO', help='shipped program (s_falsif, …) or a .scenic file'),
]
FromOption = Annotated[
    Path | None,
    typer.Option(
        '--from', metavar='BAG',
        help="run a bag's scenario once more, with its own perception unless --perception is "
        'given, and compare',
    ),
]
RunOption = Annotated[
    str | None,
    typer.Option('--run', metavar='RUN_ID', help='which run, where the bag holds several'),
]
RunsOption = Annotated[int, typer.Option(min=1, help='number of scenes to draw and run')]
SeedOption = Annotated[int, typer.Option(min=0, help='seed of the scenes')]
OutOption = Annotated[Path | None, typer.Option(help='folder for bags and table; must be new')]
PerceptionOption = Annotated[
    str,
    typer.Option(
        help='truth; taxinet, original or another shipped network; a .safetensors weights file; an '
        '.onnx network; a function in a Python file, FILE.py:NAME; a name that a package adds; or '
        'external, a node that you start'
    ),
]
PerceptionCommandOption = Annotated[
    str | None,
    typer.Option(
        '--perception-cmd', metavar='COMMAND',
        help="start your own node, as in 'ros2 run my_pkg my_node', in every graph",
    ),
]
ControllerOption = Annotated[
    str,
    typer.Option(
        help='steering, the shipped law; a function in a Python file, FILE.py:NAME; a name that a '
        'package adds; or external, a node that you start'
    ),
]
ControllerCommandOption = Annotated[
    str | None,
    typer.Option('--controller-cmd', metavar='COMMAND', help='likewise for the controller'),
]
WorldOption = Annotated[
    str,
    typer.Option(
        metavar='NAME',
        help='where runs take place: kmwh, the simulated airport, or a name that a package adds',
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        '--set', metavar='KEY=VALUE',
        help='fix a scenario value (clouds=clear, time_of_day=9.5, heading=-20, duration=10, …) '
        'or a gain (steering.heading_gain=1.2); repeatable',
    ),
]
SpecOption = Annotated[
    list[str] | None,
    typer.Option(
        '--spec', metavar='FORMULA',
        help='phi_eventually (default), phi_always, on_runway, usable, NAME=FORMULA, a formula '
        'such as "always[10 s:inf](abs(steering) <= 3 deg)", or a YAML file of them; repeatable, '
        'the first is the headline',
    ),
]
StopOnOption = Annotated[
    str,
    typer.Option(
        metavar='RULE',
        help='end a run early: never; violated, when the headline is; decided, when every formula '
        'is',
    ),
]
BoundOption = Annotated[
    list[str] | None,
    typer.Option(
        '--bound', metavar='SIGNAL=LOW:HIGH',
        help='assume that a signal stays in this range, e.g. cte=-25:25 [m]: intervals close '
        'earlier; dropped in a run that leaves the range; repeatable',
    ),
]
RateOption = Annotated[
    list[str] | None,
    typer.Option(
        '--rate', metavar='SIGNAL=CHANGE',
        help='assume that a signal changes by no more than this per second, e.g. cte=3; '
        'repeatable',
    ),
]
LatencyOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar='NAME=LATENCY',
        help='delay after which answers take effect: perception= or controller= SECONDS, '
        'uniform(LOW,HIGH) or normal(MEAN,SD), drawn in each step, rounded up to 0.1 s; '
        'repeatable',
    ),
]
FreeOption = Annotated[
    bool,
    typer.Option(
        '--free',
        help='simulated time follows the wall clock and waits for no node; every node a process; '
        'shows whether timing breaks the loop; results are not reproducible',
    ),
]
FactorOption = Annotated[
    str | None,
    typer.Option(
        '--real-time-factor', metavar='R',
        help='of --free: simulated seconds per second, 0.1 to 100 (default 1), or max',
    ),
]
ProcessesOption = Annotated[
    bool, typer.Option('--processes', help='every node a process of its own, same results')
]
FoxgloveOption = Annotated[
    int | None,
    typer.Option(
        metavar='PORT',
        help='show the runs live in the Foxglove app, at ws://127.0.0.1:PORT (the app proposes '
        '8765); same results',
    ),
]
ImagesOption = Annotated[
    str,
    typer.Option(
        help='runs whose camera frames go into the bags (35 MB a run): all, failures or none; '
        'taxinet bag render puts them in later, bit for bit'
    ),
]
MostRunsOption = Annotated[
    int, typer.Option(min=1, help='most runs; with --resume, those of before included')
]
SamplerOption = Annotated[
    str | None,
    typer.Option(
        help='how scenes are chosen: active (finds rare failures, and all the regions of them), '
        'random, halton, sobol, grid, ce, ce-verifai, mab, bo, tpe, cmaes, or a name that a '
        "package adds; by default as the program's verifaiSamplerType says, else active"
    ),
]
SamplerSettingOption = Annotated[
    list[str] | None,
    typer.Option(
        '--sampler-option', metavar='KEY=VALUE', help='option of the sampler; repeatable'
    ),
]
WorkersOption = Annotated[int, typer.Option(help='graphs that run at once; same results')]
ResumeOption = Annotated[
    bool, typer.Option('--resume', help='continue what was interrupted in --out')
]
UntilOption = Annotated[
    str | None,
    typer.Option(
        metavar='RULE',
        help='stop early: failures=K, or half-width=W of the interval of the failure rate',
    ),
]
BudgetOption = Annotated[
    float | None, typer.Option(metavar='MINUTES', help='start no new run after this time')
]
FailedRunArgument = Annotated[
    Path, typer.Argument(metavar='RUN', help='a failed run: <campaign>/<run>, as its bag is named')
]
OwnPerceptionOption = Annotated[
    str | None, typer.Option('--perception', help="default: the run's own")
]
OwnControllerOption = Annotated[
    str | None, typer.Option('--controller', help="default: the run's own")
]
OwnSpecOption = Annotated[
    list[str] | None,
    typer.Option(
        '--spec', metavar='FORMULA',
        help="other formulas than the run's; the first is the one that has to stay violated",
    ),
]
NominalOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar='KEY=VALUE',
        help='nominal value of a scenario key (time_of_day=12, shadows=off, …); repeatable',
    ),
]
NeededRunsOption = Annotated[int, typer.Option(help='most runs of the search')]
QuietOption = Annotated[bool, typer.Option('--quiet', help='print warnings and the summary only')]
PicturesArgument = Annotated[
    str | None, typer.Argument(metavar='SCENARIO', help='program to render pictures of')
]
VariedOption = Annotated[
    bool, typer.Option('--varied', help='vary the look of the rendered world')
]


CampaignArgument = Annotated[Path, typer.Argument(metavar='CAMPAIGN', help="a campaign's folder")]
ProcessesCountOption = Annotated[
    int, typer.Option('--workers', help='processes that work at once; same results')
]
JsonOption = Annotated[bool, typer.Option('--json', help='print JSON')]
