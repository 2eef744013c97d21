"""Coverage of an operational design domain, from Python."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from taxinet_ros.analysis.odd import coverage
from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs
from taxinet_ros.arguments import FINITE, NONE, PATH, WORD, Kind, takes
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.odd.odd_file import find_odd, read_odd

_PATHS = PATH | Kind('a list of paths', lambda value: isinstance(value, list | tuple) and bool(
    value) and all(PATH.has(one) for one in value))


@takes(campaigns=_PATHS, odd=PATH, spec=NONE | WORD, below=NONE | FINITE)
def odd_coverage(
    campaigns: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    odd: str | os.PathLike[str], *, spec: str | None = None, below: float | None = None,
) -> coverage.OddCoverage:
    """Measure what campaigns cover of an operational design domain, as ``taxinet odd`` does.

    Args:
        campaigns: folder or table of a campaign, or several, of one system.
        odd: name of a shipped ODD, or its YAML file.
        spec: formula that defines failure; None for the headline.
        below: also count the combinations of cells that fail less often than this share, at 95 %.

    Returns:
        ``.inside``, ``.outside``, the runs and rate of each of the ``.cells``, ``.strengths``
        (combinations of 1, 2 and 3 cells: ``feasible``, ``covered``), ``.gaps``.

    Raises:
        UsageError: a mistake in the ODD, campaigns that cannot be counted together, or a limit
            that is no share.
    """
    if below is not None and not 0 < below < 1:
        raise UsageError(f'below={below:g}: needs to be a share above 0 and below 1')
    several = [campaigns] if isinstance(campaigns, str | os.PathLike) else campaigns
    first = read_runs(Path(several[0]), spec)
    runs = [first, *(read_runs(Path(one), first.spec) for one in several[1:])]
    return coverage.odd_coverage(
        read_odd(find_odd(os.fspath(odd))), distinct_labels(runs), limit=below
    )
