"""``taxinet gate``: check a campaign against acceptance thresholds in continuous integration."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from taxinet_ros.analysis.campaign.baseline import AgainstBaseline, Changed, against_baseline
from taxinet_ros.analysis.gate import (
    Criterion,
    GateOptions,
    GateResult,
    Kind,
    Look,
    Verdict,
    gate_result,
    junit_xml,
    rerun_documents,
)
from taxinet_ros.bag.check.findings import ranges
from taxinet_ros.cli.checked import check_output, tell_doubts
from taxinet_ros.cli.progress import trial_bar
from taxinet_ros.core.pacing.timing import is_free
from taxinet_ros.core.perception.perception import check_perception, network_doubts
from taxinet_ros.core.provenance import differences
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.sealed_table import write_table
from taxinet_ros.trials.options import DEFAULT_ROOT
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
from taxinet_ros.trials.past_runs.shared_scenes import SharedTrials, scenes_of
from taxinet_ros.trials.rates import Planned
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import (
    STACKS,
    is_campaign,
    recorded_rules,
    recorded_stacks,
)
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import PARQUET_NAME
from taxinet_ros.trials.record.table import table as table_of
from taxinet_ros.version import __version__

INCONCLUSIVE_WORDS = {
    'pass': ExitCode.OK, 'fail': ExitCode.VIOLATED, 'report': ExitCode.INCOMPLETE,
}
"""Exit code of each ``--inconclusive`` word."""
_MOST_SCENES = 10
"""Maximum number of scenes that got worse on the screen; JUnit and JSON have all."""


@dataclass(frozen=True, kw_only=True)
class GateInput:
    """What is judged and how it is told.

    Attributes:
        campaign: folder of a campaign, or with a baseline the word or file of a network.
        baseline: folder or table with the scenes to be paired with, or None.
        out: folder of a network's runs in the baseline's scenes; None: one below ``bags/``.
        workers: processes for these.
        inconclusive: one of :data:`INCONCLUSIVE_WORDS`.
        junit: file to write, or None.
        as_json: print JSON.
    """

    campaign: Path
    baseline: Path | None = None
    out: Path | None = None
    workers: int | None = None
    inconclusive: str = 'report'
    junit: Path | None = None
    as_json: bool = False


@dataclass(frozen=True, kw_only=True)
class _Judged:
    """Runs to be judged: a campaign's, or those of a network in a baseline's scenes."""

    folder: Path
    rows: tuple[RunRow, ...]
    facts: Mapping[str, Any]
    planned: Planned
    notes: tuple[str, ...]
    again: bool = False

    @property
    def name(self) -> str:
        """What commands call these runs: folder, or table."""
        return str(self.folder / PARQUET_NAME if self.again else self.folder)

    def table(self) -> Any:
        """The runs' table, with its provenance."""
        frame = table_of(self.rows, tuple(self.facts.get('specs', {})))
        frame.attrs[STACKS] = recorded_stacks(self.facts)
        return frame


def run_gate(asked: GateInput, options: GateOptions) -> int:
    """Print the verdict and optionally write it as JUnit XML.

    Returns:
        Exit code: 0 PASS, 1 FAIL, 3 INCONCLUSIVE unless ``inconclusive`` says otherwise; 130
        interrupted while the network was driven.

    Raises:
        UsageError: not a campaign, or not usable for this check.
    """
    if asked.inconclusive not in INCONCLUSIVE_WORDS:
        known = ', '.join(INCONCLUSIVE_WORDS)
        raise UsageError(f'--inconclusive {asked.inconclusive}: unknown; known: {known}')
    _check_junit(asked)
    judged = _judged(asked)
    if judged is None:
        return ExitCode.INTERRUPTED
    paired, criterion = None, None
    if asked.baseline is not None and options.margin is not None:
        paired = against_baseline(
            judged.table(), judged.folder, asked.baseline, again=judged.again)
        command = shlex.join(['taxinet', 'compare', str(asked.baseline), judged.name])
        criterion = paired.criterion(options.margin, options.confidence, command)
    answer = gate_result(
        judged.rows, options, planned=judged.planned or 0, compared=criterion,
        rules=recorded_rules(judged.facts), folder=judged.name,
    )
    more = paired.notes if paired else ()
    answer = replace(answer, notes=(*answer.notes, *judged.notes, *more))
    table = _left_table(judged, asked.junit)
    if asked.junit is not None:
        document = junit_xml(
            judged.rows, answer, judged.folder, judged.facts, table=table,
            inconclusive_passes=asked.inconclusive == 'pass', documents=asked.junit.parent,
        )
        _write_documents(judged, asked.junit)
        write_atomically(asked.junit, document)
    if asked.as_json:
        values = _json(answer, options)
        values['table'] = table and str(table)
        if paired is not None:
            values['baseline'] = _baseline_json(paired, options)
        print(json.dumps(values, indent=2, allow_nan=False))
    else:
        print(_words(answer, judged.folder, paired, table))
    codes = {Verdict.PASS: ExitCode.OK, Verdict.FAIL: ExitCode.VIOLATED}
    return codes.get(answer.verdict, INCONCLUSIVE_WORDS[asked.inconclusive])


