"""Arguments and options that several commands take, with their help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ScenarioArgument = Annotated[
    str, typer.Argument(metavar='SCENARIO', help='shipped program (s_falsif, …) or a .scenic file')
]
RunsOption = Annotated[int, typer.Option(min=1, help='number of scenes to draw and run')]
SeedOption = Annotated[int, typer.Option(min=0, help='seed of the scenes')]
OutOption = Annotated[Path | None, typer.Option(help='folder for bags and table; must be new')]
PerceptionOption = Annotated[
    str,
    typer.Option(
        help='truth, taxinet, original, a .safetensors weights file, or an .onnx network'
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
        help='phi_eventually (default), phi_always, on_runway, NAME=FORMULA or a formula; '
        'repeatable, the first is the headline',
    ),
]
ProcessesOption = Annotated[
    bool, typer.Option('--processes', help='every node a process of its own, same results')
]
ImagesOption = Annotated[
    str, typer.Option(help='camera frames that go into the bags: all (35 MB a run) or none')
]

MostRunsOption = Annotated[
    int, typer.Option(min=1, help='most runs; with --resume, those of before included')
]
SamplerOption = Annotated[
    str,
    typer.Option(
        help='how scenes are chosen: random, halton, sobol, grid, ce, ce-verifai, mab, bo, tpe '
        'or cmaes'
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
    float | None, typer.Option(metavar='MINUTES', help='begin no run after so long')
]
QuietOption = Annotated[bool, typer.Option('--quiet', help='print the summary only')]
PicturesArgument = Annotated[
    str | None, typer.Argument(metavar='SCENARIO', help='program to render pictures of')
]
VariedOption = Annotated[
    bool, typer.Option('--varied', help='vary the look of the rendered world')
]
