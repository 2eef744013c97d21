"""``taxinet bag compare``: find the first difference of two bags on each topic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from taxinet_ros.cli.options import BagArgument, RunOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.check.compare import TopicComparison

EQUAL, DIFFERENT = 0, 1


def compare(
    bag: BagArgument,
    other: Annotated[Path, typer.Argument(metavar='OTHER', help='the bag to compare with')],
    tolerance: Annotated[
        float, typer.Option(min=0, help='tolerance of floating-point values; 0: bit-identical')
    ] = 0.0,
    run_id: RunOption = None,
    other_run: Annotated[
        str | None,
        typer.Option(metavar='RUN_ID', help='which run of OTHER, if it holds several'),
    ] = None,
) -> int:
    """Find the first difference between two bags: topic, step and field.

    Run names are ignored. Exit code: 0 identical, 1 different, 2 bad input.
    """
    from taxinet_ros.bag.check.compare import compare_bags
    from taxinet_ros.cli.bag.input import warn_of_stacks
    from taxinet_ros.trials.past_runs.repeated_run import one_run, readable_bags

    console = line_console()
    with readable_bags():
        one, two = one_run(bag, run_id), one_run(other, other_run)
        topics = compare_bags(one, two, tolerance=tolerance)
        if not topics:
            raise UsageError(f'{one.path} and {two.path}: no messages to compare')
        warn_of_stacks(console, one.made_on, two.made_on)
        print_comparison(console, topics, tolerance)
        if not (one.name or two.name) and _bytes(one.path) == _bytes(two.path):
            console.print('the files are byte-identical')
    return EQUAL if all(topic.equal for topic in topics) else DIFFERENT


def print_comparison(
    console: Console, topics: Sequence[TopicComparison], tolerance: float
) -> None:
    """Print one line per differing topic, and a summary."""
    from taxinet_ros.analysis.report.text import macro_text
    from taxinet_ros.bag.check.compare import first_difference
    from taxinet_ros.core.types import NS_PER_S, time_words

    differing = [topic for topic in topics if not topic.equal]
    first = first_difference(differing)
    console.print(macro_text(
        Path(__file__).with_suffix('.j2'), 'compared', topics=topics, differing=differing,
        messages=sum(max(topic.counts) for topic in topics), tolerance=tolerance, first=first,
        at='' if first is None else time_words(first.stamp_ns / NS_PER_S),
    ))


def _bytes(bag: Path) -> list[bytes]:
    from taxinet_ros.bag.layout import storage_files

    return [file.read_bytes() for file in storage_files(bag)]
