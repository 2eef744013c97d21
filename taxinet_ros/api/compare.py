"""Comparison of two networks on the same scenes, from Python."""

from __future__ import annotations

import os
from pathlib import Path

from taxinet_ros.analysis.campaign.compared import Compared, compared
from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs
from taxinet_ros.arguments import PATH, takes


@takes(before=PATH, after=PATH)
def compare(before: str | os.PathLike[str], after: str | os.PathLike[str]) -> Compared:
    """Compare two campaigns, scene by scene, as ``taxinet compare`` does.

    Args:
        before: folder of a campaign, or a table of one.
        after: the same of the second network.

    Returns:
        ``.satisfied`` (counts of the pairs, their ``difference`` with its 95 % interval and the
        ``p_value`` of McNemar's exact test, valid if ``.tested``), ``.scenes`` (a row per scene),
        and the causes of what got ``.better`` and ``.worse``.

    Raises:
        UsageError: they have no scene in common, or are judged by different requirements.
    """
    first = read_runs(Path(before))
    return compared(*distinct_labels([first, read_runs(Path(after), first.spec)]))
