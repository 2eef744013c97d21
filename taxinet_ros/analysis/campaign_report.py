"""The report on a campaign: from a table of runs to why they fail."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from taxinet_ros.analysis.campaign_runs import CampaignRuns
from taxinet_ros.analysis.campaign_tables import (
    axes_table,
    bins_table,
    causes_table,
    clusters_table,
    failures_table,
    ranking_table,
    rates_table,
    tree_table,
)
from taxinet_ros.analysis.cause_figures import causes_picture, clusters_picture, ranking_picture
from taxinet_ros.analysis.cause_program import confirming
from taxinet_ros.analysis.cause_scan import DISCOUNT, SHUFFLES
from taxinet_ros.analysis.counterexamples import bag_folders, to_look_at
from taxinet_ros.analysis.findings import Findings
from taxinet_ros.analysis.rate_figures import distribution_picture, map_picture, rates_picture
from taxinet_ros.analysis.report_parts import Report, Section
from taxinet_ros.analysis.rho_figures import clouds_picture, rho_picture
from taxinet_ros.analysis.run_features import (
    CLOUDS_KIND,
    CROSS_TRACK,
    DISTANCE,
    HEADING,
    TIME_OF_DAY,
    varied,
)
from taxinet_ros.analysis.summary_words import cluster_sentence, summary
from taxinet_ros.core.provenance import words

VIEWERS = 20


def campaign_report(findings: Findings, *, viewers: int = VIEWERS) -> Report:
    """Put findings into words, tables and pictures.

    Args:
        findings: of :func:`~taxinet_ros.analysis.findings.analyse`.
        viewers: most failed runs to look at step by step.
    """
    failures = to_look_at(findings)
    count = len(findings.runs.frame)
    return Report(
        title=f'{findings.runs.program}: {count:,} {"run" if count == 1 else "runs"} of '
        f'{findings.runs.label}',
        facts=_facts(findings), summary=summary(findings),
        sections=_sections(findings, failures),
        runs=bag_folders(findings.runs, failures, viewers),
    )


def _sections(findings: Findings, failures: pd.DataFrame) -> tuple[Section, ...]:
    sections = [
        _rates(findings), _day(findings), _runway(findings), _start_pose(findings),
        _causes(findings, failures), _failures(failures, findings.runs), _clusters(findings),
        _tree(findings), _robustness(findings),
    ]
    return tuple(section for section in sections if section is not None)


def _rates(findings: Findings) -> Section:
    return Section(
        name='rates', heading='Rates',
        pictures=(rates_picture(findings.campaigns),),
        tables=(rates_table(findings), bins_table(findings.runs)),
    )


def _day(findings: Findings) -> Section:
    return Section(
        name='day', heading='Over the day',
        pictures=(
            rho_picture(findings.campaigns, TIME_OF_DAY, 'rho_by_hour'),
            clouds_picture(findings.campaigns),
            map_picture(findings.runs, TIME_OF_DAY, CLOUDS_KIND, 'rate_by_hour_and_clouds'),
        ),
    )


def _runway(findings: Findings) -> Section:
    return Section(
        name='runway', heading='Along the runway',
        pictures=(
            rho_picture(findings.campaigns, DISTANCE, 'rho_by_distance'),
            map_picture(findings.runs, DISTANCE, TIME_OF_DAY, 'rate_by_distance_and_hour'),
        ),
    )


def _start_pose(findings: Findings) -> Section:
    return Section(
        name='start_pose', heading='Start pose',
        pictures=(
            rho_picture(findings.campaigns, HEADING, 'rho_by_heading'),
            rho_picture(findings.campaigns, CROSS_TRACK, 'rho_by_cross_track'),
        ),
    )


def _causes(findings: Findings, failures: pd.DataFrame) -> Section:
    constant = [feature.title for feature in (TIME_OF_DAY, CLOUDS_KIND, DISTANCE, HEADING,
                                              CROSS_TRACK)
                if not varied(findings.runs.frame, (feature,))]
    sentences = []
    if constant:
        sentences.append(f'The same in all runs, and so no cause: {", ".join(constant)}.')
    if findings.causes.candidates:
        sentences.append(
            f'How they were found: {findings.causes.candidates:,} regions were compared: intervals '
            'and kinds, slanted bands of two features, and pairs of conditions (which must tell '
            f'{DISCOUNT - 1:.0%} more to be named), by the likelihood ratio of the failure rates '
            'inside and outside. The most telling one is kept if so telling a one would be found '
            f'somewhere in less than {findings.alpha:.0%} of cases without any cause'
            .replace('%', ' %'))
        how = (
            '; the outcomes had a part in the choice of the scenes, so the runs were judged in '
            'their order, each before the next was chosen. All shares are of the runs made: they '
            'are no rates of the program, and have no intervals' if findings.causes.searched else
            f' (by {SHUFFLES} shufflings of the outcomes, or a bound where that is smaller). '
            'All intervals of causes hold for all regions together, and so for those picked'
        )
        sentences[-1] += how + '. Its runs are taken out, and the next is looked for.'
    if findings.causes.again:
        sentences.append(f'{findings.causes.again:,} runs repeat the very scene of another, and '
                         'do not count here.')
    commands = [command for cause in findings.causes.found
                if (command := confirming(findings.runs, cause)) is not None]
    if commands:
        sentences.append(
            'Each cause can be tested on fresh scenes by a command of its own, in this folder:')
        sentences += commands
    return Section(
        name='causes', heading='Causes', sentences=tuple(sentences),
        pictures=(*((causes_picture(findings),) if findings.causes.found else ()),
                  *((ranking_picture(findings.ranking),) if findings.ranking else ())),
        tables=(*((causes_table(findings, failures),) if findings.causes.found else ()),
                *((ranking_table(findings),) if findings.ranking else ())),
    )


def _failures(failures: pd.DataFrame, runs: CampaignRuns) -> Section | None:
    if failures.empty:
        return None
    shown = min(len(failures), 2 * VIEWERS)
    more = '' if shown == len(failures) else f'; all {len(failures):,} are in runs.csv'
    return Section(
        name='counterexamples', heading='Counterexamples',
        sentences=(f'{shown} of the runs that violate {runs.spec}{more}.',),
        tables=(failures_table(failures, shown),),
    )


def _clusters(findings: Findings) -> Section:
    found = bool(findings.clusters.found)
    sentences = [cluster_sentence(findings.clusters)]
    if findings.axes:
        first = findings.axes[0]
        even = 1 / len(findings.axes)
        sentences.append(
            f'The longest principal axis of the failures holds {100 * first.explained:.0f} % of '
            f'their variance, where features without any relation would have {100 * even:.0f} %.')
    return Section(
        name='clusters', heading='Groups of failures', sentences=tuple(sentences),
        pictures=(clusters_picture(findings),) if found else (),
        tables=(*((clusters_table(findings),) if found else ()),
                *((axes_table(findings),) if findings.axes else ())),
    )


def _tree(findings: Findings) -> Section | None:
    tree = findings.tree
    if tree is None:
        return None
    return Section(
        name='tree', heading='As a tree of questions',
        sentences=(
            f'A tree of {tree.depth} {"question" if tree.depth == 1 else "questions"} at most '
            f'tells {100 * tree.accuracy:.0f} % of held-back runs right (five-fold '
            f'cross-validation); always guessing the commoner outcome, {100 * tree.guess:.0f} %.',
        ),
        tables=(tree_table(findings),),
    )


def _robustness(findings: Findings) -> Section:
    rho = findings.runs.frame['rho'].quantile([0.05, 0.5, 0.95])
    words = ', '.join(f'{value:+.2f}'.replace('-', '−') for value in rho)
    return Section(
        name='robustness', heading='How robust the runs are',
        sentences=(f'Robustness of the runs made, 5 %, 50 % and 95 % quantile: {words}.',),
        pictures=(distribution_picture(findings.campaigns),),
    )


def _facts(findings: Findings) -> Mapping[str, str]:
    runs, facts = findings.runs, findings.runs.facts
    found = {
        'program': runs.program, 'network': runs.perception,
        'network, SHA-256': str(facts.get('perception_sha256') or '')[:16],
        'timing': str(facts.get('timing') or ''),
        'sampler': runs.sampler or 'none, drawn from the program',
        'seed': str(facts.get('seed', '')),
        'formula': f'{runs.spec}: {_formula(runs)}' if _formula(runs) else runs.spec,
        'runs': f'{len(runs.frame):,} with a verdict',
        'baselines': ', '.join(one.baseline.label for one in findings.comparisons),
        'table': str(runs.path), 'version': str(facts.get('taxinet_ros_version') or ''),
        'made on': '; '.join(map(words, runs.stacks)) or 'not told',
    }
    return {name: value for name, value in found.items() if value}


def _formula(runs: CampaignRuns) -> str:
    specs = runs.facts.get('specs')
    return str(specs.get(runs.spec, '')) if isinstance(specs, dict) else ''
