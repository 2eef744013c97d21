"""The findings about a campaign as plain values for ``analysis.json``."""

from __future__ import annotations

from typing import Any

from taxinet_ros.analysis.campaign_runs import CampaignRuns
from taxinet_ros.analysis.causes import Cause, FoundRate
from taxinet_ros.analysis.comparisons import Comparison
from taxinet_ros.analysis.failure_region import Region
from taxinet_ros.analysis.findings import Findings
from taxinet_ros.analysis.group_rates import GroupRate
from taxinet_ros.analysis.plain_values import plain_values
from taxinet_ros.analysis.report_parts import Report
from taxinet_ros.core.provenance import provenance

SCHEMA, VERSION = 'taxinet-analysis', 1


def findings_values(findings: Findings, report: Report) -> dict[str, Any]:
    """All findings; shares are fractions 0..1, and what is not known or not finite is None.

    Args:
        findings: of an analysis.
        report: on it.
    """
    values = {
        'schema': SCHEMA, 'version': VERSION, 'title': report.title, 'facts': dict(report.facts),
        'summary': list(report.summary), 'alpha': findings.alpha,
        'made_on': dict(provenance()),
        'campaign': _campaign(findings.runs),
        'ranking': [
            {'feature': one.feature.name, 'information_bit': one.information_bit,
             'explained': one.explained, 'p': one.p} for one in findings.ranking
        ],
        'causes': [_cause(one) for one in findings.causes.found],
        'causes_why_not': findings.causes.why_not,
        'causes_searched': findings.causes.searched, 'scenes_again': findings.causes.again,
        'outside_causes': _rate(findings.causes.rest), 'candidates': findings.causes.candidates,
        'clusters': [
            {'number': one.number, 'failures': one.failures, 'share': one.share,
             'words': one.words(), 'region': _region(one.common), 'typical_run': one.typical,
             'median_rho': one.median_rho} for one in findings.clusters.found
        ],
        'silhouette': findings.clusters.silhouette if findings.clusters.found else None,
        'principal_axes': [
            {'explained': one.explained, 'loadings': dict(one.loadings)} for one in findings.axes
        ],
        'tree': None if findings.tree is None else {
            'depth': findings.tree.depth, 'accuracy': findings.tree.accuracy,
            'guess': findings.tree.guess,
            'rules': [{'words': rule.region.words(), 'region': _region(rule.region),
                       'rate': _rate(rule.rate)} for rule in findings.tree.rules],
        },
        'baselines': [_baseline(one) for one in findings.comparisons],
        'runs_to_look_at': {run: str(folder) for run, folder in report.runs.items()},
    }
    return plain_values(values)


def _campaign(runs: CampaignRuns) -> dict[str, Any]:
    off = runs.off_runway()
    return {
        'label': runs.label, 'path': str(runs.path), 'program': runs.program,
        'perception': runs.perception, 'sampler': runs.sampler, 'spec': runs.spec,
        'stacks': [dict(stack) for stack in runs.stacks],
        'weighting': runs.weighting.value, 'judged': len(runs.frame),
        'without_verdict': dict(runs.others), 'undecided': runs.undecided,
        'stopped_early': runs.stopped, 'warnings': list(runs.warnings),
        'failed': _rate(runs.rate()),
        'left_runway': None if off is None else _rate(off),
    }


def _baseline(one: Comparison) -> dict[str, Any]:
    return {
        **_campaign(one.baseline), 'difference': one.difference._asdict(),
        'changed': None if one.changed is None else one.changed._asdict(),
        'in_causes': [_rate(rate) for rate in one.in_causes],
        'outside_causes': _rate(one.off_causes),
    }


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        'rank': cause.rank, 'words': cause.region.words(), 'sentence': cause.sentence(),
        'region': _region(cause.region), 'inside': _rate(cause.inside),
        'outside': _rate(cause.outside), 'all_runs': _rate(cause.whole),
        'share': cause.share, 'explained': cause.added,
        'attributable': dict(zip(('value', 'low', 'high'), cause.attributable, strict=True)),
        'p': cause.p, 'p_is_bound': cause.p_is_bound,
    }


def _region(region: Region) -> list[dict[str, Any]]:
    return [part.to_json() for part in region.parts]


def _rate(rate: GroupRate | FoundRate) -> dict[str, Any]:
    return rate._asdict()
