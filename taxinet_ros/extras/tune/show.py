"""``taxinet tune``: steering gains that satisfy a requirement by the largest worst-case margin."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.cli.progress import trial_bar
from taxinet_ros.core.motion.controller import SteeringGains, typed_gain
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


def run_tune(
    program: str, out: Path | None, *, perception: str, vary: Sequence[str],
    settings: Sequence[str], specs: Sequence[str], candidates: int, scenes: int, unseen: int,
    seed: int, workers: int, as_json: bool,
) -> int:
    """Search gains, judge them, and print what was found.

    Args:
        program: program of the scenes.
        out: folder; None: one below ``bags/``.
        perception: word or file.
        vary: ``steering.GAIN=LOW:HIGH`` texts.
        settings: ``steering.GAIN=VALUE`` of the initial gains.
        specs: requirements; the first counts.
        candidates: number of candidates.
        scenes: number of scenes of the search.
        unseen: number of others.
        seed: seed of the scenes of the search and of the proposals; the others' is one more.
        workers: processes.
        as_json: print ``tune.json``.

    Returns:
        Exit code: 0 better gains were found, 3 none that are better beyond doubt, 130 interrupted;
        the same command continues.

    Raises:
        UsageError: bad input.
        InfraError: the initial gains cannot be judged.
    """
    console = Console(emoji=False, highlight=False, markup=False, stderr=as_json)
    judging = Judging(specs=read_specs(specs)) if specs else DEFAULT_JUDGING
    out = out or DEFAULT_ROOT / f'tune-{Path(program).stem}'
    varied, start = varied_gains(vary), _start(settings)
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
            f'{perception} -> {out}', soft_wrap=True,
        )
        tuned = _run(tuning, console)
    if tuned is None:
        console.print('interrupted; the same command goes on', soft_wrap=True)
        return ExitCode.INTERRUPTED
    text = json_text(tuned_json(tuned, options))
    write_atomically(out / JSON_NAME, f'{text}\n')
    tried = RunSettings(perception=perception, gains=tuned.found.gains, judging=judging)
    console.print(macro_text(
        Path(__file__).with_suffix('.j2'), 'tuned', t=tuned, rate=rate,
        command=tried.command(learning.source, verb='falsify'),
    ), soft_wrap=True)
    console.print(f'written: {out / JSON_NAME}', soft_wrap=True)
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
        if one.best:
            words = 'initial gains' if number == 1 else gain_words(one)
            console.print(
                f'{number:4}  rho {one.worst:+.2f} at worst, {one.scene}  {words}', soft_wrap=True,
            )

    with trial_bar(console, 'runs, at most', most) as (count, interrupted):
        return tuning.run(on_candidate, count, interrupted)


def gain_words(one: Candidate) -> str:
    """Gains of a candidate as options of a command."""
    return ' '.join(f'--set {GAIN_PREFIX}{name}={value:.4g}' for name, value in one.gains.items())