def _check_junit(asked: GateInput) -> None:
    """Check that the table beside the JUnit file can be written, and that its folder exists."""
    if asked.junit is None:
        return
    if not asked.junit.parent.is_dir():
        raise UsageError(f'--junit {asked.junit}: no such folder: {asked.junit.parent}')
    inputs, beside = (asked.campaign, asked.baseline), _beside(asked.junit)
    check_output(
        f'--junit {asked.junit}: {beside}', beside, inputs=[one for one in inputs if one],
        own=beside.suffix,
    )


def _write_documents(judged: _Judged, junit: Path) -> None:
    """Write the documents of the commands in the JUnit file beside it."""
    texts = rerun_documents(judged.rows, judged.facts)
    for name in texts:
        check_output(f'--junit {junit}: {junit.parent / name}', junit.parent / name)
    for name, text in texts.items():
        write_atomically(junit.parent / name, text)


def _judged(asked: GateInput) -> _Judged | None:
    """The runs to judge; None if driving a network was interrupted."""
    recorded = asked.campaign.is_dir()
    if asked.baseline is not None and not recorded:
        return _driven(asked, str(asked.campaign), asked.baseline)
    for option, given in (('--out', asked.out), ('--workers', asked.workers)):
        if given is not None:
            raise UsageError(
                f'{option}: only where a network is driven through the scenes of a --baseline; '
                f'{asked.campaign} is not driven'
            )
    campaign = open_campaign(asked.campaign)
    return _Judged(
        folder=asked.campaign, rows=campaign.rows, facts=campaign.facts,
        planned=campaign.planned_runs, notes=tuple(_record_notes(campaign.content)),
    )


def _driven(asked: GateInput, network: str, baseline: Path) -> _Judged | None:
    """The network's runs in the baseline's scenes, finished ones kept in the folder."""
    fingerprint = check_perception(network)
    scenes = scenes_of(baseline)
    system = scenes.system
    out = asked.out or DEFAULT_ROOT / f'gate-{Path(network).stem.replace(":", "-")}'
    console = Console(highlight=False, stderr=True)
    tell_doubts(network_doubts(network, (scene.scenario for scene in scenes.scenes)))
    with (
        SharedTrials(scenes, out) as trials,
        trial_bar(console, 'runs', len(scenes.scenes)) as (count, interrupted),
    ):
        done = trials.drive(
            network, workers=asked.workers or 2, on_trial=count, interrupted=interrupted)
        if len(done) < len(scenes.scenes) and interrupted():
            console.print('interrupted; the same command goes on', soft_wrap=True)
            return None
        rows = tuple(trials.rows(network))
    rough = sum(not scene.exact for scene in scenes.scenes)
    notes = (
        f'{rough:,} of {len(scenes.scenes):,} scenes are known to nine decimals only, as the '
        'baseline has no bags; runs at the edge may come out otherwise for that alone',
    ) if rough else ()
    judged = _Judged(
        folder=out, rows=rows, notes=notes, again=True,
        planned=None if scenes.fixed else _planned(baseline, rows), facts={
            'taxinet_ros_version': __version__, 'baseline': str(baseline),
            'program': rows[0].program, 'seed': rows[0].seed, 'perception': network,
            'perception_sha256': fingerprint, 'controller': system.controller,
            'gains': dict(system.gains), 'timing': system.timing.words, 'world': system.world,
            **scenes.judging.facts(),
        },
    )
    write_table(out / PARQUET_NAME, judged.table())
    return judged


