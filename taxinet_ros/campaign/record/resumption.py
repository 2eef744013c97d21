"""What an interrupted search left behind, and whether it is the same search.

Where the graph decides on perception and timing, that is known from its first answer on only.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.campaign.record.facts import (
    ARMS,
    FACTS_NAME,
    LEDGER_NAME,
    STACKS,
    recorded_stacks,
    stack_difference,
)
from taxinet_ros.campaign.record.ledger import read_ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.samplers.sampler import LAG
from taxinet_ros.core.controller import STEERING
from taxinet_ros.core.outcome import Outcome, RunResult, StopOn
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE, is_free, timing_words
from taxinet_ros.errors import UsageError

PERCEPTION_KEYS = ('perception', 'perception_sha256', 'timing')
"""The facts that say it; all are empty until the graph has answered."""


def facts_of_graph(out: Path, facts: Mapping[str, Any], result: RunResult) -> dict[str, str]:
    """What an answer adds to the facts: who perceived, if that was not known before.

    Args:
        out: the campaign's folder.
        facts: of the campaign.
        result: the answer. Where the run broke before a perception was ready it says nothing.

    Raises:
        UsageError: another perception answered than the campaign was begun with, or its answers
            take effect at another time.
    """
    found = dict(
        zip(PERCEPTION_KEYS, (result.perception, result.fingerprint, result.timing), strict=True)
    )
    if is_free(result.timing):
        raise UsageError(
            f'the graph lets runs go free, and a search goes by verdicts that come again: '
            f'{NOT_REPRODUCIBLE}; start the simulator with lockstep:=true, or leave the sampler out'
        )
    if not result.perception:
        return {}
    if not facts['perception']:
        return found
    if facts['timing'] != result.timing:
        raise UsageError(
            f'{out} was begun with {timing_words(facts["timing"])}, but the graph has '
            f'{timing_words(result.timing)}; start the one it was begun with, or name another --out'
        )
    if _same_perception(facts, found):
        return {}
    raise UsageError(
        f'{out} was begun with perception {_shown(facts)}, but the graph has {_shown(found)}; '
        'start the one it was begun with, or name another --out'
    )


def _same_perception(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two are the same network whatever it is called, or both the truth."""
    if one['perception_sha256'] or other['perception_sha256']:
        return bool(one['perception_sha256'] == other['perception_sha256'])
    return bool(one['perception'] == other['perception'])


def _shown(facts: Mapping[str, Any]) -> str:
    sha256 = facts['perception_sha256']
    return f'{facts["perception"]} (sha256 {sha256[:12]}…)' if sha256 else facts['perception']


UNTOLD = 'untold'
"""The fact that names the runs of :attr:`Earlier.untold`."""
_MAY_DIFFER = frozenset(
    {'runs', 'first_runs', 'processes', 'program_text', 'warnings', STACKS, UNTOLD, ARMS}
)
"""Facts that may differ: more runs may be asked for; the text has its digest beside it; a version
may warn of more than another, and another machine or version is warned of."""
_DEFAULTS_OF_BEFORE: Mapping[str, Any] = {
    'stop_on': StopOn.NEVER.value, 'bounds': [], 'rates': [], 'laid_over': {},
    'controller': STEERING, 'controller_sha256': '', 'timing': '',
}
"""What a fact was before there was a choice, and so was not written down."""


@dataclass(frozen=True, kw_only=True, slots=True)
class EarlierRuns:
    """The part of a search that is done.

    Attributes:
        rows: results by index of the runs that are done.
        again: results by index of those that are done again: the bench broke them, they were
            interrupted, or their scenes were chosen without the result of a run that broke.
        untold: runs that the bench had broken when others, since judged, were chosen without their
            results; they may have been run again meanwhile. What was chosen stays, so the sampler
            is never told of them.
        begun: number of runs that were begun or done, counted from run 0.
        attempts: how often each run was begun, by index.
        facts: those that stay: how many runs were planned at first, the arms of its experiment,
            and on the perception, where the graph decided it.
        stacks: records of the machines and versions of earlier sittings, by name.
        warning: one line where one of them is another than this, or ''.
    """

    rows: Mapping[int, RunRow] = field(default_factory=dict)
    again: Mapping[int, RunRow] = field(default_factory=dict)
    untold: frozenset[int] = frozenset()
    begun: int = 0
    attempts: Mapping[int, int] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    stacks: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    warning: str = ''


