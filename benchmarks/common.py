"""What the scripts of this folder share: options, progress, tables, and how they end."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any, NoReturn

from rich.console import Console
from rich.table import Table

from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.errors import ExitCode, InfraError, UsageError

WIDTH = 100
"""Width of what is printed where there is no terminal [columns]."""

Progress = Callable[[int, int], object]
"""Called with what is done and the total."""


def options(description: str | None, *, repeats: int | None = None) -> argparse.ArgumentParser:
    """A parser with ``--json``, and ``--repeats`` where there is something to repeat.

    Args:
        description: docstring of the script, whose first paragraph is shown.
        repeats: default number of repetitions.
    """
    parser = argparse.ArgumentParser(description=(description or '').split('\n\n')[0])
    if repeats is not None:
        parser.add_argument('--repeats', type=count, default=repeats, metavar='N',
                            help=f'repetitions for each line (default {repeats})')
    parser.add_argument('--json', action='store_true', help='print JSON')
    return parser


def count(text: str) -> int:
    """An integer from 1, for an option."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f'{number}, needs to be 1 or more')
    return number


def positive(text: str) -> float:
    """A finite number above 0, for an option."""
    number = float(text)
    if not 0 < number < float('inf'):
        raise argparse.ArgumentTypeError(f'{number:g}, needs to be more than 0')
    return number


def one_of(names: Collection[str]) -> Callable[[str], str]:
    """Check of a word, for an option."""
    def check(word: str) -> str:
        if word not in names:
            raise argparse.ArgumentTypeError(f'{word!r} is unknown; known: {", ".join(names)}')
        return word

    return check


def run_study(
    measure: Callable[[Progress], dict[str, Any]], show: Callable[[dict[str, Any], Console], None],
    *, as_json: bool,
) -> int:
    """Run a study with a progress bar and print its figures.

    Args:
        measure: called with a progress callback.
        show: prints the figures as text.
        as_json: print JSON instead.

    Returns:
        Exit code 0.
    """
    with stage_bars(Console(stderr=as_json)) as bars:
        found = measure(partial(bars, 'measuring'))
    if as_json:
        print(json.dumps(found, indent=2))
    else:
        show(found, page_console())
    return ExitCode.OK


def page_console() -> Console:
    """A console as wide as a page where there is no terminal."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = WIDTH
    return console


def make_table(left: Sequence[str], right: Sequence[str]) -> Table:
    """A table without lines, its first columns aligned left and the others right."""
    table = Table(box=None, pad_edge=False)
    for heading in left:
        table.add_column(heading, no_wrap=True)
    for heading in right:
        table.add_column(heading, justify='right', no_wrap=True)
    return table


def leave(main: Callable[[], int]) -> NoReturn:
    """Run a script and exit with its code; an error is one line."""
    try:
        sys.exit(main())
    except UsageError as error:
        print(f'error: {error}', file=sys.stderr)
        sys.exit(ExitCode.USAGE)
    except InfraError as error:
        print(f'error: {error}', file=sys.stderr)
        sys.exit(ExitCode.INFRA)
