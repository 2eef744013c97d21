"""Whether a campaign to resume is the requested one, and which of a search's runs are repeated.

If the graph determines perception and timing, they are known only after its first result.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE, is_free, timing_words
from taxinet_ros.core.verdict.outcome import OPEN, Outcome, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, plain
from taxinet_ros.scenes.programs import check_same_files
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import (
    ARM,
    ARMS,
    AUDIT_PERCENT,
    ENGINE,
    EXTENSIONS,
    OBJECTIVE,
    ODD,
    STACKS,
    UNTIL,
    package_words,
    recorded_rules,
    same_fact,
)
from taxinet_ros.trials.record.row import RunRow

UNKNOWN_TO_SAMPLER = 'untold'
"""The fact that lists the runs whose results a search's sampler never receives."""
_MAY_DIFFER = frozenset({
    'runs', 'first_runs', 'processes', 'program_text', 'warnings', STACKS, UNKNOWN_TO_SAMPLER, ARM,
    ARMS, ENGINE, AUDIT_PERCENT, UNTIL,
})
"""Facts that may differ on a resume: more runs may be requested; the digest covers the text;
warnings differ between versions; another machine or version only causes a warning; both engines
give the same rows and bags; a stop rule chooses no scene."""
_WRITTEN_BY = {'sampler': 'taxinet falsify', 'shrinks': 'taxinet shrink'}
"""The command that writes campaigns with a certain fact."""
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
            f'{timing_words(result.timing)}; start the original one, or choose another folder'
        )
    # The same network under any name, or both the ground truth.
    name = 'perception_sha256' if facts['perception_sha256'] or result.fingerprint else 'perception'
    if facts[name] == found[name]:
        return {}
    raise UsageError(
        f'{out} was begun with perception {_shown(facts)}, but the graph has {_shown(found)}; '
        'start the original one, or choose another folder'
    )


def _shown(facts: Mapping[str, Any]) -> str:
    sha256 = facts['perception_sha256']
    return f'{facts["perception"]} (sha256 {sha256[:12]}…)' if sha256 else facts['perception']


def kept_facts(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, Any]:
    """Facts of a campaign to resume that stay: of its graph, of its experiment, its first plan.

    Args:
        before: recorded facts.
        now: facts of the requested campaign, whose stop rule is added.
    """
    kept = {
        key: before[key] for key in (*undecided_facts(now), ARM, ARMS, 'first_runs')
        if key in before
    }
    rules = [*recorded_rules(before), *recorded_rules(now)]
    return {**kept, UNTIL: list(dict.fromkeys(rules))} if rules else kept


def undecided_facts(facts: Mapping[str, Any]) -> Sequence[str]:
    """Names of the facts that are not known before the graph has answered."""
    return () if facts['perception'] else PERCEPTION_KEYS


def unfinished_search(
    content: CampaignContent, lag: int
) -> tuple[frozenset[int], Mapping[int, RunRow]]:
    """What of a search its sampler never receives, and what must be run again.

    Args:
        content: content of the record.
        lag: a run is chosen with the results up to so many runs before it.

    Returns:
        Runs with an infrastructure error without whose results others, since judged, were chosen:
            they may have been repeated; the chosen scenes are kept, so the sampler never receives
            these results. And the rows, by index, of the runs to repeat: they had an infrastructure
            error or were interrupted. This includes rejected scenes, which may have been chosen
            without a result that is now available; they need no run, and have the same result if
            nothing has changed.
    """
    results = list(content.values('index', 'outcome', 'retries'))
    last = max((index for index, outcome, _ in results if outcome.judged), default=-1)
    unknown = frozenset([
        *content.facts.get(UNKNOWN_TO_SAMPLER, []),
        *(index for index, outcome, _ in results
          if outcome is Outcome.INFRA_ERROR and index + lag <= last),
    ])
    broken = (
        index for index, outcome, retries in results
        if index not in unknown and (retries or outcome is Outcome.INFRA_ERROR)
    )
    sure = lag + min(broken, default=len(results))
    return unknown, content.only({
        index for index, outcome, _ in results
        if outcome in OPEN
        or (outcome is Outcome.REJECTED and index >= sure)
    })


def check_same_campaign(
    out: Path, content: CampaignContent, facts: Mapping[str, Any], undecided: Collection[str] = ()
) -> None:
    """Check that a campaign to resume is the requested one.

    Args:
        out: folder of the campaign.
        content: content of its record.
        facts: facts of the requested campaign.
        undecided: names of facts that are not yet known.

    Raises:
        UsageError: another campaign was started there.
    """
    if content.rows and not content.facts:
        raise UsageError(
            f'resume: {out / RECORD_NAME}: has runs, but not what the campaign is; begin it '
            'anew, in another folder'
        )
    if content.facts:
        _check_same(out, content.facts, {
            name: value for name, value in facts.items() if name not in undecided
        })


def _check_same(out: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    now = plain(now)
    for name, command in _WRITTEN_BY.items():
        if name in now and name not in before:
            raise UsageError(f'resume: {out / RECORD_NAME}: not written by {command}')
    _check_same_packages(out, before.get(EXTENSIONS, {}), now.get(EXTENSIONS, {}))
    check_same_files(f'resume: {out}', before, now)
    for name in dict.fromkeys((*now, ODD, OBJECTIVE)):
        if name not in _MAY_DIFFER and not same_fact(name, before.get(name), now.get(name)):
            raise UsageError(
                f'resume: {out} was begun with {name} {short_json(before.get(name))}, not '
                f'{short_json(now.get(name))}; repeat its options, or choose another folder'
            )


def _check_same_packages(
    out: Path, before: Mapping[str, Mapping[str, str]], now: Mapping[str, Mapping[str, str]]
) -> None:
    for kind in before.keys() & now.keys():
        one, other = before[kind], now[kind]
        if one != other and one['name'] == other['name']:
            raise UsageError(
                f'resume: {out} was begun with {package_words(kind, one)}, which is now of '
                f'{other["distribution"]} {other["version"]} (sha256 {other["sha256"][:12]}…); put '
                'the package back as it was, or name another folder'
            )


def short_json(value: Any) -> str:
    """A fact for a message, as JSON, truncated if long."""
    text = json.dumps(value)
    return text if len(text) <= 80 else text[:79] + '…'
