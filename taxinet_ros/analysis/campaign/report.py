"""The report on a campaign: its findings as sentences, tables and pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from taxinet_ros.analysis.campaign.cause_figures import (
    causes_picture,
    clusters_picture,
    ranking_picture,
)
from taxinet_ros.analysis.campaign.figures import (
    clouds_picture,
    distribution_picture,
    map_picture,
    rates_picture,
    rho_picture,
)
from taxinet_ros.analysis.campaign.findings import Findings, bag_folders, failures_to_inspect
from taxinet_ros.analysis.campaign.tables import (
    axes_table,
    bins_table,
    causes_table,
    clusters_table,
    failures_table,
    ranking_table,
    rates_table,
    tree_table,
)
from taxinet_ros.analysis.causes.clusters import CLEAR, Clusters
from taxinet_ros.analysis.causes.program import confirmation_command, why_no_program
from taxinet_ros.analysis.causes.scan import DISCOUNT, SHUFFLES
from taxinet_ros.analysis.report.parts import Report, Section
from taxinet_ros.analysis.runs.campaign import CampaignRuns, Weighting
from taxinet_ros.analysis.runs.features import (
    CLOUDS_KIND,
    CROSS_TRACK,
    DISTANCE,
    HEADING,
    TIME_OF_DAY,
    varied,
)
from taxinet_ros.core.provenance import differences, words
from taxinet_ros.trials.rates import count_words

_WEAK = 0.25


def summary(findings: Findings) -> tuple[str, ...]:
    """Main findings: rates, causes, and comparisons with baselines."""
    return (
        *rate_sentences(findings.runs), *cause_sentences(findings),
        *stack_sentences(findings.campaigns),
        *(f'Warning: {one.baseline.label}: {line}.' for one in findings.comparisons
          for line in one.baseline.warnings),
        *(one.sentence(findings.runs.label, findings.runs.rate())
          for one in findings.comparisons),
    )


def rate_sentences(runs: CampaignRuns) -> tuple[str, ...]:
    """Failure rate, and number of runs without a verdict."""
    rate, off = runs.rate(), runs.off_runway()
    unit = 'run' if rate.runs == 1 else 'runs'
    scenes = runs.scenes_words
    comma = ',' if scenes != runs.program else ''
    count = f'{rate.runs:,} {unit} of {scenes}{comma} with {runs.label}'
    known = off is not None and not math.isnan(off.low)
    left = f'; the aircraft leaves the runway in {off.words()}' if off and known else ''
    match runs.weighting:
        case Weighting.DRAWN:
            first = f'{count}: {rate.words()} violate {runs.spec}{left}.{_anytime(runs)}'
        case Weighting.WEIGHTED:
            first = (
                f'{count}, chosen by the sampler {runs.sampler}: {rate.failures:,} violate '
                f'{runs.spec}. Of the {rate.effective:,.0f} runs among them that the program '
                f'itself drew it is {rate.words()}{left}; all rates here are of such runs.'
                f'{_anytime(runs)}'
            )
        case Weighting.UNDECIDED:
            low, high = (100 * end for end in runs.bounds)
            first = (
                f'{count}: {rate.failures:,} violate {runs.spec}; {runs.undecided:,} more were '
                'stopped before it was decided. So there is no failure rate of it: at 95 % '
                f'confidence it is at least {low:.1f} % and at most {high:.1f} %, if all of those '
                'satisfy or violate it. All shares refer to the decided runs.'
            )
        case Weighting.UNKNOWN if runs.uncounted:
            first = (
                f'{count}: {rate.failures:,} violate {runs.spec}. There is no failure rate: the '
                'runs that the program itself drew follow one without a result. All shares refer '
                'to the runs made.'
            )
        case Weighting.UNKNOWN:
            first = (
                f'{count}, chosen by the sampler {runs.sampler or "(unknown)"}: {rate.failures:,} '
                f'violate {runs.spec}. This search yields no failure rate: the program itself drew '
                'none of its runs, so they show where failures are, not how frequent. All shares '
                'refer to the runs made.'
            )
    return (first, *_without_verdict(runs), *(f'Warning: {line}.' for line in runs.warnings))


def stack_sentences(campaigns: Sequence[CampaignRuns]) -> tuple[str, ...]:
    """A warning if the compared runs come from different machines or versions."""
    sentences = []
    if found := differences(*(stack for one in campaigns for stack in one.stacks)):
        sentences.append(
            f'The runs were made on different machines or versions: {found}. A closed loop '
            'amplifies a last bit; see docs/determinism.md.'
        )
    untold = [one.label for one in campaigns if not one.stacks]
    if untold and len(campaigns) > 1:
        sentences.append(
            f'Machine and versions are unknown for the runs of {", ".join(untold)} were '
            'made.'
        )
    return tuple(sentences)


def cause_sentences(findings: Findings) -> tuple[str, ...]:
    """The causes, one sentence each, and the rate outside them."""
    causes = findings.causes
    if causes.why_not:
        return (f'{causes.why_not[0].upper()}{causes.why_not[1:]}.',)
    if not causes.found:
        return (
            f'No cause found: the {findings.runs.rate().failures:,} failures are spread among the '
            f'runs as by chance (at a level of {findings.alpha:g}).',
        )
    number, failures = len(causes.found), findings.runs.rate().failures
    many = 'One cause contains' if number == 1 else f'{number} causes contain'
    some = f'{100 * causes.explained:.1f} %' if causes.explained < 0.9995 else 'all'
    return (
        f'{many} {some} of the {failures:,} failures; elsewhere {causes.rest.words()} of '
        f'{causes.rest.runs:,} runs fail.',
        *(f'{cause.rank}. {cause.sentence()}.' for cause in causes.found),
    )


def cluster_sentence(clusters: Clusters) -> str:
    """Number of groups, and how clearly they are separated."""
    if clusters.why_not:
        return f'{clusters.why_not[0].upper()}{clusters.why_not[1:]}.'
    clear = 'clearly' if clusters.silhouette >= CLEAR else (
        'weakly' if clusters.silhouette >= _WEAK else 'hardly')
    some = f'{clusters.compared:,} failures'
    if clusters.compared < clusters.failures:
        some = f'{clusters.compared:,} of the {clusters.failures:,} failures, drawn at random,'
    return (
        f'{some} were compared by the features that predict failure. They '
        f'fall into {len(clusters.found)} groups that are {clear} apart (silhouette '
        f'{clusters.silhouette:.2f}; 1 is perfect, 0 none).'
    )


def _anytime(runs: CampaignRuns) -> str:
    if not runs.anytime:
        return ''
    return (
        ' Since the number of runs was not fixed beforehand, the intervals are valid at any '
        'stopping point.'
    )


def _without_verdict(runs: CampaignRuns) -> tuple[str, ...]:
    words = [count_words(runs.others, runs.kinds)] if runs.others else []
    if runs.undecided:
        words.append(f'{runs.undecided:,} stopped before {runs.spec} was decided')
    return (f'Without verdict, and in no rate: {", ".join(words)}.',) if words else ()


VIEWERS = 20


def campaign_report(findings: Findings, *, viewers: int = VIEWERS) -> Report:
    """Present findings as sentences, tables and pictures.

    Args:
        findings: result of :func:`~taxinet_ros.analysis.campaign.findings.analyse`.
        viewers: maximum number of failed runs to include step by step.
    """
    failures = failures_to_inspect(findings)
    count = len(findings.runs.frame)
    return Report(
        title=f'{findings.runs.program}: {count:,} {"run" if count == 1 else "runs"} of '
        f'{findings.runs.label}',
        facts=_facts(findings), summary=summary(findings),
        sections=_sections(findings, failures),
        **_worst_first(bag_folders(findings.runs, failures, viewers), failures),
        made_on='; '.join(map(words, findings.runs.stacks)),
    )


def _worst_first(runs: Mapping[str, Path], failures: pd.DataFrame) -> dict[str, Any]:
    """The runs to look at in order of robustness, and the worst of them for the first screen."""
    rho = dict(zip(failures['run_id'], failures['rho'].astype(float), strict=True))
    ordered = {run: runs[run] for run in sorted(runs, key=lambda run: (rho[run], run))}
    return {
        'runs': ordered, 'worst': next(iter(ordered), ''),
        'rho': {run: rho[run] for run in ordered},
    }


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
        sentences.append(f'Constant in all runs, so not a cause: {", ".join(constant)}.')
    if findings.causes.candidates:
        sentences.append(
            f'Method: {findings.causes.candidates:,} regions were compared (intervals, categories, '
            'slanted bands of two features, and pairs of conditions, which need a likelihood ratio '
            f'{DISCOUNT - 1:.0%} larger) by the likelihood ratio of the failure rates inside and '
            'outside. The best one is kept if one as good would be found anywhere in less than '
            f'{findings.alpha:.0%} of cases without any cause'
            .replace('%', ' %'))
        how = (
            '; outcomes influenced the choice of scenes, so the runs were evaluated in order, each '
            'before the next was chosen. All shares refer to the runs made: they are no failure '
            'rates of the program and have no intervals'
            if findings.causes.searched
            else f' (by {SHUFFLES} shufflings of the outcomes, or a bound where that is smaller). '
            + ('All intervals of causes hold for all regions at once, so also for those selected'
               if not findings.runs.undecided else
               'They are of the decided runs alone, which their results selected, so they have no '
               'intervals')
        )
        sentences[-1] += how + '. Its runs are removed, and the search is repeated.'
    if findings.causes.again:
        sentences.append(
            f'{findings.causes.again:,} runs repeat the scene of another and are not counted here.'
        )
    commands = [command for cause in findings.causes.found
                if (command := confirmation_command(findings.runs, cause)) is not None]
    if commands:
        sentences.append(
            'To test a cause on fresh scenes, run its command in this folder:')
    elif findings.causes.found:
        why = why_no_program(findings.runs)
        sentences.append(f'There is no program to test the causes on fresh scenes: {why}.')
    return Section(
        name='causes', heading='Causes', sentences=tuple(sentences), commands=tuple(commands),
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
        sentences.append(
            f'The longest principal axis of the failures explains {100 * first.explained:.0f} % of '
            f'their variance; the mean of all {len(findings.axes)} axes is '
            f'{100 / len(findings.axes):.0f} %, and the longest is above it also by chance.')
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
        name='tree', heading='Decision tree',
        sentences=(
            f'A tree of {tree.depth} {"question" if tree.depth == 1 else "questions"} at most '
            f'classifies {100 * tree.accuracy:.0f} % of held-out runs correctly (five-fold '
            f'cross-validation); always guessing the more common outcome, {100 * tree.guess:.0f} '
            '%.',
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
        'program': runs.scenes_words, 'network': runs.perception,
        'network, SHA-256': str(facts.get('perception_sha256') or '')[:16],
        'timing': str(facts.get('timing') or ''),
        'sampler': runs.sampler or 'none, drawn from the program',
        'seed': str(facts.get('seed', '')),
        'formula': f'{runs.spec}: {_formula(runs)}' if _formula(runs) else runs.spec,
        'runs': f'{len(runs.frame):,} with a verdict',
        'baselines': ', '.join(one.baseline.label for one in findings.comparisons),
        'table': runs.path.name, 'version': str(facts.get('taxinet_ros_version') or ''),
    }
    return {name: value for name, value in found.items() if value}


def _formula(runs: CampaignRuns) -> str:
    specs = runs.facts.get('specs')
    return str(specs.get(runs.spec, '')) if isinstance(specs, dict) else ''
