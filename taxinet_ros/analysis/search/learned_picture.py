"""Picture of a search's learned distribution: a bar for each bin of each dimension."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taxinet_ros.scenes.search_space import Choice

_COLUMNS = 3
_PROGRAM, _LEARNED = '0.75', '#0072B2'


def learned_picture(
    choices: Sequence[Choice], probabilities: Mapping[str, Sequence[float]], path: Path, title: str
) -> None:
    """Draw the learned and the program's own probability of each bin.

    Args:
        choices: the searched dimensions.
        probabilities: probabilities of their bins, by name of the dimension.
        path: PNG file to write; the same values give the same bytes.
        title: title of the picture.
    """
    shown = [choice for choice in choices if choice.dimension.name in probabilities]
    columns = min(_COLUMNS, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure = Figure(figsize=(4.6 * columns, 0.6 + 2.9 * rows), dpi=110, layout='constrained')
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for place, choice in zip(axes, shown, strict=False):
        _draw(place, choice, probabilities[choice.dimension.name])
    for place in axes[len(shown):]:
        place.set_axis_off()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=3, frameon=False)
    figure.suptitle(title, fontsize=12)
    figure.savefig(path, format='png', metadata={'Software': None})


def _draw(axes: Axes, choice: Choice, learned: Sequence[float]) -> None:
    prior = choice.dimension.prior
    places = range(len(prior))
    axes.bar(places, prior, width=0.9, color=_PROGRAM, label='the program')
    axes.bar(places, learned, width=0.55, color=_LEARNED, label='learned')
    axes.set_title(choice.dimension.name, fontsize=10)
    axes.set_ylabel('probability')
    if choice.dimension.discrete:
        axes.set_xticks(places, _option_words(choice), rotation=20, ha='right', fontsize=8)
    else:
        axes.set_xticks([edge - 0.5 for edge in range(len(prior) + 1)], _edge_words(choice),
                        rotation=45, ha='right', fontsize=8)


def _option_words(choice: Choice) -> list[str]:
    if len(choice.options) == len(choice.dimension.prior):
        return [str(option)[:14] for option in choice.options]
    return [f'option {number}' for number in range(1, len(choice.dimension.prior) + 1)]


def _edge_words(choice: Choice) -> list[str]:
    """Values at the bins' edges; quantiles if the values are not known."""
    values = [choice.value(quantile) for quantile in choice.dimension.edges]
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return [f'{quantile:.0%}' for quantile in choice.dimension.edges]
    return [f'{value:.4g}' for value in known]
