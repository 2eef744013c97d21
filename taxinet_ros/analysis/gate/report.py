"""A gate's answer as lines of the terminal, as JSON, and as JUnit XML.

The JUnit format is that of Ant's reports as read by Jenkins, GitLab and others: a ``testsuite``
with ``properties`` and ``testcase`` elements; a test case with a ``failure`` or ``skipped`` child
has not passed. A criterion is a test case: a run that violates its requirement is no failure of the
gate as long as the share of such runs is small enough.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from taxinet_ros.analysis.gate.criteria import Criterion, GateOptions, GateResult, Kind, Verdict
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.core.pacing.timing import parse_timing
from taxinet_ros.core.provenance import words
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.plain_values import plain
from taxinet_ros.trials.record.facts import recorded_stacks
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.run_command import RunSettings

_BOUNDS = {
    'any': 'one-sided; each holds at this confidence, however often the campaign is checked',
    'planned': 'one-sided; each holds at this confidence, for one look at the planned runs',
    'sequential': 'none: each decision holds at this confidence, whenever the campaign stops',
}
"""What the bounds are, by the value of a :class:`.Look`."""


def gate_text(answer: GateResult, folder: Path, table: Path | None) -> str:
    """What the command prints.

    Args:
        answer: result of the gate.
        folder: of the runs.
        table: the runs' table, or None.
    """
    return macro_text(
        Path(__file__).with_name('gate.j2'), 'gate', answer=answer, folder=folder, table=table,
    )


def gate_json(answer: GateResult, options: GateOptions, table: Path | None) -> dict[str, Any]:
    """The same as plain values, with the figures and all scenes that changed."""
    values = {
        'verdict': answer.verdict, 'confidence': options.confidence, 'look': options.look,
        'bounds': _BOUNDS[options.look.value], 'judged': answer.judged,
        'effective': answer.effective, 'outcomes': answer.counts,
        'criteria': [_criterion_values(one) for one in answer.criteria],
        'notes': answer.notes, 'table': table,
    }
    if (paired := answer.baseline) is not None:
        found, rates = paired.loss(options.confidence), paired.found.satisfied
        tested = paired.found.tested
        values['baseline'] = {
            'margin': options.margin, 'tested': tested, 'scenes': rates.pairs,
            'unknown': paired.unknown, 'satisfied': rates.second, 'satisfied_before': rates.first,
            'loss': found.share, 'mcnemar_p_one_sided': found.p_value if tested else None,
            'worse': paired.worse, 'better': paired.better,
        }
    return plain(values)


def _criterion_values(one: Criterion) -> dict[str, Any]:
    values: dict[str, Any] = {
        'name': one.name, 'verdict': one.verdict, 'sentence': one.sentence,
    }
    if one.bounds is not None:
        values |= {
            'loss' if one.kind is Kind.BASELINE else 'share': one.bounds.share,
            'low': one.bounds.low, 'high': one.bounds.high, 'more_runs': one.more_runs,
        }
    if one.course is not None and one.test is not None:
        found, test = one.course, one.test
        values['sequential'] = {
            'test': str(test), 'decision': found.decision, 'decided_by_run': found.index,
            'runs': found.runs, 'bad': found.bad, 'later_runs': found.later,
            'log_evidence_needed': test.enough,
            'log_evidence_pass': test.log_pass(found.bad, found.runs - found.bad),
            'log_evidence_fail': test.log_fail(found.bad, found.runs - found.bad),
        }
    if one.next and one.verdict is not Verdict.PASS:
        values['next'] = one.next
    return values


# Char of XML 1.0 (fifth edition, production 2), negated.
_ILLEGAL = re.compile('[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]')
_GATE = 'gate'
_MOST_TOLD = 10
"""Maximum number of runs in the text of a failure; its properties have all."""


def junit_xml(
    rows: Sequence[RunRow], answer: GateResult, folder: Path, facts: Mapping[str, Any], *,
    inconclusive_passes: bool, documents: Path = Path(), table: Path | None = None,
) -> bytes:
    """The report as a UTF-8 document: a test case for each criterion, the runs as properties.

    The suite has a property for every run, a criterion's case one for every run that speaks against
    it, with the command that runs it again. A case that has not passed says the figures, these runs
    and the next command.

    Args:
        rows: the campaign's runs.
        answer: result of the gate.
        folder: the campaign's folder, for commands.
        facts: facts of the campaign.
        inconclusive_passes: an undecided criterion is skipped, not a failure.
        documents: folder of the files of :func:`rerun_documents`.
        table: the runs' table, which ``taxinet analyze`` takes; or None.
    """
    suite = ElementTree.Element('testsuite', {'name': _text(folder.resolve().name)})
    _add_properties(suite, answer, rows, {
        **facts, **({} if table is None else {'table': table}),
    })
    for criterion in answer.criteria:
        against = {
            row.run_id: (_result_words(row), _again(row, folder, facts, documents))
            for row in sorted(rows, key=_headline_rho) if speaks_against(row, criterion)
        }
        _add_criterion(suite, criterion, against, passes=inconclusive_passes)
    totals = {
        'tests': len(suite.findall('testcase')), 'failures': len(suite.findall('*/failure')),
        'errors': 0, 'skipped': len(suite.findall('*/skipped')),
    }
    times = {'time': f'{sum(row.wall_s for row in rows):.3f}'}
    suite.attrib.update({name: str(number) for name, number in totals.items()} | times)
    root = ElementTree.Element('testsuites', {**suite.attrib, 'name': 'taxinet'})
    root.append(suite)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='UTF-8', xml_declaration=True) + b'\n'


def speaks_against(row: RunRow, criterion: Criterion) -> bool:
    """Whether a run is one of those that a criterion limits the number of."""
    if criterion.kind is Kind.BASELINE:
        return row.run_id in criterion.against
    if criterion.kind is Kind.OFF_RUNWAY:
        return bool(row.left_runway)
    if criterion.kind is Kind.BROKEN:
        return row.outcome is Outcome.INFRA_ERROR
    return row.outcome is Outcome.FAIL


def rerun_command(
    row: RunRow, folder: Path, facts: Mapping[str, Any], documents: Path = Path()
) -> str:
    """Command to rerun a run, bit-exact if its bag exists; '' if its graph is not known.

    Args:
        row: row of the run.
        folder: folder of its campaign.
        facts: facts of its campaign.
        documents: folder of the files of :func:`rerun_documents`.
    """
    if row.bag:
        return shlex.join(['taxinet', 'run', '--from', str(folder / row.bag)])
    return _settings(row, facts).command('nominal', folder=documents) if row.perception else ''


def rerun_documents(rows: Sequence[RunRow], facts: Mapping[str, Any]) -> dict[str, str]:
    """Text by file name of the documents that the commands of :func:`junit_xml` read."""
    return {
        name: text for row in rows if row.outcome is Outcome.FAIL and row.perception and not row.bag
        for name, text in _settings(row, facts).documents().items()
    }


def _settings(row: RunRow, facts: Mapping[str, Any]) -> RunSettings:
    return replace(
        RunSettings.from_facts(facts), perception=row.perception, values=row.scene,
        timing=parse_timing(row.timing).of_run(row.seed, row.index),
    )


def _add_properties(
    suite: ElementTree.Element, answer: GateResult, rows: Sequence[RunRow],
    facts: Mapping[str, Any],
) -> None:
    names = (
        'taxinet_ros_version', 'program', 'program_sha256', 'seed', 'sampler', 'perception',
        'perception_sha256', 'controller', 'controller_sha256', 'timing', 'baseline', 'table',
    )
    values = {name: facts[name] for name in names if name in facts} | {
        **{f'stack_{name}': words(one) for name, one in recorded_stacks(facts).items()},
        'gate': answer.verdict.value, 'judged': answer.judged,
        **{outcome.value: count for outcome, count in answer.counts.items()},
        **{f'note_{number}': note for number, note in enumerate(answer.notes, 1)},
        **{f'run {row.run_id}': f'{row.outcome}: {_result_words(row)}'.removesuffix(': ')
           for row in rows},
    }
    _add_values(suite, values)


def _add_values(parent: ElementTree.Element, values: Mapping[str, Any]) -> None:
    properties = ElementTree.SubElement(parent, 'properties')
    for name, value in values.items():
        attributes = {'name': _text(name), 'value': _text(value)}
        ElementTree.SubElement(properties, 'property', attributes)


def _add_criterion(
    suite: ElementTree.Element, criterion: Criterion, against: Mapping[str, tuple[str, str]], *,
    passes: bool,
) -> None:
    """Add a test case; ``against`` has result and command by run, the worst first."""
    attributes = {'classname': _GATE, 'name': _text(criterion.name), 'time': '0'}
    case = ElementTree.SubElement(suite, 'testcase', attributes)
    if against:
        _add_values(case, {
            f'run {run_id}': '; '.join(filter(None, told)) for run_id, told in against.items()
        })
    if criterion.verdict is Verdict.PASS:
        ElementTree.SubElement(case, 'system-out').text = _text(criterion.sentence)
        return
    skipped = passes and criterion.verdict is Verdict.INCONCLUSIVE
    message = f'{criterion.verdict}: {criterion.sentence}'
    kind = {} if skipped else {'type': criterion.verdict.value}
    found = ElementTree.SubElement(
        case, 'skipped' if skipped else 'failure', {'message': _text(message), **kind})
    lines = [message, *(f'{run_id}: {told}' for run_id, (told, _) in against.items())]
    if len(against) > _MOST_TOLD:
        lines[_MOST_TOLD + 1:] = [f'and {len(against) - _MOST_TOLD} more, in the properties']
    lines += [again for _, again in against.values() if again][:1]
    if criterion.next:
        lines.append(f'next: {criterion.next}')
    found.text = _text('\n'.join(lines))


def _again(row: RunRow, folder: Path, facts: Mapping[str, Any], documents: Path) -> str:
    """The command that runs a violated run again, with a word before it; ''."""
    command = ''
    if row.outcome is Outcome.FAIL:
        command = rerun_command(row, folder, facts, documents)
    return f'run {row.run_id} again: {command}' if command else ''


def _headline_rho(row: RunRow) -> float:
    return next((low for low, _ in row.robustness.values()), math.inf)


def _result_words(row: RunRow) -> str:
    if row.outcome.judged:
        return _rho_words(row) + (', off the runway' if row.left_runway else '')
    return ' '.join(word for word in (row.kind, row.who, row.detail) if word)


def _rho_words(row: RunRow) -> str:
    return ', '.join(
        f'{name}: rho ' + ' to '.join(rho_text(end, '.3f') for end in dict.fromkeys(interval))
        for name, interval in row.robustness.items()
    )


def _text(value: Any) -> str:
    """``value`` as text with U+FFFD for each character that XML 1.0 does not have."""
    return _ILLEGAL.sub('\ufffd', str(value))
