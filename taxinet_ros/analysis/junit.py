"""A gate's answer and its campaign's runs as JUnit XML, which CI servers show.

The vocabulary is that of Ant's JUnit reports as Jenkins, GitLab and others read it: a ``testsuite``
with ``properties`` and ``testcase`` elements, of which those with ``failure``, ``error`` or
``skipped`` in them are not passed.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from taxinet_ros.analysis.gate import Criterion, GateAnswer, Verdict
from taxinet_ros.campaign.facts import stacks_in
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.controller import STEERING, controller_options
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.provenance import words
from taxinet_ros.core.scenario import HUMAN_KEYS
from taxinet_ros.core.timing import parse_timing

# Char of XML 1.0 (fifth edition, production 2), negated.
_ILLEGAL = re.compile('[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]')
_GATE = 'gate'


def junit_xml(
    rows: Sequence[RunRow], answer: GateAnswer, folder: Path, facts: Mapping[str, Any], *,
    inconclusive_passes: bool,
) -> bytes:
    """The report as a UTF-8 document.

    Args:
        rows: the campaign's runs.
        answer: what the gate says.
        folder: the campaign's, to say what to run again.
        facts: of the campaign.
        inconclusive_passes: a criterion that is not decided is skipped, and not a failure.
    """
    suite = ElementTree.Element('testsuite', {'name': _text(folder.resolve().name)})
    _add_properties(suite, answer, facts)
    for criterion in answer.criteria:
        _add_criterion(suite, criterion, passes=inconclusive_passes)
    for row in rows:
        _add_run(suite, row, folder, facts)
    totals = {
        'tests': len(suite.findall('testcase')), 'failures': len(suite.findall('*/failure')),
        'errors': len(suite.findall('*/error')), 'skipped': len(suite.findall('*/skipped')),
    }
    times = {'time': f'{sum(row.wall_s for row in rows):.3f}'}
    suite.attrib.update({name: str(number) for name, number in totals.items()} | times)
    root = ElementTree.Element('testsuites', {**suite.attrib, 'name': 'taxinet'})
    root.append(suite)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='UTF-8', xml_declaration=True) + b'\n'


def again(row: RunRow, folder: Path, facts: Mapping[str, Any]) -> str:
    """What to type to run a run again, to the last bit where its bag is there."""
    if row.bag:
        return shlex.join(['taxinet', 'run', '--from', str(folder / row.bag)])
    settings = [f'{key}={_setting(getattr(row, key))}' for key in HUMAN_KEYS]
    settings += [f'steering.{name}={value!r}' for name, value in facts.get('gains', {}).items()]
    words = ['taxinet', 'run', 'nominal', '--perception', row.perception]
    words += controller_options(facts.get('controller', STEERING))
    for name, formula in facts.get('specs', {}).items():
        words += ['--spec', f'{name}={formula}']
    for setting in settings:
        words += ['--set', setting]
    timing = parse_timing(row.timing).of_run(row.seed, row.index)
    return shlex.join([*words, *timing.options])


def _add_properties(
    suite: ElementTree.Element, answer: GateAnswer, facts: Mapping[str, Any]
) -> None:
    names = (
        'taxinet_ros_version', 'program', 'program_sha256', 'seed', 'sampler', 'perception',
        'perception_sha256', 'controller', 'controller_sha256', 'timing',
    )
    values = {name: facts[name] for name in names if name in facts} | {
        **{f'stack_{name}': words(one) for name, one in stacks_in(facts).items()},
        'gate': answer.verdict.value, 'judged': answer.judged,
        **{outcome.value: count for outcome, count in answer.counts.items()},
        **{f'note_{number}': note for number, note in enumerate(answer.notes, 1)},
    }
    properties = ElementTree.SubElement(suite, 'properties')
    for name, value in values.items():
        attributes = {'name': _text(name), 'value': _text(value)}
        ElementTree.SubElement(properties, 'property', attributes)


def _add_criterion(suite: ElementTree.Element, criterion: Criterion, *, passes: bool) -> None:
    attributes = {'classname': _GATE, 'name': _text(criterion.name), 'time': '0'}
    case = ElementTree.SubElement(suite, 'testcase', attributes)
    if criterion.verdict is Verdict.PASS:
        ElementTree.SubElement(case, 'system-out').text = _text(criterion.sentence)
        return
    skipped = passes and criterion.verdict is Verdict.INCONCLUSIVE
    found = {'message': _text(f'{criterion.verdict}: {criterion.sentence}')}
    kind = {} if skipped else {'type': criterion.verdict.value}
    ElementTree.SubElement(case, 'skipped' if skipped else 'failure', {**found, **kind})


def _add_run(
    suite: ElementTree.Element, row: RunRow, folder: Path, facts: Mapping[str, Any]
) -> None:
    attributes = {
        'classname': _text(Path(row.program).stem or 'run'), 'name': _text(row.run_id),
        'time': f'{row.wall_s:.3f}',
    }
    case = ElementTree.SubElement(suite, 'testcase', attributes)
    if row.outcome is Outcome.PASS:
        return
    if row.outcome is Outcome.FAIL:
        message = _rho_words(row) + (', off the runway' if row.left_runway else '')
        failure = ElementTree.SubElement(
            case, 'failure', {'message': _text(message), 'type': row.outcome.value}
        )
        failure.text = _text(f'{message}\nrun it again: {again(row, folder, facts)}')
        return
    words = ' '.join(word for word in (row.kind, row.who, row.detail) if word)
    message = f'{row.outcome}: {words}' if words else row.outcome.value
    if row.outcome is Outcome.INFRA_ERROR:
        ElementTree.SubElement(case, 'error', {'message': _text(message), 'type': row.kind})
    else:
        ElementTree.SubElement(case, 'skipped', {'message': _text(message)})


def _rho_words(row: RunRow) -> str:
    names = dict.fromkeys((*row.rho_upper, *row.rho))
    ends = {name: row.interval(name) for name in names}
    return ', '.join(
        f'{name}: rho {low:+.3f}' if low == high else f'{name}: rho {low:+.3f} to {high:+.3f}'
        for name, (low, high) in ((name, end) for name, end in ends.items() if end)
    )


def _setting(value: Any) -> str:
    if isinstance(value, bool):
        return 'on' if value else 'off'
    return repr(value) if isinstance(value, float) else str(value)


def _text(value: Any) -> str:
    """``value`` as text with U+FFFD for each character that XML 1.0 does not have."""
    return _ILLEGAL.sub('\ufffd', str(value))
