"""Result of ``taxinet estimate``: as JSON, as sentences, as a picture of the whole tail."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.analysis.report.pictures import LIGHT, write_png
from taxinet_ros.campaign.rates import TAIL, rate, share_bounds
from taxinet_ros.campaign.samplers.splitting import RareEstimate, Splitting, State
from taxinet_ros.campaign.scenes.overrides import scenes_words
from taxinet_ros.campaign.search import Search
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.pages import add_page

JSON_NAME = 'estimate.json'


def estimate_of(search: Search) -> RareEstimate:
    """The estimate of an ended search by ``splitting`` whose Scenic child still runs."""
    sampler = search.sampler
    assert isinstance(sampler, Splitting)
    return sampler.estimate()


def plain_interval(probability: float, runs: int) -> tuple[float, float]:
    """The 95 % interval that as many plain draws give if they fail as often as expected."""
    failures = round(probability * runs)
    return share_bounds(failures, runs - failures, TAIL)


def estimate_values(found: RareEstimate, search: Search) -> dict[str, Any]:
    """The estimate as plain values for JSON."""
    options = search.options
    plain = plain_interval(found.probability, found.runs) if found.probability else None
    return {
        'program': options.campaign.program, 'perception': search.perception,
        'headline': options.campaign.judging.headline, 'seed': options.campaign.seed,
        'sampler_options': dict(options.sampler_options), 'state': str(found.state),
        'why': found.why, 'probability': found.probability or None, 'low': found.low,
        'high': found.high, 'confidence': 1 - 2 * TAIL,
        'relative_error': _finite(found.relative_error),
        'runs': found.runs, 'without_result': _without_result(search),
        'islands': found.islands, 'islands_failing': found.failing,
        'drawn': found.drawn, 'drawn_failed': found.drawn_failed,
        'drawn_interval': list(rate(found.drawn_failed, found.drawn)[1:]),
        'plain_interval_for_as_many_runs': plain and list(plain),
        'levels': [
            {
                'below': _finite(step.below), 'probability': step.probability,
                'islands': step.islands, 'accepted': _finite(step.accepted),
            } for step in found.steps
        ],
        'curve': [
            dict(zip(('rho', 'probability', 'low', 'high'), point, strict=True))
            for point in found.curve
        ],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _without_result(search: Search) -> int:
    return sum(row.outcome is Outcome.INFRA_ERROR for row in search.rows)


def write_estimate(found: RareEstimate, search: Search) -> tuple[Path, Path | None]:
    """Write ``estimate.json`` and ``tail.png`` into the campaign's folder."""
    out = search.options.campaign.out
    values = estimate_values(found, search)
    write_atomically(out / JSON_NAME, json.dumps(values, indent=2, allow_nan=False) + '\n')
    if not found.curve:
        return out / JSON_NAME, None
    campaign = search.options.campaign
    scenes = scenes_words(campaign.program, {**campaign.overrides, **campaign.laid_over})
    title = f'{scenes}, {search.perception}: tail of the robustness'
    picture = tail_picture(found, title, search.options.campaign.judging.headline)
    written = write_png(picture, out, LIGHT)
    add_page(out, written, 'Tail of the robustness')
    return out / JSON_NAME, written


def probability_words(value: float) -> str:
    """A probability with two significant digits: 0.15 %, 3.2e-06."""
    if value >= 0.1:
        return f'{100 * value:.0f} %'
    return f'{100 * value:.2g} %' if value >= 1e-4 or not value else f'{value:.1e}'


def interval_words(low: float, high: float) -> str:
    """An interval of probabilities."""
    return f'[{probability_words(low)}, {probability_words(high)}]'


def estimate_lines(found: RareEstimate, search: Search) -> list[str]:
    """What to print: probability, what it rests on, plain draws, and the next command."""
    low, high = found.low, found.high
    infra = _without_result(search)
    lines = []
    name = f'P({search.options.campaign.judging.headline} violated)'
    if found.state is State.AT_MOST:
        lines.append(f'{name} at most {probability_words(high)} (95 %): {found.why}')
    else:
        sure = '' if found.state is State.ESTIMATED else f'; UNCLEAR: {found.why}'
        lines.append(
            f'{name} = {probability_words(found.probability)} '
            f'{interval_words(low, high)} (95 %), relative error {found.relative_error:.2f}{sure}'
        )
    lines.append(
        f'{found.runs:,} runs on {found.islands} islands, {found.failing} of which found failures'
        + (f'; {infra} runs without a result count as moves not made' if infra else '')
    )
    lines += [_level_line(number, found) for number in range(len(found.steps))]
    drawn = rate(found.drawn_failed, found.drawn)
    lines.append(
        f'without any assumption: of {found.drawn:,} draws of the program itself '
        f'{found.drawn_failed} failed {interval_words(drawn.low, drawn.high)}'
    )
    if found.state is not State.AT_MOST and found.runs:
        plain = plain_interval(found.probability, found.runs)
        times = (plain[1] - plain[0]) / (high - low)
        lines.append(
            f'{found.runs:,} plain draws would give about {interval_words(*plain)}, '
            f'{times:.1f} times as wide'
        )
        lines.append(
            'the interval holds if the islands reach every region of failures; one that none of '
            'them met is in neither figure but the plain draws'
        )
    return lines


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
            rho, low, high, color=theme.passed, alpha=0.25, linewidth=0, label='95 % interval'
        )
        axes.plot(rho, mean, color=theme.passed, linewidth=1.8, label='splitting')
        for step in found.steps:
            if math.isfinite(step.below):
                axes.axvline(step.below, color=theme.ink, linewidth=0.7, linestyle=':')
        axes.axvline(0.0, color=theme.failed, linewidth=1.2)
        axes.annotate(
            'fails', (0.0, 1.0), xycoords=('data', 'axes fraction'), xytext=(-4, -12),
            textcoords='offset points', ha='right', fontsize=9, color=theme.failed,
        )
        if found.state is not State.AT_MOST:
            axes.errorbar(
                [0.0], [found.probability],
                yerr=[[found.probability - found.low], [found.high - found.probability]],
                color=theme.failed, marker='o', markersize=5, capsize=4,
                label=f'P(failure) {probability_words(found.probability)}',
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
