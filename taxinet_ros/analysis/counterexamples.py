"""Which failed runs to look at: typical ones, then the worst of each cause in turn."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from taxinet_ros.analysis.campaign_runs import CampaignRuns
from taxinet_ros.analysis.findings import Findings
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.facts import read_facts
from taxinet_ros.core.errors import UsageError

CAUSE, GROUP = 'cause', 'group'
_NONE = 0


def explained_runs(findings: Findings) -> pd.DataFrame:
    """All judged runs with the cause and the group of each failure, 0 for none.

    A failure that lies in several causes has the number of the first.
    """
    frame = findings.runs.frame.copy()
    cause = np.full(len(frame), _NONE)
    for found in reversed(findings.causes.found):
        cause[found.region.mask(frame)] = found.rank
    frame[CAUSE] = np.where(frame['failed'], cause, _NONE)
    group = {run: one.number for one in findings.clusters.found for run in one.runs}
    frame[GROUP] = frame['run_id'].map(lambda run: group.get(run, _NONE)).astype(int)
    return frame


def to_look_at(findings: Findings) -> pd.DataFrame:
    """The failures in the order in which to look at them, as :func:`explained_runs` has them.

    First the most typical run of each group, then the worst one of each cause, then the second
    worst of each, and so on; so the first few show all kinds of failures.
    """
    frame = explained_runs(findings)
    failures = frame[frame['failed']].sort_values(['rho', 'index'], kind='stable')
    typical = [one.typical for one in findings.clusters.found]
    first = failures['run_id'].isin(typical)
    others = failures[~first]
    # What no cause explains comes after the causes in each turn.
    rank = others[CAUSE].replace(_NONE, len(findings.causes.found) + 1)
    others = others.assign(turn=others.groupby(CAUSE).cumcount(), rank=rank)
    others = others.sort_values(['turn', 'rank'], kind='stable').drop(columns=['turn', 'rank'])
    ordered = failures[first].set_index('run_id', drop=False).loc[typical]
    return pd.concat([ordered, others], ignore_index=True)


def bag_folders(runs: CampaignRuns, failures: pd.DataFrame, most: int) -> Mapping[str, Path]:
    """The folders of the first failures whose bags are there, by run id.

    Args:
        runs: of the campaign.
        failures: in the order in which to look at them.
        most: how many.

    Raises:
        UsageError: a bag is of another run.
    """
    found: dict[str, Path] = {}
    for run_id, bag in zip(failures['run_id'], failures['bag'], strict=True):
        if len(found) >= most:
            break
        folder = runs.folder / bag
        if bag and any(folder.glob('*.mcap')):
            _check_run(str(run_id), folder)
            found[str(run_id)] = folder
    return found


def _check_run(run_id: str, bag: Path) -> None:
    with contextlib.suppress(BagError):  # the page says of a damaged one that it is
        told = read_facts(bag)
        if told is not None and told.run_id != run_id:
            raise UsageError(
                f'{bag}: is of run {told.run_id}, not of {run_id}; was the folder moved here? '
                f'taxinet doctor {bag.parent} checks all of them'
            )
