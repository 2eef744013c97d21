"""Findings of an analysis of a campaign.

Causes and predictors of its failures, comparisons with baselines (rates, their
difference, and runs that changed in the same scenes), and which failed runs to look at first.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from taxinet_ros.analysis.causes.causes import Causes, find_causes
from taxinet_ros.analysis.causes.predictors import RankedFeature, rank_features
from taxinet_ros.analysis.experiment.pairs import PairedRates, paired_rates
from taxinet_ros.analysis.runs.campaign import (
    CampaignRuns,
    ConfidenceInterval,
    GroupRate,
    difference,
)
from taxinet_ros.analysis.runs.features import SCENE_COLUMNS
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.layout import holds_bag
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.trials.record.facts import recorded_world
from taxinet_ros.trials.run_command import RunSettings

_DIGITS = 6
_SIGNIFICANT = 0.05


class ChangedScenes(NamedTuple):
    """Scenes that both networks were run in.

    Attributes:
        scenes: how many there are; of the runs that count in rates, where both have rates.
        worse: number failed here but satisfied by the baseline.
        better: number satisfied here but failed by the baseline.
        p: p value of the hypothesis that both fail equally often (McNemar's exact test); NaN if
            results influenced which scenes there are: without rates, or at an open number of runs.
    """

    scenes: int
    worse: int
    better: int
    p: float


@dataclass(frozen=True, kw_only=True)
class BaselineComparison:
    """Comparison of a campaign with a baseline.

    Attributes:
        baseline: the other campaign.
        rate: its failure rate.
        difference: the campaign's failure rate minus the baseline's; where all scenes of either
            were run in both, and their number was fixed beforehand, in these.
        paired: whether it is that of the same scenes.
        changed: changes in common scenes, or None if there are none.
        differing: display names of settings that differ, or are not recorded.
        in_causes: failure rate of the baseline in each of the campaign's causes.
        off_causes: its failure rate outside all of them.
    """

    baseline: CampaignRuns
    rate: GroupRate
    difference: ConfidenceInterval
    paired: bool
    changed: ChangedScenes | None
    differing: tuple[str, ...]
    in_causes: tuple[GroupRate, ...]
    off_causes: GroupRate

    @property
    def clear(self) -> bool:
        """Whether the rates differ significantly."""
        if self.paired and self.changed is not None:
            return self.changed.p < _SIGNIFICANT
        return self.difference.clear


def compare(runs: CampaignRuns, baseline: CampaignRuns, causes: Causes) -> BaselineComparison:
    """Compare a campaign with a baseline, overall and in each cause."""
    masks = [cause.region.mask(baseline.frame) for cause in causes.found]
    rate = baseline.rate()
    elsewhere = ~np.logical_or.reduce([np.zeros(len(baseline.frame), dtype=bool), *masks])
    pairs = _pairs(runs, baseline)
    rated = runs.weighting.rated and baseline.weighting.rated
    tested = rated and not (runs.anytime or baseline.anytime)
    paired = tested and pairs.pairs >= min(runs.rate().effective, baseline.rate().effective)
    return BaselineComparison(
        baseline=baseline, rate=rate, paired=paired,
        difference=pairs.difference if paired else difference(runs.rate(), rate),
        changed=None if not pairs.pairs else ChangedScenes(
            pairs.pairs, worse=pairs.only_second, better=pairs.only_first,
            p=pairs.p_value if tested else math.nan,
        ),
        differing=differing_settings(runs, baseline),
        in_causes=tuple(baseline.rate(mask) for mask in masks),
        off_causes=baseline.rate(elsewhere),
    )


def common_scenes(
    runs: CampaignRuns, baseline: CampaignRuns, *, all_runs: bool = False
) -> pd.DataFrame:
    """Scenes that both were run in; of the runs that count, where both have rates.

    Scenes are the same if all keys are, numbers to the last stored digit. Of a scene that was drawn
    several times, first is paired with first, and so on. With ``all_runs``, those of runs that do
    not count are among them.

    Returns:
        The scene by key, and ``row`` and ``failed`` of either, the baseline's as ``row_there`` and
        ``failed_there``; rows are those of the campaigns' frames.
    """
    rated = runs.weighting.rated and baseline.weighting.rated and not all_runs
    return paired_scenes(*(
        some.scenes.assign(failed=some.failed, row=np.arange(len(some.frame)))[
            (some.weight == 1) if rated else slice(None)
        ] for some in (runs, baseline)
    ))


def paired_scenes(one: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """Join equal scenes, the n-th of each with the n-th; the other's columns end in ``_there``."""
    keys = list(SCENE_COLUMNS)
    first, second = (
        some.assign(nth=some.groupby(keys, dropna=False, sort=False).cumcount())
        for some in (one.round(_DIGITS), other.round(_DIGITS))
    )
    return first.merge(second, on=[*keys, 'nth'], suffixes=('', '_there'))


def _pairs(runs: CampaignRuns, baseline: CampaignRuns) -> PairedRates:
    """Failures in common scenes, the baseline's first."""
    both = common_scenes(runs, baseline)
    return paired_rates(both['failed_there'].tolist(), both['failed'].tolist())


def differing_settings(runs: CampaignRuns, baseline: CampaignRuns) -> tuple[str, ...]:
    """Settings that a comparison depends on beside scenes and network."""
    if not (runs.facts and baseline.facts):
        return ('the settings, of which there is no record',)
    one, other = (_settings(some) for some in (runs, baseline))
    found = [name for name in one if one[name] != other[name]]
    hashes = {'program_sha256': 'program', 'controller_sha256': 'controller'}
    if runs.perception == baseline.perception:
        hashes['perception_sha256'] = 'weights'
    found += [
        name for key, name in hashes.items()
        if runs.facts.get(key, '') != baseline.facts.get(key, '')
    ]
    return tuple(dict.fromkeys(found))


def _settings(runs: CampaignRuns) -> dict[str, Any]:
    settings = RunSettings.from_facts(runs.facts)
    judging = settings.judging
    return {
        'controller': settings.controller, 'gains': settings.gains,
        'world': recorded_world(runs.facts), 'timing': settings.timing,
        'stop rule': judging.stop_on, 'assumed bounds': judging.bounds,
        'assumed rates': judging.rates,
        f'formula {runs.spec}': runs.formula,
    }


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Results of an analysis.

    Attributes:
        runs: runs of the campaign.
        alpha: significance level of the causes.
        ranking: features by how well they predict failure.
        causes: of the failures.
        comparisons: with the baselines, in their order.
    """

    runs: CampaignRuns
    alpha: float
    ranking: tuple[RankedFeature, ...]
    causes: Causes
    comparisons: tuple[BaselineComparison, ...]

    @property
    def campaigns(self) -> tuple[CampaignRuns, ...]:
        """The campaign and its baselines."""
        return (self.runs, *(one.baseline for one in self.comparisons))


def analyse(
    runs: CampaignRuns, baselines: Sequence[CampaignRuns] = (), *, alpha: float = 0.05,
    on_progress: Callable[[str], None] = lambda _: None,
) -> Findings:
    """Analyse a campaign; the same runs give the same findings.

    Args:
        runs: runs of the campaign.
        baselines: other campaigns to compare with.
        alpha: probability of naming a cause if there is none.
        on_progress: called with the name of each step.
    """
    on_progress('features')
    ranking = rank_features(runs.frame)
    on_progress('causes')
    causes = find_causes(runs, alpha)
    return Findings(
        runs=runs, alpha=alpha, ranking=ranking, causes=causes,
        comparisons=tuple(compare(runs, baseline, causes) for baseline in baselines),
    )


CAUSE = 'cause'
_NONE = 0


def explained_runs(findings: Findings) -> pd.DataFrame:
    """All judged runs with the cause of each failure, 0 for none.

    A failure in several causes has the number of the first.
    """
    frame = findings.runs.frame.copy()
    cause = np.full(len(frame), _NONE)
    for found in reversed(findings.causes.found):
        cause[found.region.mask(frame)] = found.rank
    frame[CAUSE] = np.where(frame['failed'], cause, _NONE)
    return frame


def failures_to_inspect(findings: Findings) -> pd.DataFrame:
    """The failures in order of inspection, as :func:`explained_runs` has them.

    First the worst one of each cause, then the second worst of each, and so on; so the first few
    show all kinds of failures.
    """
    frame = explained_runs(findings)
    failures = frame[frame['failed']].sort_values(['rho', 'index'], kind='stable')
    # Failures without a cause come after the causes in each round.
    rank = failures[CAUSE].replace(_NONE, len(findings.causes.found) + 1)
    failures = failures.assign(turn=failures.groupby(CAUSE).cumcount(), rank=rank)
    ordered = failures.sort_values(['turn', 'rank'], kind='stable', ignore_index=True)
    return ordered.drop(columns=['turn', 'rank'])


def bag_folders(runs: CampaignRuns, failures: pd.DataFrame, most: int) -> Mapping[str, Path]:
    """The folders of the first failures whose bags are there, by run id.

    Args:
        runs: runs of the campaign.
        failures: failures in order of inspection.
        most: maximum number of folders.

    Raises:
        UsageError: a bag belongs to another run.
    """
    found: dict[str, Path] = {}
    for run_id, bag in zip(failures['run_id'], failures['bag'], strict=True):
        if len(found) >= most:
            break
        folder = runs.folder / bag
        if bag and holds_bag(folder):
            with contextlib.suppress(BagError):  # the page reports a damaged one
                open_recording(folder).check_is(str(run_id))
            found[str(run_id)] = folder
    return found
