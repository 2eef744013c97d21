"""The argument in Goal Structuring Notation: goals, what supports them, and its text for Mermaid.

GSN Community Standard, version 3: a goal is supported by a strategy, by other goals, or by
solutions, and stands in a context. A verdict is an addition to it: what the figures say of a goal.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from taxinet_ros.analysis.fault_localisation import Blame
from taxinet_ros.campaign.scenes.overrides import scenes_words
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.extras.evidence.figures import Verdict, interval_words, percent
from taxinet_ros.extras.evidence.inputs import RECORD

Values = Mapping[str, Any]
_SHAPES = {
    'G': ('["', '"]'), 'S': ('[/"', '"/]'), 'Sn': ('(("', '"))'), 'C': ('("', '")'),
    'A': ('(["', '"])'),
}
"""Of goals, strategies, solutions, contexts and assumptions, by the first letters of their ids."""
_MARKUP = re.compile(r'[^\w\s.,:;()/%=+*|\'φρ≤≥…–-]')
_OPEN, _SUPPORTED = Verdict.UNDETERMINED, Verdict.SUPPORTED


def argument_of(content: Values) -> dict[str, Any]:
    """The argument for the values of ``evidence.json``, with an id for each element."""
    requirement, odd = content['requirement'], content['odd']
    named = requirement and requirement['id']
    return numbered(whole(
        f'Evidence toward {named}: {requirement["text"]}' if requirement
        else 'Evidence toward the formula: no wording of a requirement was given',
        [_system_goal(content, system) for system in content['systems']],
        [
            *([reference(f'Requirement {named}', 'requirement')] if requirement else ()),
            *([reference(f'ODD {odd["name"]}', 'odd')] if odd else ()),
            reference(f'{len(content["limits"])} known limits', 'limits'),
        ],
        assumptions=[reference('What is true of the simulated world, camera and weather is true '
                               'of the real ones')],
        strategy='Argue over each system that was run: program, formula, network, controller, '
        'world; by rates of runs that the program itself drew, with exact 95 % intervals',
    ))


def reference(text: str, item: str = '') -> dict[str, str]:
    """A solution or a context, with the id of the item with a hash that it refers to."""
    return {'text': text, 'item': item}


def goal(
    text: str, verdict: Verdict, why: str, solutions: Sequence[Values] = (), **more: Any
) -> dict[str, Any]:
    """A goal; one without solutions and parts is undeveloped: nothing supports it yet."""
    values = {
        'text': text, 'verdict': verdict.value, 'why': why, 'context': (), 'assumptions': (),
        'strategy': '', 'solutions': solutions, 'parts': (), **more,
    }
    return values | {'undeveloped': not (values['solutions'] or values['parts'])}


def whole(text: str, parts: Sequence[Values], context: Sequence[Values], **more: Any) -> dict[
    str, Any
]:
    """A goal of parts: refuted if one of them is, supported if all are, else undetermined."""
    counts = Counter(one['verdict'] for one in parts)
    verdict = (
        Verdict.REFUTED if counts[Verdict.REFUTED]
        else Verdict.SUPPORTED if counts[Verdict.SUPPORTED] == len(parts)
        else Verdict.UNDETERMINED
    )
    words = ', '.join(f'{counts[one]} {one}' for one in Verdict if counts[one])
    return goal(text, verdict, f'of its parts: {words}', parts=parts, context=context, **more)


def numbered(top: Values) -> dict[str, Any]:
    """A goal and all below it with ids, such as ``G1`` and ``Sn3``."""
    numbers: Counter[str] = Counter()

    def named(letters: str, values: Values) -> dict[str, Any]:
        numbers[letters] += 1
        return {**values, 'id': f'{letters}{numbers[letters]}'}

    def deep(values: Values) -> dict[str, Any]:
        found = named('G', values)
        for key, letters in (('context', 'C'), ('assumptions', 'A')):
            found[key] = [named(letters, one) for one in values[key]]
        strategy = values['strategy']
        found['strategy'] = named('S', {'text': strategy}) if strategy else None
        found['solutions'] = [named('Sn', one) for one in values['solutions']]
        found['parts'] = [deep(part) for part in values['parts']]
        return found

    return deep(top)


def _system_goal(content: Values, system: Values) -> dict[str, Any]:
    name, network, program = system['id'], system['network'], system['program']
    headline = system['headline']
    formula = next(one['words'] for one in system['formulas'] if one['name'] == headline)
    own = [one for one in content['campaigns'] if one['id'] in system['campaigns']]
    seen = f'network {network["name"]}' if network['sha256'] else network['name']
    seen = f'{seen[:1].upper()}{seen[1:]}'
    return whole(
        f'{seen} with controller {system["controller"]["name"]} satisfies {headline} in '
        f'the scenes of {scenes_words(program["name"], program["overrides"])}',
        [
            _rate_goal(system), _domain_goal(system), _cause_goal(content, system, own),
            _monitor_goal(content, system), _data_goal(system), _record_goal(own),
        ],
        [
            reference(f'Program {program["name"]}', f'{name}/program'),
            reference(f'{headline}: {formula}', f'{name}/formula/{headline}'),
            reference(seen if network['sha256'] else f'{seen}, no hash', f'{name}/network'),
        ],
    )


def _rate_goal(system: Values) -> dict[str, Any]:
    known, claim = 'How often the formula is satisfied is known', system['claim']
    rates = next(
        one for one in system['figures']['formulas'] if one['formula'] == system['headline']
    )
    drawn, hits = rates['satisfied']['drawn'], rates['satisfied']['drawn_hits']
    if not drawn:
        return goal(known, _OPEN, rates['why_no_rate'])
    solution = [reference(f'{drawn:,} runs drawn by the program', f'{system["id"]}/figures')]
    if claim:
        return goal(
            f'Runs drawn by the program satisfy {system["headline"]} in at least '
            f'{percent(claim["target"])} %', Verdict(claim['verdict']), claim['why'], solution,
        )
    ends = interval_words(rates['satisfied_at_least'], rates['satisfied_at_most'])
    return goal(known, _SUPPORTED, f'{100 * hits / drawn:.4g} % satisfied, 95 %: {ends}', solution)


def _domain_goal(system: Values) -> dict[str, Any]:
    """Gaps refute nothing: what happens in them is not known."""
    odd = system['odd']
    if odd is None:
        return goal('The runs cover the operational design domain', _OPEN, 'no domain was given')
    cells = odd['combinations']
    cells = next((one for one in cells if one['t'] == 2), cells[0])
    what, name = 'pairs of cells' if cells['t'] == 2 else 'cells', odd['odd']['name']
    return goal(
        f'The runs cover every feasible pair of conditions of the ODD {name}',
        _SUPPORTED if cells['covered'] == cells['feasible'] else _OPEN,
        f'{cells["covered"]:,} of {cells["feasible"]:,} feasible {what} of {name} were run',
        [reference('Coverage', f'{system["id"]}/odd')],
    )


def _cause_goal(
    content: Values, system: Values, own: Sequence[Values]
) -> dict[str, Any]:
    failed = system['figures']['outcomes'].get(Outcome.FAIL, 0)
    found = about(content['localisations'], system)
    if not failed:
        verdict, why = (
            (_SUPPORTED, 'none of the judged runs failed') if sum(one['judged'] for one in own)
            else (_OPEN, 'no run was judged')
        )
        return goal('There is no failed run to attribute', verdict, why, _records(own))
    text = 'Each failed run that was examined is attributed to a part of the system'
    if not found:
        return goal(text, _OPEN, f'none of {failed:,} failed runs was examined')
    known, words = True, []
    for one in found:
        blame, examined = one['figures']['blame'], one['figures']['looked_into']
        network, controller = blame[Blame.PERCEPTION], blame[Blame.CONTROLLER]
        known &= network + controller == examined
        words.append(
            f'{network + controller:,} of {examined:,} failed runs examined are attributed: '
            f'{network:,} to the network, {controller:,} to controller or formula'
        )
    return goal(text, _SUPPORTED if known else _OPEN, '; '.join(words), [
        reference(f'Localisation of {one["figures"]["looked_into"]:,} runs', _summary(one))
        for one in found
    ])


def _monitor_goal(content: Values, system: Values) -> dict[str, Any]:
    text = 'What a run-time monitor of this network notices, and misses, is measured'
    found = about(content['monitors'], system)
    if not found:
        return goal(text, _OPEN, 'no monitor was judged')
    words = '; '.join(
        f'of {one["failed"]:,} failed runs {one["in_time"]:,} with an alarm in time, of '
        f'{one["runs"] - one["failed"]:,} satisfied ones {one["false_alarms"]:,} with an alarm'
        for one in (each['figures'] for each in found)
    )
    return goal(text, _SUPPORTED, words, [
        reference(
            f'Monitor {one["figures"]["monitor"]} in {one["figures"]["runs"]:,} scenes',
            _summary(one),
        ) for one in found
    ])


def _data_goal(system: Values) -> dict[str, Any]:
    network = system['network']
    training = network['training']
    if not network['sha256']:
        return goal(
            'What the perception was made from is known', _OPEN, network['why_unknown']
        )
    text = f'The training data of {network["name"]} are known'
    if training is None:
        return goal(text, _OPEN, network['why_unknown'])
    names = ', '.join(f'{one["kind"]} {one["name"]}' for one in training['data'])
    return goal(text, _SUPPORTED, f'{names}; seed {training["seed"]}',
                [reference('Model card', f'{system["id"]}/card')])


def _record_goal(own: Sequence[Values]) -> dict[str, Any]:
    judged, lacking = (
        sum(one[name] for one in own) for name in ('judged', 'judged_without_bag')
    )
    if not judged:
        verdict, why = _OPEN, 'ledger and tables were checked; no run was judged'
    elif not lacking:
        verdict, why = _SUPPORTED, 'ledger, tables and bags were checked'
    else:
        verdict, why = _OPEN, (
            f'ledger and tables were checked, and the bags of {judged - lacking:,} of {judged:,} '
            'judged runs; the others are not here'
        )
    return goal('Every figure rests on recorded runs that are bound by hash', verdict, why,
                _records(own))


def about(results: Sequence[Values], system: Values) -> list[Values]:
    """Those of the results that are about a campaign of a system."""
    return [one for one in results if set(one['campaigns']) & set(system['campaigns'])]


def _summary(results: Values) -> str:
    return f'{results["id"]}/{results["summary"]}'


def _records(own: Sequence[Values]) -> list[dict[str, str]]:
    return [reference(f'Ledger of {one["name"]}', f'{one["id"]}/{RECORD}') for one in own]


def goals(argument: Values) -> Iterator[Values]:
    """All goals of an argument, from the top down."""
    yield argument
    for part in argument['parts']:
        yield from goals(part)


def mermaid(argument: Values) -> str:
    """The argument as a Mermaid flowchart, which GitHub and many editors draw."""
    return '\n'.join(['flowchart TD', *_lines(argument)]) + '\n'


def _lines(one: Values) -> Iterator[str]:
    name, verdict = one['id'], 'undeveloped ◇' if one['undeveloped'] else one['verdict']
    yield _node(name, one['text'], f'<br/>{_safe(verdict)}')
    for beside in (*one['context'], *one['assumptions']):
        yield _node(beside['id'], beside['text'])
        yield f'  {name} -.-> {beside["id"]}'
    above = name
    if one['strategy']:
        above = one['strategy']['id']
        yield _node(above, one['strategy']['text'])
        yield f'  {name} --> {above}'
    for solution in one['solutions']:
        yield _node(solution['id'], solution['text'])
        yield f'  {above} --> {solution["id"]}'
    for part in one['parts']:
        yield f'  {above} --> {part["id"]}'
        yield from _lines(part)


def _node(name: str, text: str, more: str = '') -> str:
    before, after = _SHAPES[name.rstrip('0123456789')]
    return f'  {name}{before}{name}: {_safe(text)}{more}{after}'


def _safe(text: str) -> str:
    return _MARKUP.sub(lambda found: f'#{ord(found[0])};', text)
