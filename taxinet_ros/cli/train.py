"""``taxinet train``: shows how far the training is, and what the network is worth in the end."""

from __future__ import annotations

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from taxinet_ros.training.train import TrainOptions, train


def run_train(options: TrainOptions) -> None:
    """Train, with a bar per stage, and print the errors on the scenes held back."""
    console = Console(highlight=False)
    bars: dict[str, TaskID] = {}
    with Progress(
        TextColumn('{task.description:<8}'), BarColumn(), MofNCompleteColumn(),
        TimeRemainingColumn(), console=console, disable=not console.is_terminal,
    ) as progress:

        def show(stage: str, done: int, total: int) -> None:
            if stage not in bars:
                bars[stage] = progress.add_task(stage, total=total)
            progress.update(bars[stage], completed=done)

        card = train(options, show)
    for quantity, errors in card.errors.items():
        figures = ', '.join(f'{name} {value:.3g}' for name, value in errors.items())
        console.print(f'{quantity}: {figures}', soft_wrap=True)
    card_path = options.out.with_suffix('.json')
    console.print(f'weights: {options.out}, model card: {card_path}', soft_wrap=True)
