"""Result of ``taxinet estimate``: as JSON, as sentences, as a picture of the whole tail."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.analysis.report.pictures import LIGHT, write_png
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import json_text
from taxinet_ros.samplers.splitting import WIDE, RareEstimate, Splitting
from taxinet_ros.scenes.overrides import scenes_words
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.rates import CONFIDENCE
from taxinet_ros.trials.search import Search

JSON_NAME = 'estimate.json'
_TEXT = Path(__file__).with_suffix('.j2')


def unfinished_words(search: Engine[Search]) -> str:
    """Why an ended search by ``splitting`` has no interval yet, and what goes on; '' if it has."""
    ended, planned = _splitting(search).draws()
    if ended == planned:
        return ''
    why = 'interrupted' if search.interrupted else search.stopped
    runs = f' with {planned} runs' if search.options.runs < planned else ''
    return (
        f'{ended:,} of {planned:,} planned draws have ended{f" ({why})" if why else ""}: no '
        f'interval before all have; resume it{runs}'
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


def next_text(found: RareEstimate, search: Engine[Search]) -> str:
    """Why the search ended, and the next useful command."""
    out = search.options.out
    failed = [row for row in search.rows if row.outcome is Outcome.FAIL]
    worst = min(
        failed, key=lambda row: row.headline.upper if row.headline else 0.0, default=None)
    return macro_text(
        _TEXT, 'next', f=found, why='interrupted' if search.interrupted else search.stopped,
        continues=search.interrupted or (search.stopped and not search.exhausted),
        out=shlex.quote(str(out)), worst=worst and shlex.quote(str(out / worst.run_id)),
    )


def probability_words(value: float) -> str:
    """A probability with two significant digits: 0.15 %, 3.2e-06."""
    if value >= 0.1:
        return f'{100 * value:.0f} %'
    return f'{100 * value:.2g} %' if value >= 1e-4 or not value else f'{value:.1e}'


def estimate_text(found: RareEstimate, search: Engine[Search]) -> str:
    """What to print: the interval, and what each of its ends rests on."""
    return macro_text(
        _TEXT, 'estimated', f=found, headline=search.options.judging.headline,
        p=probability_words, wide=WIDE, infra=_without_result(search),
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
            label=f'P(failure) [{probability_words(found.low)}, {probability_words(found.high)}]',
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
