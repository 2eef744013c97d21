"""Result of ``taxinet estimate``: as JSON, as sentences, as a picture of the whole tail."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.analysis.report.pictures import LIGHT, write_png
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import json_text
from taxinet_ros.samplers.splitting import WIDE, RareEstimate, Splitting, State
from taxinet_ros.scenes.overrides import scenes_words
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.rates import CONFIDENCE
from taxinet_ros.trials.search import Search

JSON_NAME = 'estimate.json'


def unfinished_words(search: Engine[Search]) -> str:
    """Why an ended search by ``splitting`` has no interval yet, and what goes on; '' if it has."""
    ended, planned = _splitting(search).draws()
    if ended == planned:
        return ''
    why = 'interrupted' if search.interrupted else search.stopped
    runs = f' and --runs {planned}' if search.options.runs < planned else ''
    return (
        f'{ended:,} of {planned:,} planned draws have ended{f" ({why})" if why else ""}: no '
        f'interval before all have; the same with --resume{runs} continues it'
    )


def estimate_of(search: Engine[Search]) -> RareEstimate:
    """The estimate of an ended search by ``splitting`` whose Scenic child still runs.

    Raises:
        ValueError: it has none yet, see :func:`unfinished_words`.
    """
    return _splitting(search).estimate()


def _splitting(search: Engine[Search]) -> Splitting:
    sampler = search.proposer.ended_sampler()
    assert isinstance(sampler, Splitting)
    return sampler


def estimate_values(found: RareEstimate, search: Engine[Search]) -> dict[str, Any]:
    """The estimate as plain values for JSON."""
    options = search.options
    return {
        'program': options.program, 'perception': search.perception,
        'headline': options.judging.headline, 'seed': options.seed,
        'sampler_options': dict(search.proposer.sampler_options),
        'state': str(found.state),
        'low': found.low, 'high': found.high, 'confidence': CONFIDENCE,
        'probability': found.probability or None, 'drawn_plainly': found.plain,
        'runs': found.runs, 'without_result': _without_result(search),
        'islands': found.islands, 'islands_failing': found.failing,
        'drawn': found.drawn, 'drawn_failed': found.drawn_failed,
        'levels': [
            {
                'below': step.below, 'probability': step.probability,
                'islands': step.islands, 'accepted': step.accepted,
            } for step in found.steps
        ],
        'curve': [
            dict(zip(('rho', 'probability', 'low', 'high'), point, strict=True))
            for point in found.curve
        ],
    }


def _without_result(search: Engine[Search]) -> int:
    return search.summary.outcomes[Outcome.INFRA_ERROR]


def write_estimate(found: RareEstimate, search: Engine[Search]) -> list[Path]:
    """Write ``estimate.json`` and ``tail.png`` into the campaign's folder."""
    out = search.options.out
    values = estimate_values(found, search)
    write_atomically(out / JSON_NAME, json_text(values) + '\n')
    if not found.curve:
        return [out / JSON_NAME]
    campaign = search.options
    scenes = scenes_words(campaign.program, {**campaign.overrides, **campaign.laid_over})
    title = f'{scenes}, {search.perception}: tail of the robustness'
    picture = tail_picture(found, title, search.options.judging.headline)
    return [out / JSON_NAME, write_png(picture, out, LIGHT)]


def next_lines(found: RareEstimate, search: Engine[Search]) -> Sequence[str]:
    """Why the search ended, and the next useful command."""
    out = search.options.out
    why = 'interrupted' if search.interrupted else search.stopped
    lines = [f'ended: {why}'] if why else []
    failed = [row for row in search.rows if row.outcome is Outcome.FAIL]
    if search.interrupted or (search.stopped and not search.exhausted):
        lines.append('next: the same command with --resume continues it')
    elif found.state is State.UNCLEAR:
        more = '' if found.plain else (
            '--resume with more --runs adds islands to the same draws, for the lower end, and '
            'keeps the 95 %; '
        )
        lines.append(
            f'next: {more}a new estimate with more --runs narrows both ends, but is another look: '
            'tell both, as each misses in up to 5 %'
        )
    elif failed:
        worst = min(failed, key=lambda row: row.headline.upper if row.headline else 0.0)
        lines.append(
            f'next: taxinet analyze {shlex.quote(str(out))} for causes, or taxinet explain '
            f'{shlex.quote(str(out / worst.run_id))} for the worst failure'
        )
    else:
        lines.append(f'next: taxinet analyze {shlex.quote(str(out))}')
    return lines


