"""All that an analysis finds out about a campaign, before it is put into words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from taxinet_ros.analysis.campaign_runs import CampaignRuns
from taxinet_ros.analysis.cause_tree import CauseTree, grow_tree
from taxinet_ros.analysis.causes import Causes, find_causes
from taxinet_ros.analysis.comparisons import Comparison, compare
from taxinet_ros.analysis.failure_clusters import Clusters, find_clusters
from taxinet_ros.analysis.feature_ranking import Ranked, rank_features
from taxinet_ros.analysis.principal_axes import PrincipalAxis, principal_axes


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What was found.

    Attributes:
        runs: of the campaign.
        alpha: level of the causes.
        ranking: features by how much they tell of failing.
        causes, clusters, axes, tree: of the failures.
        comparisons: with the baselines, in their order.
    """

    runs: CampaignRuns
    alpha: float
    ranking: tuple[Ranked, ...]
    causes: Causes
    clusters: Clusters
    axes: tuple[PrincipalAxis, ...]
    tree: CauseTree | None
    comparisons: tuple[Comparison, ...]

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
        runs: of the campaign.
        baselines: other campaigns to hold it against.
        alpha: how often a cause may be named where there is none.
        on_progress: is told what is being done.
    """
    on_progress('features')
    ranking = rank_features(runs.frame)
    on_progress('causes')
    causes = find_causes(runs, alpha)
    on_progress('clusters')
    telling = [one.feature.name for one in ranking if one.p <= alpha]
    clusters = find_clusters(runs.frame, telling)
    on_progress('tree')
    return Findings(
        runs=runs, alpha=alpha, ranking=ranking, causes=causes, clusters=clusters,
        axes=principal_axes(runs.frame), tree=grow_tree(runs),
        comparisons=tuple(compare(runs, baseline, causes) for baseline in baselines),
    )
