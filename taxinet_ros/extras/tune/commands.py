"""``taxinet tune``: steering gains that satisfy a requirement by the largest worst-case margin."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.cli.completion import complete_gain
from taxinet_ros.cli.options import (
    JsonOption,
    PerceptionOption,
    ProcessesCountOption,
    SeedOption,
    SpecOption,
)
from taxinet_ros.cli.progress import trial_bar
from taxinet_ros.cli.show import line_console
from taxinet_ros.core.motion.controller import SteeringGains, typed_gain
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.extras.tune.tuning import (
    GAIN_PREFIX,
    Candidate,
    Tuned,
    TuneOptions,
    Tuning,
    tuned_json,
    varied_gains,
)
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import json_text
from taxinet_ros.trials.options import DEFAULT_ROOT
from taxinet_ros.trials.past_runs.shared_scenes import scenes_of_program
from taxinet_ros.trials.rates import rate
from taxinet_ros.trials.requirements import DEFAULT_JUDGING, read_specs
from taxinet_ros.trials.run_command import RunSettings

JSON_NAME = 'tune.json'
_TEXT = Path(__file__).with_name('show.j2')


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
) -> int:
    """Tune the steering law: search gains that maximise the worst-case robustness over scenes.

    The gains found are judged, beside the initial ones, on scenes that the search has not seen.
    Runs are in the closed loop without ROS. After an interrupt, the same command continues. Exit
    code 3 if no gains are better beyond doubt.
    """
    console = line_console(stderr=as_json)
    judging = Judging(specs=read_specs(spec)) if spec else DEFAULT_JUDGING
    out = out or DEFAULT_ROOT / f'tune-{Path(program).stem}'
    varied, start = varied_gains(vary or ()), _start(initial or ())
    # The other scenes have another seed.
    learning, others = (
        scenes_of_program(program, runs=runs, seed=each, judging=judging)
        for runs, each in ((scenes, seed), (unseen, seed + 1))
    )
    options = TuneOptions(
        learning=learning, unseen=others, perception=perception, varied=varied, start=start,
        candidates=candidates, seed=seed, workers=workers,
    )
    with Tuning(options, out) as tuning:
        console.print(
            f'tune {program}: {candidates} candidates of {len(varied)} gains on {scenes} scenes, '
            f'{perception} -> {out}',
        )
        tuned = _run(tuning, console)
    if tuned is None:
        console.print('interrupted; the same command goes on')
        return ExitCode.INTERRUPTED
    text = json_text(tuned_json(tuned, options))
    write_atomically(out / JSON_NAME, f'{text}\n')
    tried = RunSettings(perception=perception, gains=tuned.found.gains, judging=judging)
    console.print(macro_text(
        _TEXT, 'tuned', t=tuned, rate=rate, command=tried.command(learning.source, verb='falsify'),
    ))
    console.print(f'written: {out / JSON_NAME}')
    if as_json:
        print(text)
    return ExitCode.OK if tuned.verdict == 'better' else ExitCode.INCOMPLETE


def _start(settings: Sequence[str]) -> dict[str, float]:
    found = {}
    for text in settings:
        key, equals, value = text.partition('=')
        if not equals or not key.startswith(GAIN_PREFIX):
            raise UsageError(
                f'--set {text}: expected steering.GAIN=VALUE; scenes are as the program draws them'
            )
        name = key.removeprefix(GAIN_PREFIX)
        found[name] = typed_gain(name, value)
    SteeringGains(**found)
    return found


def _run(tuning: Tuning, console: Console) -> Tuned | None:
    candidates = itertools.count(1)
    options = tuning.options
    most = options.candidates * len(options.learning.scenes) + 2 * len(options.unseen.scenes)

    def on_candidate(one: Candidate) -> None:
        number = next(candidates)
        if one.best and one.worst is not None:
            words = 'initial gains' if number == 1 else gain_words(one)
            console.print(f'{number:4}  rho {rho_text(one.worst)} at worst, {one.scene}  {words}')

    with trial_bar(console, 'runs, at most', most) as (count, interrupted):
        return tuning.run(on_candidate, count, interrupted)


def gain_words(one: Candidate) -> str:
    """Gains of a candidate as options of a command."""
    return ' '.join(f'--set {GAIN_PREFIX}{name}={value:.4g}' for name, value in one.gains.items())
