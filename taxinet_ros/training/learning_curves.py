"""Picture of the learning curves of a training."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from taxinet_ros.training.accuracy import Epoch

# Okabe-Ito colours, distinguishable with all common colour vision deficiencies; lines also differ
# in their dashes, for greyscale prints.
_TRAINING: dict[str, Any] = {'color': '#0072B2', 'linestyle': (0, (4, 1.5)), 'linewidth': 1.6}
_VALIDATION: dict[str, Any] = {'color': '#D55E00', 'linewidth': 2.0, 'marker': 'o', 'markersize': 3}
_HEADING: dict[str, Any] = {'color': '#009E73', 'linewidth': 2.0, 'marker': 's', 'markersize': 3}
_RATE: dict[str, Any] = {'color': '0.35', 'linewidth': 1.6}
_BEST: dict[str, Any] = {'color': '0.4', 'linewidth': 1.2, 'linestyle': (0, (1, 1.5)), 'zorder': 1}


def learning_curves(history: Sequence[Epoch], best_epoch: int, title: str) -> bytes:
    """A PNG of losses, errors on the validation pictures, and learning rate over the epochs.

    The same values give the same bytes. A dotted line marks the epoch of the final weights.

    Args:
        history: all epochs, at least one.
        best_epoch: the marked epoch.
        title: title of the picture.
    """
    figure = Figure(figsize=(13.5, 4.3), dpi=110, layout='constrained')
    losses, errors, rate = figure.subplots(1, 3, width_ratios=(1.2, 1.2, 1.0))
    _draw_losses(losses, history)
    _draw_errors(errors, history, best_epoch)
    _line(rate, history, 'learning_rate', 'learning rate', _RATE)
    rate.set(title='learning rate at the end of an epoch', ylim=(0, None))
    for axes in (losses, errors, rate):
        axes.set(xlabel='epoch')
        axes.axvline(best_epoch, **_BEST)
        axes.yaxis.set_major_formatter('{x:g}')
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(True, which='both', color='0.92', linewidth=0.7)
        axes.set_axisbelow(True)
        axes.spines[['top', 'right']].set_visible(False)
    figure.suptitle(f'{title}: weights of epoch {best_epoch} kept', fontsize=13, fontweight='bold')
    data = io.BytesIO()
    figure.savefig(data, format='png', metadata={'Software': ''})
    return data.getvalue()


def _draw_losses(axes: Axes, history: Sequence[Epoch]) -> None:
    _line(axes, history, 'training_loss', 'training', _TRAINING)
    _line(axes, history, 'validation_loss', 'validation', _VALIDATION)
    _log_scale(axes, 'mean loss per epoch (smooth L1)')
    axes.legend(frameon=False)


def _draw_errors(axes: Axes, history: Sequence[Epoch], best_epoch: int) -> None:
    best = history[best_epoch - 1]
    cte = f'cross-track [m]: {best.cte_mae_m:.3g} kept'
    heading = f'heading [degrees]: {best.he_mae_deg:.3g} kept'
    _line(axes, history, 'cte_mae_m', cte, _VALIDATION)
    _line(axes, history, 'he_mae_deg', heading, _HEADING)
    _log_scale(axes, 'mean absolute error on validation pictures')
    axes.legend(frameon=False)


def _log_scale(axes: Axes, title: str) -> None:
    """Set a logarithmic scale with plain number labels, even if it spans no decade."""
    axes.set(title=title, yscale='log')
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_minor_locator(LogLocator(subs='all'))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _line(
    axes: Axes, history: Sequence[Epoch], name: str, label: str, style: dict[str, Any]
) -> None:
    values = np.array([getattr(epoch, name) for epoch in history])
    axes.plot([epoch.number for epoch in history], values, label=label, **style)