def _planned(baseline: Path, rows: Sequence[RunRow]) -> range:
    """The runs that the baseline planned, which are other ones than its runs."""
    if is_campaign(baseline) and (found := open_campaign(baseline).planned_runs):
        return found
    return range(max(row.index for row in rows) + 2)  # more than there are: the number was open


def _left_table(judged: _Judged, junit: Path | None) -> Path | None:
    """The table that ``taxinet analyze`` takes: the runs' own, or one beside the JUnit file.

    The folder of a campaign is only read, since the campaign may be running.
    """
    own = judged.folder / PARQUET_NAME
    if junit is None or judged.again:
        return own if own.is_file() else None
    beside = _beside(junit)
    write_table(beside, judged.table())
    return beside


def _beside(junit: Path) -> Path:
    return junit.with_name(f'{junit.stem}-{PARQUET_NAME}')


def _record_notes(content: CampaignContent) -> Iterator[str]:
    """Notes about the campaign's record."""
    if found := differences(*recorded_stacks(content.facts).values()):
        yield f'the runs were made on different machines or versions: {found}'
    if content.finished and content.unfinished:
        yield f'run {ranges(content.unfinished)}: started but has no result'
    for timing in sorted({row.timing for row in content.rows if row.timing}):
        again = ', so their verdicts are not reproducible' if is_free(timing) else ''
        yield f'timing of the runs: {timing}{again}'


def _words(
    answer: GateResult, folder: Path, paired: AgainstBaseline | None, table: Path | None
) -> str:
    counts = ', '.join(f'{n} {outcome}' for outcome, n in answer.counts.items() if n)
    lines = [f'{answer.verdict}: {folder} ({counts or "no run"})']
    lines += [f'  {one.verdict:<12} {one.name}: {one.sentence}' for one in answer.criteria]
    if paired is not None:
        lines += [f'  worse: {_changed_words(one)}' for one in paired.worse[:_MOST_SCENES]]
        if len(paired.worse) > _MOST_SCENES:
            lines.append(f'  and {len(paired.worse) - _MOST_SCENES:,} more that got worse')
    lines += [f'  note: {note}' for note in answer.notes]
    if table is not None:
        lines.append(f'  table: {table}')
    lines += [f'  next: {command}' for command in dict.fromkeys(
        one.next for one in answer.criteria if one.verdict is not Verdict.PASS and one.next)]
    return '\n'.join(lines)


def _changed_words(one: Changed) -> str:
    was = '' if one.baseline_run_id == one.run_id else f' ({one.baseline_run_id})'
    return f'{one.run_id}: rho {one.rho:+.3f}, baseline {one.baseline_rho:+.3f}{was}'


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
                    'loss' if one.kind is Kind.BASELINE else 'share':
                        None if math.isnan(one.bounds.share) else one.bounds.share,
                    'low': one.bounds.low, 'high': one.bounds.high,
                    'more_runs': one.more_runs,
                }),
                **_sequential_json(one),
                **({'next': one.next} if one.next and one.verdict is not Verdict.PASS else {}),
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


def _baseline_json(paired: AgainstBaseline, options: GateOptions) -> dict[str, Any]:
    found, rates = paired.loss(options.confidence), paired.found.satisfied
    return {
        'margin': options.margin, 'tested': paired.found.tested, 'scenes': rates.pairs,
        'unknown': paired.unknown, 'satisfied': rates.second, 'satisfied_before': rates.first,
        'loss': found.share,
        'mcnemar_p_one_sided': found.p_value if paired.found.tested else None,
        **{name: [
            {key: _number(value) for key, value in one._asdict().items()} for one in some
        ] for name, some in (('worse', paired.worse), ('better', paired.better))},
    }


def _number(value: Any) -> Any:
    return _finite(value) if isinstance(value, float) else value


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
