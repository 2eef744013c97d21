"""``taxinet train``: shows how far the training is, and what the network is worth in the end."""

from __future__ import annotations

from rich.console import Console

from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.weights import card_path
from taxinet_ros.training.options import TrainOptions
from taxinet_ros.training.train import train


def run_train(options: TrainOptions) -> None:
    """Train, with a bar per stage, and print the errors on the pictures held back."""
    console = Console(highlight=False)
    with stage_bars(console) as show:
        card = train(options, show)
    for quantity, errors in card.errors.items():
        figures = ', '.join(f'{name} {value:.3g}' for name, value in errors.items())
        console.print(f'{quantity}: {figures}', soft_wrap=True)
    console.print(
        f'weights: {options.out} (epoch {card.best_epoch}), model card: {card_path(options.out)}, '
        f'learning curves: {options.curves_path}, {options.history_path.name}',
        soft_wrap=True,
    )
