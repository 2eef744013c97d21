"""Picture of ODD coverage: runs and failure rate of each cell, beside the pairs of cells.

Colours are never alone: a pair without a run has a cross, an excluded one is hatched, and the share
of failures is the size of a square, so it can be read in grey.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator, PercentFormatter

from taxinet_ros.analysis.odd.coverage import OddCoverage
from taxinet_ros.analysis.report.parts import Picture, Theme

_ROW_IN = 0.2
_PALE = 0.28


def coverage_picture(found: OddCoverage, name: str = 'odd_coverage') -> Picture:
    """Runs, failure rates and pairs of cells of an ODD in one figure.

    Args:
        found: the coverage.
        name: file name of the picture, without its ending.
    """
    starts = np.concatenate([[0], np.cumsum(found.odd.sizes)]).tolist()
    rows = starts[-1]
    side_in = max(_ROW_IN * rows, 3.0)

    def draw(figure: Figure, theme: Theme) -> None:
        runs, rates, pairs = figure.subplots(
            1, 3, sharey=True, width_ratios=[1.5, 1.5, side_in]
        )
        _draw_runs(runs, found, theme)
        _draw_rates(rates, found, theme)
        _draw_pairs(pairs, found, theme, starts)
        labels = [
            one.cells[cell].label for one in found.odd.parameters for cell in range(len(one.cells))
        ]
        runs.set_yticks(np.arange(rows) + 0.5, labels, fontsize=8)
        runs.set_ylim(rows, 0)
        for number, one in enumerate(found.odd.parameters):
            middle = (starts[number] + starts[number + 1]) / 2
            runs.annotate(
                one.field.label, (0, middle), xytext=(-96, 0), textcoords='offset points',
                xycoords=('axes fraction', 'data'), rotation=90, fontsize=8.5, weight='bold',
                va='center', ha='center',
            )
        for axes in (runs, rates):
            for line in starts[1:-1]:
                axes.axhline(line, color=theme.ink, linewidth=0.6)
            axes.tick_params(axis='y', length=0)
            axes.spines[['top', 'right']].set_visible(False)
        columns = starts[-2]  # the last parameter has rows only
        pairs.set_xticks(
            np.arange(columns) + 0.5, labels[:columns], fontsize=8, rotation=90
        )
        pairs.set_xlim(0, rows)
        pairs.tick_params(axis='y', length=0)
        figure.suptitle(_headline(found), fontsize=11, x=0.01, ha='left')

    return Picture(
        name=name, title=f'Coverage of the ODD {found.odd.name}', draw=draw,
        caption='Each row is a cell of the operational design domain: its runs, how many of them '
        'fail with the 95 % interval, and whether it has been run together with each other cell.',
        size_in=(4.9 + side_in, 2.3 + side_in),
    )


def _headline(found: OddCoverage) -> str:
    shares = ', '.join(
        f'{one.covered:,} of {one.feasible:,} '
        f'{ {1: "cells", 2: "pairs", 3: "triples"}[one.t] }' for one in found.strengths
    )
    outside = found.judged - found.inside
    return (
        f'ODD {found.odd.name}: {found.inside:,} judged runs inside, {outside:,} '
        f'outside ({", ".join(found.campaigns)}, {found.spec})\ncovered: {shares}'
    )


def _draw_runs(axes: Axes, found: OddCoverage, theme: Theme) -> None:
    middle = np.arange(len(found.cells)) + 0.5
    failures = np.array([one.rate.failures for one in found.cells])
    runs = np.array([one.rate.runs for one in found.cells])
    axes.barh(middle, runs - failures, left=failures, height=0.7, color=theme.passed, alpha=_PALE,
              linewidth=0)
    axes.barh(middle, failures, height=0.7, color=theme.failed, linewidth=0)
    for at, number in zip(middle, runs, strict=True):
        axes.annotate(
            f'{number:,}', (number, at), xytext=(2, 0), textcoords='offset points', fontsize=7,
            va='center',
        )
    axes.set_xlim(0, 1.35 * max(1, int(runs.max())))
    axes.xaxis.set_major_locator(MaxNLocator(3, integer=True))
    axes.tick_params(axis='x', labelsize=8)
    axes.set_xlabel('judged runs', fontsize=9)


def _draw_rates(axes: Axes, found: OddCoverage, theme: Theme) -> None:
    for number, one in enumerate(found.cells):
        at, rate = number + 0.5, one.rate
        if math.isnan(rate.low) or not rate.runs:
            axes.annotate(
                'no rate' if rate.runs else 'no run', (0.02, at), fontsize=7, va='center',
                style='italic',
            )
            continue
        axes.plot([rate.low, rate.high], [at, at], color=theme.ink, linewidth=1.2)
        axes.plot([rate.rate], [at], marker='o', markersize=3.5, color=theme.ink)
    if found.limit is not None:
        axes.axvline(found.limit, color=theme.failed, linestyle='--', linewidth=1)
    axes.set_xlim(-0.02, 1.02)
    axes.set_xticks([0, 0.5, 1])
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, symbol=' %'))
    axes.tick_params(axis='x', labelsize=8)
    axes.grid(axis='x', color=theme.faint, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel('failing, 95 %', fontsize=9)


def _draw_pairs(axes: Axes, found: OddCoverage, theme: Theme, starts: list[int]) -> None:
    covered, excluded, failing = [], [], []
    crosses: list[tuple[float, float]] = []
    for (first, second), pairs in found.pairs.items():
        for (one, other), feasible in np.ndenumerate(pairs.feasible):
            x, y = starts[first] + one, starts[second] + other
            runs = int(pairs.runs[one, other])
            if not feasible:
                excluded.append(Rectangle((x, y), 1, 1))
            elif not runs:
                crosses.append((x + 0.5, y + 0.5))
            else:
                covered.append(Rectangle((x, y), 1, 1))
                side = 0.9 * math.sqrt(pairs.failures[one, other] / runs)
                if side:
                    corner = (x + 0.5 - side / 2, y + 0.5 - side / 2)
                    failing.append(Rectangle(corner, side, side))
        axes.add_patch(Rectangle(
            (starts[first], starts[second]), starts[first + 1] - starts[first],
            starts[second + 1] - starts[second], fill=False, edgecolor=theme.ink, linewidth=0.8,
            zorder=3,
        ))
    axes.add_collection(PatchCollection(
        covered, facecolor=theme.passed, alpha=_PALE, edgecolor=theme.paper, linewidth=0.6
    ))
    axes.add_collection(PatchCollection(
        excluded, facecolor='none', edgecolor=theme.ink, hatch='//////', linewidth=0, alpha=0.55
    ))
    axes.add_collection(PatchCollection(failing, facecolor=theme.failed, linewidth=0))
    if crosses:
        places = np.array(crosses)
        axes.scatter(
            places[:, 0], places[:, 1], marker='x', s=22, color=theme.ink, linewidth=1.1
        )
    axes.legend(
        handles=[
            Patch(facecolor=theme.passed, alpha=_PALE, label='pair of cells that was run'),
            Patch(facecolor=theme.failed, label='share of its runs that fail (area)'),
            axes.scatter([], [], marker='x', s=26, color=theme.ink, label='no run: a gap'),
            Patch(facecolor='none', edgecolor=theme.ink, hatch='//////', linewidth=0,
                  label='excluded from the ODD'),
        ], loc='upper right', fontsize=9, frameon=False,
    )
    for number, one in enumerate(found.odd.parameters[:-1]):
        axes.annotate(
            one.field.label, (starts[number] + 0.2, starts[number + 1] - 0.25), fontsize=8.5,
            weight='bold',
        )
    axes.set_frame_on(False)
