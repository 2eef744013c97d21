"""A search as it goes, in one line of a terminal."""

from __future__ import annotations

import contextlib
import datetime
import math
import time
from collections.abc import Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TimeElapsedColumn,
)
from rich.text import Text

from taxinet_ros.campaign.rates import failure_rate
from taxinet_ros.campaign.search import Search
from taxinet_ros.core.outcome import Outcome

_REFRESH_PER_S = 2.0


@contextlib.contextmanager
def search_view(console: Console, search: Search, *, shown: bool) -> Iterator[None]:
    """Show the search while the ``with`` lasts; ``shown`` False shows nothing."""
    columns = (
        BarColumn(bar_width=20), MofNCompleteColumn(), TimeElapsedColumn(), _Figures(search),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not shown,
        refresh_per_second=_REFRESH_PER_S,
    ) as progress:
        progress.add_task('', total=search.options.campaign.runs)
        yield


class _Figures(ProgressColumn):
    """Failures, pace, time left, least robustness and failure rate; moves the bar too."""

    def __init__(self, search: Search) -> None:
        super().__init__()
        self._search = search
        self._began = time.monotonic()
        self._before = len(search.rows)

    def render(self, task: Task) -> Text:
        """The figures of this moment."""
        rows = list(self._search.rows)
        task.completed = len(rows)
        failed = sum(row.outcome is Outcome.FAIL for row in rows)
        least = min(
            (row.headline[1] for row in rows if row.headline), default=math.nan
        )
        minutes = (time.monotonic() - self._began) / 60
        pace = (len(rows) - self._before) / max(minutes, 1e-3)
        words = [f'{failed} failed', f'{pace:.1f}/min']
        if pace > 0:
            left = self._search.options.campaign.runs - len(rows)
            words.append(f'{datetime.timedelta(seconds=round(60 * left / pace))} left')
        if rows:
            words.append(f'least rho {least:+.2f}')
        # Whoever watches may stop when it looks good: the interval that holds all along.
        found = failure_rate(rows, 0).rate
        if found is not None:
            words.append(f'failing {found.words()}')
        if self._search.interrupted:
            words.append('ending the runs at hand')
        return Text('  '.join(words))