def read_earlier_runs(out: Path, facts: Mapping[str, Any]) -> EarlierRuns:
    """Read what was done, which :class:`.ledger.Ledger` has locked and mended.

    Args:
        out: the campaign's folder.
        facts: of the search that is to go on.

    Raises:
        UsageError: another search was begun there, the ledger is damaged, or more runs were begun
            than are asked for now.
    """
    content = read_ledger(out / LEDGER_NAME)
    if content.rows and not content.campaign:
        raise UsageError(
            f'--resume: {out / LEDGER_NAME}: has runs, and does not say of which campaign; see '
            f'taxinet doctor {out}, then mend it: taxinet doctor --mend {out}'
        )
    of_graph: Sequence[str] = () if facts['perception'] else PERCEPTION_KEYS
    if content.campaign:
        _check_same(out, content.campaign, {k: v for k, v in facts.items() if k not in of_graph})
    untold = _untold(content.campaign, content.rows)
    again = {row.index: row for row in _not_done(content.rows, untold)}
    rows = {row.index: row for row in content.rows if row.index not in again}
    begun = 1 + max((*content.unfinished, *(row.index for row in content.rows)), default=-1)
    if begun > facts['runs']:
        raise UsageError(f'--runs {facts["runs"]}: {begun} were begun in {out}; ask for as many')
    return EarlierRuns(
        rows=rows, again=again, untold=untold, begun=begun,
        attempts=content.attempts,
        facts=_kept_facts(content.campaign, of_graph),
        stacks=recorded_stacks(content.campaign),
        warning=stack_difference(content.campaign, str(out)) if content.rows else '',
    )


def _untold(before: Mapping[str, Any], rows: Sequence[RunRow]) -> frozenset[int]:
    """See :class:`EarlierRuns`. A run is chosen with the results of those ``LAG`` before it."""
    known = before.get(UNTOLD, [])
    if not isinstance(known, list) or not all(type(index) is int for index in known):
        raise UsageError(f"the ledger's {UNTOLD} is {_short(known)}; it has to be a list of runs")
    last = max((row.index for row in rows if row.outcome.judged), default=-1)
    broken = (row.index for row in rows if row.outcome is Outcome.INFRA_ERROR)
    return frozenset([*known, *(index for index in broken if index + LAG <= last)])


def _not_done(rows: Sequence[RunRow], untold: frozenset[int]) -> list[RunRow]:
    """The rows of runs that have to be done again.

    Among them are scenes that could not be drawn, and may have been chosen without a result that
    there is by now. They cost no run, and come to the same where nothing has changed.
    """
    broken = (
        row.index for row in rows
        if row.index not in untold and (row.retries or row.outcome is Outcome.INFRA_ERROR)
    )
    sure = LAG + min(broken, default=len(rows))
    return [
        row for row in rows if row.outcome in (Outcome.INFRA_ERROR, Outcome.INTERRUPTED)
        or (row.outcome is Outcome.REJECTED and row.index >= sure)
    ]


def _kept_facts(before: Mapping[str, Any], of_graph: Sequence[str]) -> dict[str, Any]:
    kept = {key: before[key] for key in (*of_graph, ARMS) if key in before}
    # A search from before that was written down has its last plan on record only.
    planned = before.get('first_runs', before.get('runs'))
    return kept if planned is None else {**kept, 'first_runs': planned}


def _check_same(out: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    now = json.loads(json.dumps(now))
    before = {**_DEFAULTS_OF_BEFORE, **before}
    if 'sampler' not in before:
        raise UsageError(f'--resume: {out / FACTS_NAME}: not written by taxinet falsify')
    for name in now:
        if name not in _MAY_DIFFER and before.get(name) != now[name]:
            raise UsageError(
                f'--resume: {out} was begun with {name} {_short(before.get(name))}, not '
                f'{_short(now[name])}; repeat its options, or name another --out'
            )


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else text[:79] + '…'
