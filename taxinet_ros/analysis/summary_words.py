"""The findings about a campaign in sentences, the most important first."""

from __future__ import annotations

import math

from taxinet_ros.analysis.campaign_runs import CampaignRuns, Weighting
from taxinet_ros.analysis.failure_clusters import CLEAR, Clusters
from taxinet_ros.analysis.findings import Findings
from taxinet_ros.campaign.outcome_words import count_words

_WEAK = 0.25


def summary(findings: Findings) -> tuple[str, ...]:
    """What was found: rates, causes, and how baselines compare."""
    return (
        *rate_sentences(findings.runs), *cause_sentences(findings),
        *(one.sentence(findings.runs.label, findings.runs.rate())
          for one in findings.comparisons),
    )


def rate_sentences(runs: CampaignRuns) -> tuple[str, ...]:
    """How often runs fail, and how many have no verdict."""
    rate, off = runs.rate(), runs.off_runway()
    unit = 'run' if rate.runs == 1 else 'runs'
    count = f'{rate.runs:,} {unit} of {runs.program} with {runs.label}'
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
        case Weighting.UNKNOWN:
            first = (
                f'{count}, chosen by the sampler {runs.sampler or "(unknown)"}: {rate.failures:,} '
                f'violate {runs.spec}. There is no rate from this search: the program itself drew '
                'none of its runs, so they say where failures are, and not how many. All shares '
                'are of the runs made.'
            )
    return (first, *_without_verdict(runs))


def cause_sentences(findings: Findings) -> tuple[str, ...]:
    """The causes, one sentence each, and what they leave."""
    causes = findings.causes
    if causes.why_not:
        return (f'{causes.why_not[0].upper()}{causes.why_not[1:]}.',)
    if not causes.found:
        return (f'No cause found: the {findings.runs.rate().failures:,} failures lie among the '
                f'runs as chance would have them (at a level of {findings.alpha:g}).',)
    number, failures = len(causes.found), findings.runs.rate().failures
    many = 'One cause explains' if number == 1 else f'{number} causes explain'
    some = f'{100 * causes.explained:.1f} %' if causes.explained < 0.9995 else 'all'
    return (
        f'{many} {some} of the {failures:,} failures; elsewhere {causes.rest.words()} of '
        f'{causes.rest.runs:,} runs fail.',
        *(f'{cause.rank}. {cause.sentence()}.' for cause in causes.found),
    )


def cluster_sentence(clusters: Clusters) -> str:
    """How many groups there are, and how clear they are."""
    if clusters.why_not:
        return f'{clusters.why_not[0].upper()}{clusters.why_not[1:]}.'
    clear = 'clearly' if clusters.silhouette >= CLEAR else (
        'weakly' if clusters.silhouette >= _WEAK else 'hardly')
    some = f'{clusters.compared:,} failures'
    if clusters.compared < clusters.failures:
        some = f'{clusters.compared:,} of the {clusters.failures:,} failures, drawn at random,'
    return (
        f'{some} were compared by the features that tell of failing. They '
        f'fall into {len(clusters.found)} groups that are {clear} apart (silhouette '
        f'{clusters.silhouette:.2f}; 1 is perfect, 0 none).'
    )


def _anytime(runs: CampaignRuns) -> str:
    if not runs.anytime:
        return ''
    return (' As the number of runs was not settled beforehand, the intervals are those that hold '
            'wherever a campaign stops.')


def _without_verdict(runs: CampaignRuns) -> tuple[str, ...]:
    words = [count_words(runs.others, runs.kinds)] if runs.others else []
    if runs.undecided:
        words.append(f'{runs.undecided:,} stopped before {runs.spec} was decided')
    return (f'Without verdict, and in no rate: {", ".join(words)}.',) if words else ()
