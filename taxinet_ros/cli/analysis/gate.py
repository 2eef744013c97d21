"""``taxinet gate``: check a campaign against acceptance thresholds in continuous integration."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.gate import (
    Criterion,
    GateOptions,
    GateResult,
    Look,
    Verdict,
    gate_result,
    junit_xml,
    rerun_documents,
)
from taxinet_ros.bag.check.findings import ranges
from taxinet_ros.campaign.past_runs.recorded_campaign import open_campaign
from taxinet_ros.campaign.record.facts import recorded_rules, recorded_stacks
from taxinet_ros.campaign.record.ledger import LedgerContent
from taxinet_ros.campaign.record.shard import recorded_shard
from taxinet_ros.campaign.record.table import check_tables
from taxinet_ros.core.pacing.timing import is_free
from taxinet_ros.core.provenance import differences
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.atomic import write_atomically

INCONCLUSIVE_WORDS = {
    'pass': ExitCode.OK, 'fail': ExitCode.VIOLATED, 'report': ExitCode.INCOMPLETE,
}
"""Exit code of each ``--inconclusive`` word."""


def run_gate(
    folder: Path, options: GateOptions, *, inconclusive: str, junit: Path | None, as_json: bool
) -> int:
    """Print the verdict and optionally write it as JUnit XML.

    Returns:
        Exit code: 0 PASS, 1 FAIL, 3 INCONCLUSIVE unless ``inconclusive`` says otherwise.

    Raises:
        UsageError: not a campaign, or not usable for this check.
    """
    if inconclusive not in INCONCLUSIVE_WORDS:
        known = ', '.join(INCONCLUSIVE_WORDS)
        raise UsageError(f'--inconclusive {inconclusive}: unknown; known: {known}')
    campaign = open_campaign(folder)
    check_tables(folder)
    answer = gate_result(
        campaign.rows, options, planned=campaign.planned_runs or 0,
        rules=recorded_rules(campaign.facts),
    )
    answer = replace(answer, notes=(*answer.notes, *_record_notes(campaign.content)))
    if junit is not None:
        document = junit_xml(
            campaign.rows, answer, folder, campaign.facts,
            inconclusive_passes=inconclusive == 'pass', documents=junit.parent,
        )
        if not junit.parent.is_dir():
            raise UsageError(f'--junit {junit}: no such folder: {junit.parent}')
        for name, text in rerun_documents(campaign.rows, campaign.facts).items():
            write_atomically(junit.parent / name, text)
        write_atomically(junit, document)
    print(json.dumps(_json(answer, options), indent=2) if as_json else _words(answer, folder))
    codes = {Verdict.PASS: ExitCode.OK, Verdict.FAIL: ExitCode.VIOLATED}
    return codes.get(answer.verdict, INCONCLUSIVE_WORDS[inconclusive])


def _record_notes(content: LedgerContent) -> Iterator[str]:
    """Notes about the campaign's record."""
    if (shard := recorded_shard(content.campaign)) is not None:
        yield f'this is shard {shard} of a search, by itself; taxinet merge joins all of them'
    if found := differences(*recorded_stacks(content.campaign).values()):
        yield f'the runs were made on different machines or versions: {found}'
    if content.finished and content.unfinished:
        yield f'run {ranges(content.unfinished)}: started but has no result'
    if content.never_begun:
        yield f'run {ranges(content.never_begun)}: has a result but no record of its start'
    for timing in sorted({row.timing for row in content.rows if row.timing}):
        again = ', so their verdicts are not reproducible' if is_free(timing) else ''
        yield f'timing of the runs: {timing}{again}'
    yield from content.lost


def _words(answer: GateResult, folder: Path) -> str:
    counts = ', '.join(f'{n} {outcome}' for outcome, n in answer.counts.items() if n)
    lines = [f'{answer.verdict}: {folder} ({counts or "no run"})']
    lines += [f'  {one.verdict:<12} {one.name}: {one.sentence}' for one in answer.criteria]
    lines += [f'  note: {note}' for note in answer.notes]
    return '\n'.join(lines)


def _json(answer: GateResult, options: GateOptions) -> dict[str, Any]:
    return {
        'verdict': answer.verdict.value,
        'confidence': options.confidence,
        'look': options.look.value,
        'bounds': _BOUNDS[options.look],
        'judged': answer.judged,
        'effective': answer.effective,
        'outcomes': {outcome.value: answer.counts[outcome] for outcome in Outcome},
        'criteria': [
            {
                'name': one.name, 'verdict': one.verdict.value, 'sentence': one.sentence,
                **({} if one.bounds is None else {
                    'share': None if math.isnan(one.bounds.share) else one.bounds.share,
                    'low': one.bounds.low, 'high': one.bounds.high,
                    'more_runs': one.more_runs,
                }),
                **_sequential_json(one),
            }
            for one in answer.criteria
        ],
        'notes': list(answer.notes),
    }


_BOUNDS = {
    Look.ANY: 'one-sided; each holds at this confidence, however often the campaign is checked',
    Look.PLANNED: 'one-sided; each holds at this confidence, for one look at the planned runs',
    Look.SEQUENTIAL: 'none: each decision holds at this confidence, whenever the campaign stops',
}


def _sequential_json(one: Criterion) -> dict[str, Any]:
    if one.course is None or one.test is None:
        return {}
    found, test = one.course, one.test
    return {'sequential': {
        'test': str(test), 'decision': found.decision and found.decision.value,
        'decided_by_run': found.index, 'runs': found.runs, 'bad': found.bad,
        'later_runs': found.later, 'log_evidence_needed': test.enough,
        'log_evidence_pass': _finite(test.log_pass(found.bad, found.runs - found.bad)),
        'log_evidence_fail': _finite(test.log_fail(found.bad, found.runs - found.bad)),
    }}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
