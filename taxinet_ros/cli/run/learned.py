"""``taxinet learned``: combine the learned distributions of several searches."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from taxinet_ros.campaign.learned_result import LearnedResult, LearnedTogether, Share
from taxinet_ros.campaign.scenes.search_space import Choice
from taxinet_ros.errors import UsageError

_WITHIN = re.compile(r'([^=]+)=([-+.\deE]+):([-+.\deE]+)')


def show_learned(folders: Sequence[Path], within: Sequence[str], out: Path | None) -> None:
    """Print and plot the learned distributions of searches.

    Args:
        folders: folders of the searches.
        within: intervals whose probability to print, ``DIMENSION=LOW:HIGH``.
        out: picture to write, or None.

    Raises:
        UsageError: a folder or an interval is invalid, or the picture already exists.
    """
    if out is not None and out.exists():
        raise UsageError(f'--out {out}: already exists; choose a new name')
    together = LearnedTogether([LearnedResult.read(folder) for folder in folders], folders)
    asked = [_interval(text) for text in within]
    console = Console(highlight=False)
    console.print(heading(together), soft_wrap=True)
    console.print(_table(together))
    if together.why_no_interval:
        console.print(together.why_no_interval, soft_wrap=True)
    for name, low, high in asked:
        share = together.within(name, low, high)
        before = together.choice(name).probability_within(low, high)
        console.print(
            f'{name} in {low:g} to {high:g}: {_words(share)}; the program {before:.1%}',
            soft_wrap=True,
        )
    if out is not None:
        from taxinet_ros.analysis.search.learned_picture import learned_picture

        learned_picture(
            together.choices, together.mean, out, heading(together),
            [result.probabilities for result in together.results],
        )
        console.print(f'picture: {out}', soft_wrap=True)


def heading(together: LearnedTogether) -> str:
    """Heading: what the searches have in common, and their numbers of runs."""
    facts = together.results[0].facts
    runs = [int(result.facts.get('runs_made', 0)) for result in together.results]
    number = len(together.results)
    searches = '1 search' if number == 1 else f'{number} searches'
    each = f'{min(runs)}' if min(runs) == max(runs) else f'{min(runs)} to {max(runs)}'
    return (
        f'Failures of {facts["perception"]} on {Path(str(facts["program"])).stem}, found by '
        f'{facts["sampler"]}: {searches} of {each} runs'
    )


def _table(together: LearnedTogether) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column('choice')
    table.add_column('likeliest values')
    for title in ('program', 'failures', 'from', 'to (95 %)', 'rests on'):
        table.add_column(title, justify='right')
    for choice in together.choices:
        bins = together.bins(choice)
        shares = [-1.0 if math.isnan(one.share) else one.share for one in bins]
        best = max(range(len(bins)), key=shares.__getitem__)
        table.add_row(
            choice.dimension.name, _bin_words(choice, best),
            f'{choice.dimension.prior[best]:.1%}', *(f'{value:.1%}' for value in bins[best]),
            f'{together.failures(choice):.0f}',
        )
    return table


def _bin_words(choice: Choice, number: int) -> str:
    if choice.dimension.discrete:
        if len(choice.options) == len(choice.dimension.prior):
            return str(choice.options[number])
        return f'option {number + 1}'
    low, high = choice.dimension.edges[number:number + 2]
    values = [choice.value(quantile) for quantile in (low, high)]
    if None in values:
        return f'quantiles {low:.0%} to {high:.0%}'
    return f'{values[0]:.4g} to {values[1]:.4g}'


def _words(share: Share) -> str:
    return f'{share.share:.1%} of the failures (95 % interval {share.low:.1%} to {share.high:.1%})'


def _interval(text: str) -> tuple[str, float, float]:
    match = _WITHIN.fullmatch(text)
    try:
        name, low, high = match.groups() if match else ('', '', '')
        ends = float(low), float(high)
    except ValueError:
        ends = (1.0, 0.0)
    if not ends[0] <= ends[1]:
        raise UsageError(
            f'--within {text!r}: expected DIMENSION=LOW:HIGH, e.g. distance_m=1400:1600'
        )
    return name, *ends