def probability_words(value: float) -> str:
    """A probability with two significant digits: 0.15 %, 3.2e-06."""
    if value >= 0.1:
        return f'{100 * value:.0f} %'
    return f'{100 * value:.2g} %' if value >= 1e-4 or not value else f'{value:.1e}'


def interval_words(low: float, high: float) -> str:
    """An interval of probabilities."""
    return f'[{probability_words(low)}, {probability_words(high)}]'


def estimate_lines(found: RareEstimate, search: Engine[Search]) -> list[str]:
    """What to print: the interval, and what each of its ends rests on."""
    wide = '' if found.state is State.ESTIMATED else (
        f'; UNCLEAR: more than {WIDE} times as high as low' if found.low else
        '; UNCLEAR: an upper end only'
    )
    of = f'of {found.drawn:,} draws of the program itself {found.drawn_failed} failed'
    lines = [
        f'P({search.options.judging.headline} violated) within '
        f'{interval_words(found.low, found.high)} (95 %){wide}'
    ]
    if found.plain:
        lines.append(
            f'{of}, {probability_words(found.probability)}: drawn plainly, as {found.plain}, and '
            'splitting would give no narrower interval'
        )
    else:
        lines += [
            f'at least {probability_words(found.low)}: of {found.islands} islands {found.failing} '
            f'found failures; their mean is {probability_words(found.probability)}',
        ] if found.islands else []
        lines.append(
            f'at most {probability_words(found.high)}: {of}; what all islands missed is in no '
            'figure but this'
        )
    if infra := _without_result(search):
        lines.append(f'{infra} runs without a result count as moves not made, and as no draws')
    return lines + [_level_line(number, found) for number in range(len(found.steps))]


def _level_line(number: int, found: RareEstimate) -> str:
    step = found.steps[number]
    what = 'plain draws' if math.isinf(step.below) else f'rho below {step.below:+.3f}'
    moves = '' if math.isnan(step.accepted) else f', {step.accepted:.0%} of the moves accepted'
    return (
        f'  level {number}: {what}: {probability_words(step.probability)} '
        f'({step.islands} islands{moves})'
    )


def tail_picture(found: RareEstimate, title: str, headline: str) -> Picture:
    """P(rho <= r) against r with its interval; the failures are left of 0."""
    rho, mean, low, high = np.array(found.curve).T

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        figure.suptitle(title, fontsize=11, wrap=True)
        axes.fill_between(
            rho, low, high, color=theme.passed, alpha=0.25, linewidth=0, label='95 % at each r'
        )
        axes.plot(
            rho, mean, color=theme.passed, linewidth=1.8,
            label='share of the draws' if found.plain else 'mean of the islands',
        )
        for step in found.steps:
            if math.isfinite(step.below):
                axes.axvline(step.below, color=theme.ink, linewidth=0.7, linestyle=':')
        axes.axvline(0.0, color=theme.failed, linewidth=1.2)
        axes.annotate(
            'fails', (0.0, 1.0), xycoords=('data', 'axes fraction'), xytext=(-4, -12),
            textcoords='offset points', ha='right', fontsize=9, color=theme.failed,
        )
        axes.vlines(
            0.0, found.low or low.min(), found.high, color=theme.failed, linewidth=4, alpha=0.6,
            label=f'P(failure) {interval_words(found.low, found.high)}',
        )
        axes.set_yscale('log')
        axes.set_ylim(top=1.5)
        axes.set_xlabel(f'robustness r of {headline}')
        axes.set_ylabel('P(robustness ≤ r)')
        axes.legend(loc='lower right', fontsize=9)

    return Picture(
        name='tail', title=title, draw=draw, size_in=(7.5, 4.4),
        caption='The whole distribution of the robustness under the program itself, down to '
        'failures. Dotted: the levels.',
    )
