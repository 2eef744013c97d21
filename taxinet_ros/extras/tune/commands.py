"""``taxinet tune``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.completion import complete_gain
from taxinet_ros.cli.options import (
    JsonOption,
    PerceptionOption,
    ProcessesCountOption,
    SeedOption,
    SpecOption,
)


def tune(
    program: Annotated[
        str, typer.Argument(metavar='[SCENARIO]', help='program whose scenes the gains should '
        'handle')
    ] = 's_falsif',
    vary: Annotated[
        list[str] | None,
        typer.Option(metavar='steering.GAIN=LOW:HIGH', help='gain to vary, and its range; '
        'repeatable (default: cte_gain_rad_per_m, max_intercept_rad and heading_gain, from a '
        'quarter to four times the default)'),
    ] = None,
    initial: Annotated[
        list[str] | None,
        typer.Option(
            '--set', metavar='steering.GAIN=VALUE', help='initial gain; repeatable',
            autocompletion=complete_gain,
        ),
    ] = None,
    candidates: Annotated[
        int, typer.Option(min=2, help='gains to try, the initial ones first')
    ] = 50,
    scenes: Annotated[int, typer.Option(min=1, help='scenes of the search')] = 40,
    unseen: Annotated[
        int, typer.Option(min=1, help='other scenes, on which the result is judged')
    ] = 200,
    perception: PerceptionOption = 'taxinet',
    spec: SpecOption = None,
    seed: SeedOption = 0,
    workers: ProcessesCountOption = 2,
    out: Annotated[
        Path | None, typer.Option(help='folder for result and record; finished runs in it are kept')
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Tune the steering law: search gains that maximise the worst-case robustness over scenes.

    The gains found are judged, beside the initial ones, on scenes that the search has not seen.
    Runs are in the closed loop without ROS. After an interrupt, the same command continues. Exit
    code 3 if no gains are better beyond doubt.
    """
    from taxinet_ros.extras.tune.show import run_tune

    raise typer.Exit(run_tune(
        program, out, perception=perception, vary=vary or (), settings=initial or (),
        specs=spec or (), candidates=candidates, scenes=scenes, unseen=unseen, seed=seed,
        workers=workers, as_json=as_json,
    ))
