"""State of an interrupted search, and whether it is the same search.

If the graph determines perception and timing, they are known only after its first result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE, is_free, timing_words
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.trials.record.book import UNKNOWN_TO_SAMPLER, check_same_campaign
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import ARM, ARMS, UNTIL, recorded_rules
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.rows import RowsByIndex

PERCEPTION_KEYS = ('perception', 'perception_sha256', 'timing')
"""The facts on perception and timing; all are empty until the graph has answered."""


def facts_of_graph(out: Path, facts: Mapping[str, Any], result: RunResult) -> dict[str, str]:
    """Facts added by a result: the perception and timing, if not known before.

    Args:
        out: folder of the campaign.
        facts: facts of the campaign.
        result: the result; it adds nothing if the run failed before a perception was ready.

    Raises:
        UsageError: the perception, or the timing of its answers, differs from the start of the
            campaign.
    """
    found = dict(
        zip(PERCEPTION_KEYS, (result.perception, result.fingerprint, result.timing), strict=True)
    )
    if is_free(result.timing):
        raise UsageError(
            f'the graph is free-running, but a search needs reproducible verdicts: '
            f'{NOT_REPRODUCIBLE}; start the simulator with lockstep:=true, or leave the sampler out'
        )
    if not result.perception:
        return {}
    if not facts['perception']:
        return found
    if facts['timing'] != result.timing:
        raise UsageError(
            f'{out} was begun with {timing_words(facts["timing"])}, but the graph has '
            f'{timing_words(result.timing)}; start the original one, or choose another --out'
        )
    if _same_perception(facts, found):
        return {}
    raise UsageError(
        f'{out} was begun with perception {_shown(facts)}, but the graph has {_shown(found)}; '
        'start the original one, or choose another --out'
    )


def _same_perception(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two facts name the same network under any name, or both the ground truth."""
    if one['perception_sha256'] or other['perception_sha256']:
        return bool(one['perception_sha256'] == other['perception_sha256'])
    return bool(one['perception'] == other['perception'])


def _shown(facts: Mapping[str, Any]) -> str:
    sha256 = facts['perception_sha256']
    return f'{facts["perception"]} (sha256 {sha256[:12]}…)' if sha256 else facts['perception']


@dataclass(frozen=True, kw_only=True, slots=True)
class EarlierRuns:
    """The completed part of a search.

    Attributes:
        rows: results of completed runs by index.
        to_repeat: results by index of runs to repeat: they had an infrastructure error, were
            interrupted, or their scenes were chosen without the result of such a run.
        unknown_to_sampler: runs with an infrastructure error without whose results others, since
            judged, were chosen; they may have been repeated. The chosen scenes are kept, so the
            sampler never receives these results.
        begun: number of runs started or done, counted from run 0.
        facts: facts that are kept: number of runs planned at first, arms of the experiment,
            perception if determined by the graph, and the runs unknown to the sampler.
    """

    rows: Mapping[int, RunRow] = field(default_factory=dict)
    to_repeat: Mapping[int, RunRow] = field(default_factory=dict)
    unknown_to_sampler: frozenset[int] = frozenset()
    begun: int = 0
    facts: Mapping[str, Any] = field(default_factory=dict)


def earlier_runs(
    out: Path, content: CampaignContent, facts: Mapping[str, Any]
) -> EarlierRuns:
    """The completed runs of a search to resume.

    Args:
        out: folder of the campaign.
        content: content of its record.
        facts: facts of the search to resume.

    Raises:
        UsageError: another search was started there, or more runs were started than are requested
            now.
    """
    of_graph: Sequence[str] = () if facts['perception'] else PERCEPTION_KEYS
    check_same_campaign(out, content, facts, of_graph)
    lag = int(facts.get('sampler_lag', LAG))
    results = [_Result(*values) for values in content.values('index', 'outcome', 'retries')]
    unknown = _unknown_to_sampler(content.facts, results, lag)
    not_done = _not_done(results, unknown, lag)
    positions = {result.index: at for at, result in enumerate(results)}
    begun = 1 + max((*content.unfinished, *positions), default=-1)
    if begun > facts['runs']:
        raise UsageError(
            f'--runs {facts["runs"]}: {begun} were started in {out}; use at least that number'
        )
    kept = _kept_facts(content.facts, of_graph)
    rules = [*recorded_rules(content.facts), *recorded_rules(facts)]
    if rules:
        kept[UNTIL] = list(dict.fromkeys(rules))
    return EarlierRuns(
        rows=RowsByIndex(content.rows, {
            index: at for index, at in positions.items() if index not in not_done
        }),
        to_repeat={index: content.rows[positions[index]] for index in not_done},
        unknown_to_sampler=unknown, begun=begun,
        facts={**kept, UNKNOWN_TO_SAMPLER: sorted(unknown)} if unknown else kept,
    )


@dataclass(frozen=True, slots=True)
class _Result:
    """What must be known of each run to see which ones are repeated."""

    index: int
    outcome: Outcome
    retries: int


def _unknown_to_sampler(
    before: Mapping[str, Any], rows: Sequence[_Result], lag: int
) -> frozenset[int]:
    """See :class:`EarlierRuns`. A run is chosen with the results up to ``lag`` runs before it."""
    known = before.get(UNKNOWN_TO_SAMPLER, [])
    last = max((row.index for row in rows if row.outcome.judged), default=-1)
    broken = (row.index for row in rows if row.outcome is Outcome.INFRA_ERROR)
    return frozenset([*known, *(index for index in broken if index + lag <= last)])


def _not_done(rows: Sequence[_Result], unknown: frozenset[int], lag: int) -> frozenset[int]:
    """The indices of runs that must be repeated.

    This includes rejected scenes, which may have been chosen without a result that is now
    available. They need no run, and have the same result if nothing has changed.
    """
    broken = (
        row.index for row in rows
        if row.index not in unknown and (row.retries or row.outcome is Outcome.INFRA_ERROR)
    )
    sure = lag + min(broken, default=len(rows))
    return frozenset(
        row.index for row in rows if row.outcome in (Outcome.INFRA_ERROR, Outcome.INTERRUPTED)
        or (row.outcome is Outcome.REJECTED and row.index >= sure)
    )


def _kept_facts(before: Mapping[str, Any], of_graph: Sequence[str]) -> dict[str, Any]:
    kept = {key: before[key] for key in (*of_graph, ARM, ARMS) if key in before}
    return {**kept, 'first_runs': before['first_runs']} if 'first_runs' in before else kept
