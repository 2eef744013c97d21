"""``taxinet tune``: steering gains that satisfy a requirement by the largest worst-case margin."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.console import Console

from taxinet_ros.analysis.report.parts import Picture, Theme, style_axes
from taxinet_ros.campaign.options import DEFAULT_JUDGING, DEFAULT_ROOT, make_out, read_specs
from taxinet_ros.campaign.past_runs.shared_scenes import scenes_of_program
from taxinet_ros.campaign.rates import rate
from taxinet_ros.campaign.run_command import RunSettings
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.motion.controller import GAIN_RANGES, SteeringGains, typed_gain
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.extras.tune.tuning import (
    GAIN_PREFIX,
    TRIALS_NAME,
    Candidate,
    Tuned,
    TuneOptions,
    Tuning,
    tuned_json,
    varied_gains,
)
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.processes.interrupts import interrupts

JSON_NAME, PICTURE = 'tune.json', 'tune'
_OURS = {JSON_NAME, f'{PICTURE}.png', TRIALS_NAME}


@dataclass(frozen=True, kw_only=True)
class TuneArguments:
    """Arguments of ``taxinet tune``.

    Attributes:
        program: program of the scenes.
        perception: word or file.
        vary: ``steering.GAIN=LOW:HIGH`` texts.
        settings: ``steering.GAIN=VALUE`` of the initial gains.
        specs: requirements; the first counts.
        candidates, scenes, unseen: numbers of candidates, of scenes of the search, and of others.
        seed: seed of the scenes of the search and of the proposals; the others' is one more.
        workers: processes.
        out: folder; None: one below ``bags/``.
        as_json: print ``tune.json``.
    """

    program: str
    perception: str
    vary: Sequence[str]
    settings: Sequence[str]
    specs: Sequence[str]
    candidates: int
    scenes: int
    unseen: int
    seed: int
    workers: int
    out: Path | None
    as_json: bool


def run_tune(given: TuneArguments) -> int:
    """Search gains, judge them, and print what was found.

    Returns:
        Exit code: 0 better gains were found, 3 none that are better beyond doubt, 130 interrupted;
        the same command continues.

    Raises:
        UsageError: bad input.
        InfraError: the initial gains cannot be judged.
    """
    console = Console(highlight=False, stderr=given.as_json)
    varied, start = varied_gains(given.vary), _start(given.settings)
    judging = Judging(specs=read_specs(given.specs)) if given.specs else DEFAULT_JUDGING
    out = given.out or DEFAULT_ROOT / f'tune-{Path(given.program).stem}'
    if out.is_dir() and {path.name for path in out.iterdir()} - _OURS:
        raise UsageError(f'--out {out}: contains something else; choose another folder')
    learning, unseen = (
        scenes_of_program(given.program, runs=runs, seed=seed, judging=judging)
        for runs, seed in ((given.scenes, given.seed), (given.unseen, given.seed + 1))
    )
    options = TuneOptions(
        learning=learning, unseen=unseen, perception=given.perception, varied=varied, start=start,
        candidates=given.candidates, seed=given.seed, workers=given.workers,
    )
    options.check()
    make_out(out)
    console.print(
        f'tune {given.program}: {given.candidates} candidates of {len(varied)} gains on '
        f'{given.scenes} scenes, {given.perception} -> {out}', soft_wrap=True, markup=False,
    )
    tuned = _run(options, out, console)
    if tuned is None:
        console.print('interrupted; the same command goes on', soft_wrap=True)
        return ExitCode.INTERRUPTED
    values = tuned_json(tuned, options)
    write_atomically(out / JSON_NAME, json.dumps(values, indent=2, allow_nan=False) + '\n')
    _write_picture(tuned, options, out)
    for line in tuned_lines(tuned, options):
        console.print(line, soft_wrap=True, markup=False)
    console.print(f'written: {out / JSON_NAME}, {PICTURE}.png', soft_wrap=True, markup=False)
    if given.as_json:
        print(json.dumps(values, indent=2, allow_nan=False))
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


def _run(options: TuneOptions, out: Path, console: Console) -> Tuned | None:
    asked: list[bool] = []
    most = options.candidates * len(options.learning.scenes) + 2 * len(options.unseen.scenes)
    with (
        Tuning(options, out) as tuning, stage_bars(console) as show,
        interrupts(lambda: asked.append(True)),
    ):
        runs, number = 0, 0

        def on_run() -> None:
            nonlocal runs
            runs += 1
            show('runs, at most', runs, most)

        def on_candidate(one: Candidate) -> None:
            nonlocal number
            number += 1
            if one.best:
                words = 'initial gains' if number == 1 else gain_words(one)
                console.print(
                    f'{number:4}  rho {one.worst:+.2f} at worst, {one.scene}  {words}',
                    soft_wrap=True, markup=False,
                )

        return tuning.run(on_candidate, on_run, lambda: bool(asked))


def gain_words(one: Candidate) -> str:
    """Gains of a candidate as options of a command."""
    return ' '.join(f'--set {GAIN_PREFIX}{name}={value:.4g}' for name, value in one.gains.items())


def tuned_lines(tuned: Tuned, options: TuneOptions) -> list[str]:
    """Text lines on a result."""
    start, found, scenes = tuned.start, tuned.found, tuned.scenes
    most = len(tuned.candidates) * scenes
    broken = sum(one.worst is None for one in tuned.candidates)
    lines = [
        f'searched: {len(tuned.candidates)} candidates, {tuned.runs:,} runs; '
        f'{most - tuned.runs:,} of {most:,} were not needed, as their candidates could not win'
    ]
    if broken:
        lines.append(f'not judged: {broken} candidates, whose runs broke')
    if tuned.verdict == 'same':
        return [*lines, f'no candidate is better at its worst than the initial gains '
                        f'(rho {start.worst:+.2f} in {start.scene}); more --candidates or wider '
                        'ranges (--vary) may find some']
    lines.append(
        f'worst of {scenes} scenes: rho {start.worst:+.2f} before ({start.scene}), '
        f'{found.worst:+.2f} now ({found.scene})'
    )
    rates, change = tuned.satisfied, tuned.rho.change
    pairs = rates.pairs
    if tuned.unjudged:
        lines.append(
            f'{len(tuned.unjudged)} unseen scenes could not be judged: '
            f'{", ".join(tuned.unjudged[:5])}'
        )
    if pairs:
        worst = [min(rhos.values()) for rhos in (tuned.before, tuned.after)]
        lines += [
            f'on {pairs} unseen scenes: {rate(rates.first, pairs).words()} satisfied before, '
            f'{rate(rates.second, pairs).words()} now; {rates.only_second} only now, '
            f'{rates.only_first} only before (McNemar p = {rates.p_value:.2g})',
            f'worst rho there: {worst[0]:+.2f} before, {worst[1]:+.2f} now; typical change '
            f'{_interval(change)}',
        ]
    lines.append({
        'better': 'better on scenes that the search has not seen',
        'worse': 'WORSE on scenes that the search has not seen: keep the initial gains',
        'unclear': 'not shown to be better on scenes that the search has not seen: keep the '
        'initial gains; more --unseen scenes may tell',
    }[tuned.verdict])
    if tuned.verdict == 'better':
        lines.append(
            'next: ' + RunSettings(
                perception=options.perception, gains=found.gains, judging=options.learning.judging,
            ).command(options.learning.source, verb='falsify')
        )
    return lines


def _interval(change: Sequence[float]) -> str:
    value, low, high = change
    if math.isnan(low):
        return f'{value:+.3f}'
    return f'{value:+.3f} ({low:+.3f} to {high:+.3f})'


def _write_picture(tuned: Tuned, options: TuneOptions, out: Path) -> None:
    from taxinet_ros.analysis.report.pictures import LIGHT, write_png

    width = 3.2 * (1 + len(options.varied))
    write_png(Picture(
        name=PICTURE, title='Search for gains', caption='', size_in=(width, 3.4),
        draw=partial(_draw, tuned, options),
    ), out, LIGHT)


def _draw(tuned: Tuned, options: TuneOptions, figure: Figure, theme: Theme) -> None:
    columns = figure.subplots(1, 1 + len(options.varied), sharey=True, squeeze=False)[0]
    known = [(number, one) for number, one in enumerate(tuned.candidates, 1)
             if one.worst is not None]
    worst = np.array([one.worst for _, one in known], float)
    dropped = np.array([one.dropped for _, one in known])
    best = np.maximum.accumulate(np.where([one.best for _, one in known], worst, -math.inf))
    usual = SteeringGains(**dict(options.start))
    axes = columns[0]
    axes.step([number for number, _ in known], best, where='post', color=theme.ink, linewidth=1.2,
              label='best so far')
    places = {'candidate': [float(number) for number, _ in known]}
    for one in options.varied:
        places[one.name] = [
            float(found.gains.get(one.name, getattr(usual, one.name))) for _, found in known
        ]
    for axes, (name, values) in zip(columns, places.items(), strict=True):
        across = np.array(values)
        for mask, face, words in (
            (~dropped, theme.passed, 'driven through all scenes'),
            (dropped, 'none', 'dropped: at most this'),
        ):
            axes.scatter(
                across[mask], worst[mask], s=18, facecolors=face, edgecolors=theme.passed,
                linewidths=0.9, label=words, clip_on=False,
            )
        axes.axhline(0, color=theme.failed, linewidth=0.8)
        chosen = next(place for place, (_, one) in enumerate(known) if one is tuned.found)
        axes.scatter(
            across[[chosen]], worst[[chosen]], s=70, facecolors='none', edgecolors=theme.failed,
            linewidths=1.4, label='found', clip_on=False,
        )
        unit = GAIN_RANGES[name].unit if name in GAIN_RANGES else ''
        axes.set_xlabel(f'{name} [{unit}]' if unit else name)
        style_axes(axes)
    columns[0].xaxis.set_major_locator(MaxNLocator(integer=True))
    columns[0].set_ylabel('least ρ of its scenes')
    handles, labels = columns[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=4, frameon=False, fontsize=9)
