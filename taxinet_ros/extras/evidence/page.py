"""The page of evidence: argument, chain of hashes, figures, known limits, how to verify."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from taxinet_ros.analysis.odd.picture import coverage_picture
from taxinet_ros.analysis.report.parts import Cell, Column, Drawing, Report, Section, Table
from taxinet_ros.core.provenance import words
from taxinet_ros.extras.assurance.judge import REACH_S
from taxinet_ros.extras.evidence.argument import Argument, Kind
from taxinet_ros.extras.evidence.document import Collected
from taxinet_ros.extras.evidence.drawing import argument_svg, drawing_size
from taxinet_ros.extras.evidence.figures import QUANTILES, interval_words, percent
from taxinet_ros.extras.evidence.limits import SystemFacts

_CHAIN = (
    'requirement', 'formula', 'program', 'scenes', 'network', 'model card', 'training data',
    'validation data', 'controller', 'world', 'operational design domain', 'tool versions',
    'record', 'recordings', 'figures', 'known limits',
)
"""Kinds of items in the order in which one follows from the other."""


def evidence_report(found: Collected, json_sha256: str) -> Report:
    """The page.

    Args:
        found: the evidence.
        json_sha256: SHA-256 of ``evidence.json``.
    """
    content = found.content
    requirement = content['requirement']
    name = requirement['id'] if requirement else content['systems'][0]['headline']
    return Report(
        title=f'Evidence toward {name}',
        facts=_facts(content, json_sha256),
        summary=tuple(_summary(content)),
        sections=(
            _argument_section(found.argument),
            *(
                _system_section(content, system, values)
                for system, values in zip(found.systems, content['systems'], strict=True)
            ),
            _limits_section(content),
            _chain_section(content),
            _words_section(found.argument),
            _verify_section(content),
        ),
        made_on=_made_on(content),
    )


def _facts(content: Mapping[str, Any], json_sha256: str) -> dict[str, str]:
    runs = sum(one['figures']['runs'] for one in content['campaigns'])
    claim = content['claim']
    facts = {
        'requirement': content['requirement']['text'] if content['requirement'] else 'not given',
        'claim': 'none' if claim is None else f'satisfied in at least {percent(claim)} % of runs',
        'campaigns': ', '.join(one['name'] for one in content['campaigns']),
        'runs': f'{runs:,}',
        'evidence.json': json_sha256,
    }
    if content['newest_date']:
        facts['newest date in the inputs'] = content['newest_date']
    return facts


def _summary(content: Mapping[str, Any]) -> Iterator[str]:
    top = content['argument']['nodes'][0]
    told = f' ({top["why"]})' if top['why'] else ''
    yield f'{top["text"].rstrip(".")}. The argument as a whole is {top["verdict"]}{told}.'
    for system in content['systems']:
        yield _system_sentence(system)
    inputs = sum(one['source'] == 'inputs' for one in content['limits'])
    yield (
        f'{content["about"]} {len(content["limits"])} known limits are listed below, {inputs} of '
        'them from these inputs.'
    )


def _system_sentence(system: Mapping[str, Any]) -> str:
    formula = next(
        one for one in system['figures']['formulas'] if one['formula'] == system['headline']
    )
    satisfied = formula['satisfied']
    name = system['network']['name']
    rate = _rate_words(satisfied)
    sentence = (
        f'{name[:1].upper()}{name[1:]}, {system["program"]["name"]}: {satisfied["drawn_hits"]:,} '
        f'of {satisfied["drawn"]:,} runs drawn by the program satisfy {formula["formula"]}'
    )
    if satisfied['rate'] is not None:
        sentence += f', {rate}'
    elif formula['why_no_rate']:
        sentence += f'; no rate: {formula["why_no_rate"]}'
    claim = system['claim']
    if claim is not None:
        sentence += f'. The claim of at least {percent(claim["target"])} % is {claim["verdict"]}'
    return f'{sentence}.'


def _rate_words(share: Mapping[str, Any]) -> str:
    if share['rate'] is None:
        return ''
    return (
        f'{100 * share["rate"]:.4g} % ({interval_words(share["low"], share["high"])})'
    )


def _made_on(content: Mapping[str, Any]) -> str:
    stacks = {
        key: stack['versions'] for one in content['campaigns']
        for key, stack in one['stacks'].items()
    }
    return '; '.join(words(stack) for stack in stacks.values())


def _argument_section(argument: Argument) -> Section:
    return Section(
        name='argument', heading='Argument',
        sentences=(
            'Goal Structuring Notation: a goal is supported by a strategy, by other goals, or by a '
            'solution, which is one of the items below. A goal is refuted or undetermined where '
            'the figures say so, and undeveloped (◇) where nothing supports it yet.',
        ),
        drawings=(Drawing(
            name='argument', title='From the requirement to the results',
            caption='The same drawing is in argument.svg.',
            svg=lambda theme: argument_svg(argument, theme), size_px=drawing_size(argument),
        ),),
    )


def _words_section(argument: Argument) -> Section:
    rows = tuple(
        (
            one.name, one.kind.value, one.text,
            ('undeveloped' if one.undeveloped else one.verdict.value) if one.verdict else '',
            one.why, one.item,
        ) for one in argument.nodes
    )
    return Section(
        name='argument-in-words', heading='The argument in words',
        tables=(Table(
            name='argument', title='Elements',
            caption='With their full text, and the items that they point at.',
            columns=(Column(name='id', title='element'), Column(name='kind', title='kind'),
                     Column(name='text', title='statement'),
                     Column(name='verdict', title='verdict'), Column(name='why', title='why'),
                     Column(name='item', title='item')),
            rows=rows,
        ),),
    )


def _chain_section(content: Mapping[str, Any]) -> Section:
    items = content['items']
    order = {kind: number for number, kind in enumerate(_CHAIN)}
    rows = tuple(
        (one['kind'], one['name'], one['sha256'] or f'unknown: {one["why_unknown"]}', name)
        for name, one in sorted(items.items(), key=lambda pair: order[pair[1]['kind']])
    )
    return Section(
        name='chain', heading='What it rests on',
        sentences=(
            'Requirement, formula, program, scenes, network, training data, tool versions and '
            'records, each by its SHA-256. What is not known is named, with the reason. The ledger '
            'is a chain of hashes of its lines; its head is in the argument.',
        ),
        tables=(Table(
            name='items', title='Items', caption='In the order in which one follows from another.',
            columns=(Column(name='kind', title='what'), Column(name='name', title='name'),
                     Column(name='sha256', title='SHA-256'), Column(name='item', title='item')),
            rows=rows,
        ),),
    )


def _system_section(
    content: Mapping[str, Any], system: SystemFacts, values: Mapping[str, Any]
) -> Section:
    name, network = values['id'], values['network']
    sources = [
        (one['name'], one['figures']) for one in content['campaigns']
        if one['id'] in values['campaigns']
    ]
    if len(sources) > 1:
        sources.append(('all of them', values['figures']))
    sentences = [
        f'Program {values["program"]["name"]}, controller {values["controller"]["name"]}, world '
        f'{values["world"]["name"]}, timing: {values["timing"] or "answers at once"}.',
        *(f'{one["name"]}: {one["words"]}.' for one in values['formulas']),
    ]
    training = network['training']
    if training is not None:
        data = ', '.join(f'{one["kind"]} {one["name"]}' for one in training['data'])
        sentences.append(
            f'Trained on {training["images"]:,} pictures of {data}, seed {training["seed"]}: '
            f'{training["command"]}'
        )
    causes = [one for one in content['localisations'] if one['campaign'] in values['campaigns']]
    monitors = [
        one for one in content['monitors'] if one['perception_sha256'] == network['sha256']
    ]
    sentences += [line for one in causes for line in one['figures']['sentences']]
    tables = [
        _rates_table(name, sources), _rho_table(name, sources),
        *([_cells_table(name, values['odd'])] if values['odd'] else []),
        *([_causes_table(name, causes)] if causes else []),
        *([_monitor_table(name, monitors)] if monitors else []),
    ]
    shown = network['name']
    return Section(
        name=name, heading=f'{shown[:1].upper()}{shown[1:]} in {values["program"]["name"]}',
        sentences=tuple(sentences), tables=tuple(tables),
        pictures=() if system.coverage is None else (
            coverage_picture(system.coverage, f'{name}-odd'),
        ),
    )


def _rates_table(name: str, sources: Sequence[tuple[str, Mapping[str, Any]]]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for campaign, found in sources:
        for formula in found['formulas']:
            for what in ('satisfied', 'violated', 'undecided'):
                rows.append((campaign, formula['formula'], what, *_cells(formula[what])))
        if found['off_runway'] is not None:
            rows.append((campaign, '', 'left the runway', *_cells(found['off_runway'])))
        rows.append((campaign, '', 'infrastructure errors', *_cells(found['infra'])))
    notes = dict.fromkeys(
        f'{formula["formula"]}: {formula["why_no_rate"]}' for _, found in sources
        for formula in found['formulas'] if formula['why_no_rate']
    )
    note = f' No rate of {"; ".join(notes)}.' if notes else ''
    return Table(
        name=f'{name}-rates', title='How often',
        caption='Counts of all runs; rates with 95 % intervals of the runs that the program itself '
        f'drew.{note}',
        columns=(
            Column(name='campaign', title='campaign'), Column(name='formula', title='formula'),
            Column(name='what', title='runs that were'), Column(name='hits', title='runs'),
            Column(name='of', title='of'), Column(name='drawn_hits', title='drawn'),
            Column(name='drawn', title='of drawn'),
            Column(name='rate_percent', title='rate [%]', decimals=2),
            Column(name='low_percent', title='at least [%]', decimals=2),
            Column(name='high_percent', title='at most [%]', decimals=2),
            Column(name='interval', title='interval'),
        ),
        rows=tuple(rows),
    )


def _cells(share: Mapping[str, Any]) -> tuple[Cell, ...]:
    if share['rate'] is None:
        return (share['hits'], share['runs'], share['drawn_hits'], share['drawn'], None, None,
                None, 'none')
    kind = 'valid at any time' if share['any_time'] else 'Clopper-Pearson'
    return (
        share['hits'], share['runs'], share['drawn_hits'], share['drawn'], 100 * share['rate'],
        100 * share['low'], 100 * share['high'], kind,
    )


def _rho_table(name: str, sources: Sequence[tuple[str, Mapping[str, Any]]]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for campaign, found in sources:
        for formula in found['formulas']:
            rho = formula['rho']
            known = {one['share']: one['rho'] for one in rho['quantiles']}
            rows.append((campaign, formula['formula'], rho['runs'], *map(known.get, QUANTILES)))
    titles = ('least', '5 %', '25 %', 'median', '75 %', '95 %', 'largest')
    return Table(
        name=f'{name}-rho', title='Robustness',
        caption='Quantiles of ρ over the runs that the program itself drew; negative is violated.',
        columns=(
            Column(name='campaign', title='campaign'), Column(name='formula', title='formula'),
            Column(name='runs', title='runs'),
            *(
                Column(name=f'rho_{round(100 * share)}', title=title, decimals=3)
                for share, title in zip(QUANTILES, titles, strict=True)
            ),
        ),
        rows=tuple(rows),
    )


def _cells_table(name: str, odd: Mapping[str, Any]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for parameter in odd['parameters']:
        for cell in parameter['cells']:
            rows.append((
                parameter['key'], cell['label'], parameter['source'], cell['runs'],
                cell['failures'], *(
                    None if cell['drawn'] == 0 or cell[end] is None else 100 * cell[end]
                    for end in ('rate', 'low', 'high')
                ),
            ))
    pairs = next((one for one in odd['combinations'] if one['t'] == 2), None)
    told = '' if pairs is None else (
        f' Of {pairs["feasible"]:,} feasible pairs of cells {pairs["covered"]:,} were run.'
    )
    return Table(
        name=f'{name}-odd', title=f'Cells of the ODD {odd["odd"]["name"]}',
        caption=f'Runs and failures of each cell; each interval (95 %) for itself.{told}',
        columns=(
            Column(name='parameter', title='parameter'), Column(name='cell', title='cell'),
            Column(name='source', title='source'), Column(name='runs', title='runs'),
            Column(name='failures', title='failed'),
            Column(name='rate_percent', title='failing [%]', decimals=1),
            Column(name='low_percent', title='at least [%]', decimals=1),
            Column(name='high_percent', title='at most [%]', decimals=1),
        ),
        rows=tuple(rows),
    )


def _causes_table(name: str, causes: Sequence[Mapping[str, Any]]) -> Table:
    rows = tuple(
        (
            one['id'], share['substitution'], share['passed'], share['judged'],
            *(None if share[end] is None else 100 * share[end] for end in ('share', 'low', 'high')),
        ) for one in causes for share in one['figures']['substitutions']
    )
    return Table(
        name=f'{name}-causes', title='Failed runs with perfect estimates',
        caption='Failed runs driven again with the truth in place of the estimates, and once '
        'unchanged; how many pass, with exact 95 % intervals.',
        columns=(
            Column(name='localisation', title='localisation'),
            Column(name='with', title='driven with'), Column(name='passed', title='pass'),
            Column(name='judged', title='of'),
            Column(name='share_percent', title='pass [%]', decimals=1),
            Column(name='low_percent', title='at least [%]', decimals=1),
            Column(name='high_percent', title='at most [%]', decimals=1),
        ),
        rows=rows,
    )


def _monitor_table(name: str, monitors: Sequence[Mapping[str, Any]]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for one in monitors:
        judged, options = one['figures']['judged'], one['figures']['options']
        per_h = judged['false_per_h']
        alarms = (
            judged['failed'], judged['in_time'], judged['late'], judged['missed'],
            judged['false_alarms'], judged['settled_alarms'],
            per_h['value'], per_h['low'], per_h['high'],
        )
        for fallback, found in (('none', judged), *judged['with_fallback'].items()):
            first = alarms if fallback == 'none' else (None,) * len(alarms)
            rows.append((
                options['monitor'], fallback, judged['runs'], _share_words(found['satisfied']),
                _share_words(found['off']), *first,
            ))
    return Table(
        name=f'{name}-monitors', title='Run-time monitor',
        caption='The same scenes without a fallback and with each: satisfied and off the runway '
        'with 95 % intervals. Of the failed runs those with an alarm in time, late or never; of '
        f'the satisfied ones those with an alarm, and those after the first {REACH_S:g} s, from '
        'then on per hour with 95 % interval.',
        columns=(
            Column(name='monitor', title='monitor'), Column(name='fallback', title='fallback'),
            Column(name='scenes', title='scenes'), Column(name='satisfied', title='satisfied'),
            Column(name='off_runway', title='off the runway'),
            Column(name='failed', title='failed'), Column(name='in_time', title='alarm in time'),
            Column(name='late', title='late'), Column(name='missed', title='never'),
            Column(name='false_alarms', title='false alarms'),
            Column(name='settled_alarms', title=f'after {REACH_S:g} s'),
            Column(name='false_per_h', title='false per hour', decimals=1),
            Column(name='false_per_h_low', title='at least', decimals=1),
            Column(name='false_per_h_high', title='at most', decimals=1),
        ),
        rows=tuple(rows),
    )


def _share_words(share: Mapping[str, Any]) -> str:
    return f'{100 * share["rate"]:.1f} % ({100 * share["low"]:.1f}–{100 * share["high"]:.1f})'


def _limits_section(content: Mapping[str, Any]) -> Section:
    names = {one['id']: one['name'] for one in content['campaigns']} | {
        one['id']: one['network']['name'] for one in content['systems']
    }
    return Section(
        name='limits', heading='Known limits',
        sentences=(content['about'],),
        tables=(Table(
            name='limits', title='Known limits',
            caption='Those of these inputs first, then those of every result of this test bench.',
            columns=(Column(name='about', title='about'), Column(name='words', title='limit'),
                     Column(name='id', title='name')),
            rows=tuple(
                (names.get(one['about'], 'everything'), one['words'], one['id'])
                for one in content['limits']
            ),
        ),),
    )


def _verify_section(content: Mapping[str, Any]) -> Section:
    campaigns = ', '.join(one['path'] for one in content['campaigns'])
    solutions = sum(
        node['kind'] == Kind.SOLUTION.value for node in content['argument']['nodes']
    )
    return Section(
        name='verify', heading='Verify it',
        sentences=(
            f'The first command checks these files. The second also checks every hash against the '
            f'inputs (campaigns at {campaigns}, from this folder), computes every figure of the '
            f'{solutions} solutions again, and runs five of the runs again, to the bit.',
        ),
        commands=('sha256sum -c MANIFEST', 'taxinet evidence verify .'),
    )
