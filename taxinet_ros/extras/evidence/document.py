"""Evidence as one document: collected from its inputs, and written as JSON, SVG, page and manifest.

The content is a function of the inputs alone: nothing of the clock, of this machine or of the order
of files is in it. :func:`collect` is used twice: to write, and by :mod:`.verify` to compute
everything again.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.odd.coverage import coverage_json
from taxinet_ros.campaign.record.facts import LEDGER_NAME, recorded_stacks
from taxinet_ros.campaign.scenes.overrides import scenes_words
from taxinet_ros.core.mtl.lint import formula_words
from taxinet_ros.core.mtl.specs import SIGNALS, parse_spec
from taxinet_ros.core.perception.weights import Source
from taxinet_ros.core.provenance import COMMIT, provenance
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.evidence import figures
from taxinet_ros.extras.evidence.argument import (
    Argument,
    Part,
    SystemArgument,
    argument_faults,
    build_argument,
)
from taxinet_ros.extras.evidence.figures import Verdict
from taxinet_ros.extras.evidence.inputs import (
    CampaignInput,
    LocalisationInput,
    MonitorInput,
    OddInput,
    Place,
    Requirement,
    digest_of,
    read_campaigns,
    read_domain,
    read_localisation,
    read_monitor,
    read_network,
    read_requirement,
    text_sha256,
)
from taxinet_ros.extras.evidence.limits import (
    WORDS,
    Facts,
    SystemFacts,
    known_limits,
    limits_plain,
)
from taxinet_ros.files.sealed_json import sealed_text

SCHEMA = 'taxinet-evidence-1'
JSON_NAME, PAGE_NAME, SVG_NAME, MANIFEST_NAME = (
    'evidence.json', 'evidence.html', 'argument.svg', 'MANIFEST'
)
LOCALISED = 'localized'
"""Folder of trials that were made for the evidence, in its own folder."""
_FILE_HEAD = re.compile(r'^# --- (.+) ---\n', re.MULTILINE)


@dataclass(frozen=True, kw_only=True)
class EvidenceOptions:
    """What evidence is asked for.

    Attributes:
        campaigns: folders of finished campaigns.
        requirement: ``ID: wording``, or a file with that; None for none.
        claim: least share of satisfied runs that is claimed, in (0, 1); None for none.
        spec: formula that the claim and the ODD are about; None for the headline of each system.
        odd: name or file of an operational design domain; None for none.
        monitors: folders of ``taxinet assure judge``.
        localisations: folders of ``taxinet localize``.
        networks: files of networks that have moved.

    Raises:
        UsageError: no campaign, or a claim that is no share.
    """

    campaigns: tuple[Path, ...]
    requirement: str | None = None
    claim: float | None = None
    spec: str | None = None
    odd: str | None = None
    monitors: tuple[Path, ...] = ()
    localisations: tuple[Path, ...] = ()
    networks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.campaigns:
            raise UsageError('evidence: name at least one campaign')
        if self.claim is not None and not 0 < self.claim < 1:
            raise UsageError(
                f'--claim {self.claim:g}: expected a share between 0 and 1, such as 0.99 or 99%; '
                'no number of runs shows 100 %'
            )


def parse_claim(text: str) -> float:
    """A share as people write it: ``0.99``, ``99%`` or ``99 %``.

    Raises:
        UsageError: it is no number.
    """
    number, percent, rest = text.strip().partition('%')
    try:
        value = float(number)
    except ValueError:
        value, rest = 0.0, 'no number'
    if rest.strip():
        raise UsageError(f'--claim {text}: expected a share such as 0.99 or 99%')
    return value / 100 if percent else value


@dataclass(frozen=True, kw_only=True)
class Collected:
    """Evidence, ready to be written.

    Attributes:
        content: everything, as JSON values.
        argument: the argument.
        systems: the systems with their inputs.
        inputs: the campaigns by their ids.
    """

    content: dict[str, Any]
    argument: Argument
    systems: tuple[SystemFacts, ...]
    inputs: Mapping[str, CampaignInput]


@dataclass(frozen=True, kw_only=True)
class _Sources:
    """All inputs, read and checked."""

    options: EvidenceOptions
    requirement: Requirement | None
    campaigns: tuple[CampaignInput, ...]
    domain: OddInput | None
    causes: tuple[LocalisationInput, ...]
    monitors: tuple[MonitorInput, ...]
    folder: Path
    places: Mapping[Path, Place] = field(default_factory=dict)


def collect(
    options: EvidenceOptions, folder: Path, *, requirement: Requirement | None = None,
    campaigns: tuple[CampaignInput, ...] | None = None, where: Mapping[Path, Place] | None = None,
    on_bag: Callable[[Path], None] = lambda bag: None,
) -> Collected:
    """Read all inputs and compute all figures.

    Args:
        options: what is asked for.
        folder: folder of the evidence, to which paths of inputs are relative.
        requirement: the requirement as read before, instead of that of the options.
        campaigns: the campaigns as read before, instead of those of the options.
        where: what to record of the places of inputs, instead of where they are.
        on_bag: called with each bag before it is checked.

    Raises:
        UsageError: an input is refused; the line names it.
    """
    if requirement is None and options.requirement is not None:
        requirement = read_requirement(options.requirement)
    domain = read_domain(options.odd) if options.odd is not None else None
    if campaigns is None:
        campaigns = read_campaigns(options.campaigns, on_bag)
    if where:
        campaigns = tuple(
            replace(one, name=where[one.folder].name) if one.folder in where else one
            for one in campaigns
        )
    sources = _Sources(
        options=options, requirement=requirement, campaigns=campaigns, domain=domain,
        causes=tuple(read_localisation(path, campaigns) for path in options.localisations),
        monitors=tuple(read_monitor(path, campaigns) for path in options.monitors),
        folder=folder, places=where or {},
    )
    for what, paths in (
        ('--localize', [one.campaign for one in sources.causes]),
        ('--monitor-table', [one.files['trials.csv'] for one in sources.monitors]),
    ):
        if len(set(paths)) != len(paths):
            raise UsageError(f'{what}: two are about the same; name one of them')
    systems = _systems(sources)
    content = _content(sources, systems)
    items = _items(content)
    limits = known_limits(Facts(
        requirement=requirement, claim=options.claim, systems=systems,
    ))
    content['limits'] = limits_plain(limits)
    items['limits'] = {
        'kind': 'known limits', 'name': f'{len(limits)} known limits',
        'sha256': digest_of(content['limits']), 'why_unknown': '',
    }
    content['items'] = items
    argument = _argument(sources, systems, content)
    faults = argument_faults(argument, {name: one['sha256'] for name, one in items.items()})
    if faults:
        raise AssertionError(f'the argument is not sound: {faults[0]}')
    content['argument'] = argument.plain()
    content['computed_by'] = {
        name: provenance()[name] for name in ('taxinet_ros', COMMIT) if name in provenance()
    }
    content = json.loads(json.dumps(content, sort_keys=True, allow_nan=False))
    return Collected(
        content=content, argument=argument, systems=systems,
        inputs={name: one for system in systems for name, one in system.campaigns},
    )


def _systems(sources: _Sources) -> tuple[SystemFacts, ...]:
    """Campaigns of one program, formula, network, … together, in the order given."""
    groups: dict[str, list[tuple[str, CampaignInput]]] = {}
    for number, one in enumerate(sources.campaigns, 1):
        groups.setdefault(digest_of(one.system), []).append((f'campaign-{number}', one))
    found = []
    for number, members in enumerate(groups.values(), 1):
        inputs = [one for _, one in members]
        spec = _spec(sources.options.spec, inputs[0])
        sha256 = inputs[0].facts['perception_sha256']
        found.append(SystemFacts(
            name=f'system-{number}', spec=spec, campaigns=tuple(members),
            network=read_network(inputs[0].facts, sources.options.networks),
            coverage=None if sources.domain is None else figures.domain_of(
                inputs, sources.domain.odd, spec,
                None if sources.options.claim is None else 1 - sources.options.claim,
            ),
            causes=tuple(
                one for one in sources.causes if sources.campaigns[one.campaign] in inputs
            ),
            monitors=tuple(
                one for one in sources.monitors if one.perception_sha256 == sha256
            ),
        ))
    return tuple(found)


def _spec(wanted: str | None, one: CampaignInput) -> str:
    known = list(one.facts['specs'])
    if wanted is not None and wanted not in known:
        raise UsageError(
            f'--spec {wanted}: not judged in {one.folder}; known: {", ".join(known)}'
        )
    return wanted or str(known[0])


def _content(sources: _Sources, systems: Sequence[SystemFacts]) -> dict[str, Any]:
    requirement, options = sources.requirement, sources.options
    dates = [one.network.card.date for one in systems if one.network.card is not None]
    return {
        'schema': SCHEMA,
        'about': WORDS,
        'requirement': None if requirement is None else {
            'id': requirement.name, 'text': requirement.text, 'given': requirement.given,
            'sha256': requirement.sha256,
        },
        'claim': options.claim,
        'asked_spec': options.spec,
        'newest_date': max(dates, default=None),
        'systems': [_system(one, options.claim) for one in systems],
        'campaigns': [
            _campaign(sources, name, one) for system in systems for name, one in system.campaigns
        ],
        'odd': None if sources.domain is None else {
            'name': sources.domain.odd.name, 'source': sources.domain.odd.source,
            'sha256': sources.domain.sha256,
            'given': _path(sources, sources.domain.path, options.odd or ''),
        },
        'localisations': [
            {
                'id': f'localisation-{number}', 'path': _path(sources, one.folder),
                'files': dict(one.files), 'campaign': _id_of(
                    systems, sources.campaigns[one.campaign]), 'figures': figures.cause_json(one),
            } for number, one in enumerate(sources.causes, 1)
        ],
        'monitors': [
            {
                'id': f'monitor-{number}', 'path': _path(sources, one.folder),
                'files': dict(one.files), 'perception_sha256': one.perception_sha256,
                'figures': figures.monitor_json(one),
            } for number, one in enumerate(sources.monitors, 1)
        ],
    }


def _path(sources: _Sources, path: Path, shipped: str = '') -> str:
    """Path of an input relative to the evidence; the name of what is shipped."""
    if shipped and not Path(shipped).is_file():
        return shipped
    if path in sources.places:
        return sources.places[path].path
    return os.path.relpath(path.resolve(), sources.folder.resolve())


def _id_of(systems: Sequence[SystemFacts], wanted: CampaignInput) -> str:
    return next(
        name for system in systems for name, one in system.campaigns if one is wanted
    )


def _system(system: SystemFacts, claim: float | None) -> dict[str, Any]:
    first, network = system.inputs[0], system.network
    facts = first.facts
    specs = list(facts['specs'])
    rates = figures.formula_rates(system.inputs, system.spec)
    verdict = None if claim is None else figures.claim_verdict(rates, claim)
    return {
        'id': system.name,
        'sha256': digest_of(first.system),
        'program': {
            'name': facts['program'], 'sha256': facts['program_sha256'],
            'text': facts['program_text'],
            'files': [
                {'name': name, 'sha256': text_sha256(text)}
                for name, text in _program_files(facts['program_text'])
            ],
            'overrides': {**facts.get('laid_over', {}), **facts.get('overrides', {})},
        },
        'formulas': [_formula(name, text) for name, text in facts['specs'].items()],
        'headline': system.spec,
        'assumptions': {name: facts.get(name, []) for name in ('stop_on', 'bounds', 'rates')},
        'network': {
            'name': network.word, 'sha256': network.sha256 or None,
            'card_sha256': network.card_sha256 or None,
            'training': None if network.card is None else _training(network.card),
            'why_unknown': network.why_unknown,
        },
        'controller': {
            'name': facts.get('controller', ''), 'sha256': facts.get('controller_sha256') or None,
            'gains': facts.get('gains', {}),
        },
        'world': {
            'name': first.system['world'], 'sha256': first.system['world_sha256'] or None,
        },
        'timing': facts.get('timing', ''),
        'campaigns': [name for name, _ in system.campaigns],
        'figures': figures.counts_json(system.inputs, specs),
        'odd': None if system.coverage is None else coverage_json(system.coverage),
        'claim': None if verdict is None else {
            'target': claim, 'formula': system.spec, 'verdict': verdict[0].value,
            'why': verdict[1],
        },
    }


def _program_files(text: str) -> Iterator[tuple[str, str]]:
    """Name and text of each file of a program, as they stand in its recorded text."""
    heads = list(_FILE_HEAD.finditer(text))
    for number, head in enumerate(heads):
        end = heads[number + 1].start() if number + 1 < len(heads) else len(text)
        yield head[1], text[head.end():end]


def _formula(name: str, text: str) -> dict[str, str]:
    spec = parse_spec(f'{name}={text}')
    return {
        'name': name, 'text': text, 'sha256': text_sha256(f'{name}={text}'),
        'words': formula_words(spec.formula, SIGNALS),
    }


def _training(card: Any) -> dict[str, Any]:
    def sources(given: Sequence[Source]) -> list[dict[str, str]]:
        return [{'kind': one.kind, 'name': one.name, 'sha256': one.sha256} for one in given]

    return {
        'data': sources(card.training_data), 'validation': sources(card.validation_data),
        'seed': card.seed, 'images': card.images, 'start_sha256': card.start_sha256,
        'command': card.command_line, 'date': card.date,
        'package_version': card.package_version,
        'errors': {name: dict(values) for name, values in card.errors.items()},
    }


def _campaign(sources: _Sources, name: str, one: CampaignInput) -> dict[str, Any]:
    facts = one.facts
    return {
        'id': name, 'name': one.name, 'path': _path(sources, one.folder),
        'files': dict(one.files),
        'ledger': {'lines': one.ledger_end.lines, 'head': one.ledger_end.link},
        'seed': facts['seed'], 'sampler': str(facts.get('sampler', '')),
        'planned': facts.get('first_runs', facts.get('runs')),
        'engine': str(facts.get('engine', '')), 'audit_percent': facts.get('audit_percent'),
        'images': str(facts.get('images', '')),
        'scenes': {'runs': len(one.scenes), 'sha256': one.scenes_sha256},
        'bags': {
            'runs': len(one.bags), 'sha256': one.bags_sha256 or None, 'each': dict(one.bags),
        },
        'stacks': {
            key: {'sha256': digest_of(stack), 'versions': stack}
            for key, stack in recorded_stacks(facts).items()
        },
        'figures': figures.counts_json([one], list(facts['specs'])),
    }


def _items(content: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Everything that evidence refers to, by id, each with its hash or why it has none."""
    items: dict[str, dict[str, Any]] = {}

    def add(name: str, kind: str, words: str, sha256: str | None, why: str = '') -> None:
        items[name] = {
            'kind': kind, 'name': words, 'sha256': sha256,
            'why_unknown': '' if sha256 else why or 'not recorded',
        }

    requirement = content['requirement']
    if requirement is None:
        add('requirement', 'requirement', 'unknown', None, 'no wording was given')
    else:
        add('requirement', 'requirement', requirement['id'], requirement['sha256'])
    for system in content['systems']:
        _system_items(system, add)
    for one in content['campaigns']:
        _campaign_items(one, add)
    if content['odd'] is not None:
        add('odd', 'operational design domain', content['odd']['name'], content['odd']['sha256'])
    for one in (*content['localisations'], *content['monitors']):
        for file, sha256 in one['files'].items():
            add(f'{one["id"]}/{file}', 'record', file, sha256)
        add(f'{one["id"]}/figures', 'figures', f'figures of {one["id"]}',
            digest_of(one['figures']))
    return items


def _campaign_items(one: Mapping[str, Any], add: Callable[..., None]) -> None:
    name = one['id']
    for file, sha256 in one['files'].items():
        add(f'{name}/{file}', 'record', f'{one["name"]}/{file}', sha256)
    add(f'{name}/scenes', 'scenes', f'{one["scenes"]["runs"]:,} scenes',
        one['scenes']['sha256'])
    add(f'{name}/bags', 'recordings', f'{one["bags"]["runs"]:,} bags', one['bags']['sha256'],
        'the runs were made without bags, or these are gone')
    for key, stack in one['stacks'].items():
        add(f'{name}/versions/{key}', 'tool versions', _stack_words(stack['versions']),
            stack['sha256'])
    if not one['stacks']:
        add(f'{name}/versions', 'tool versions', 'unknown', None)
    add(f'{name}/figures', 'figures', f'figures of {one["name"]}', digest_of(one['figures']))


def _stack_words(stack: Mapping[str, str]) -> str:
    names = ('taxinet_ros', COMMIT, 'python', 'rclpy', 'jsbsim', 'numpy', 'processor')
    told = (f'{name} {stack[name]}' if name != 'processor' else stack[name]
            for name in names if name in stack)
    return ', '.join(told)


def _system_items(system: Mapping[str, Any], add: Callable[..., None]) -> None:
    name, network = system['id'], system['network']
    program = system['program']
    add(f'{name}/program', 'program', f'{program["name"]} with all it imports', program['sha256'])
    for file in program['files']:
        add(f'{name}/program/{file["name"]}', 'program', file['name'], file['sha256'])
    for formula in system['formulas']:
        add(f'{name}/formula/{formula["name"]}', 'formula', formula['name'], formula['sha256'])
    why = network['why_unknown']
    add(f'{name}/network', 'network', network['name'], network['sha256'], why)
    add(f'{name}/card', 'model card', network['name'], network['card_sha256'], why)
    training = network['training']
    if training is None:
        add(f'{name}/data', 'training data', 'unknown', None, why)
    else:
        for kind in ('data', 'validation'):
            for number, source in enumerate(training[kind], 1):
                what = 'training data' if kind == 'data' else 'validation data'
                add(f'{name}/{kind}-{number}', what, f'{source["kind"]} {source["name"]}',
                    source['sha256'])
        if not training['validation']:
            add(f'{name}/validation', 'validation data', 'held out of the training data',
                digest_of(training['data']))
    controller, world = system['controller'], system['world']
    shipped = 'part of the package, whose version and commit are recorded'
    add(f'{name}/controller', 'controller', controller['name'], controller['sha256'], shipped)
    add(f'{name}/world', 'world', world['name'], world['sha256'], shipped)
    add(f'{name}/figures', 'figures', f'figures of {name}', digest_of(system['figures']))
    if system['odd'] is not None:
        add(f'{name}/odd', 'figures', f'coverage by {name}', digest_of(system['odd']))


def _argument(
    sources: _Sources, systems: Sequence[SystemFacts], content: Mapping[str, Any]
) -> Argument:
    requirement = sources.requirement
    top = (
        f'Evidence toward {requirement.name}: {requirement.text}' if requirement is not None
        else 'Evidence toward the formula: no wording of a requirement was given'
    )
    contexts: list[tuple[str, str]] = []
    if requirement is not None:
        contexts.append((f'Requirement {requirement.name}, sha256 {requirement.sha256[:12]}…',
                         'requirement'))
    if sources.domain is not None:
        odd = sources.domain
        contexts.append((f'ODD {odd.odd.name}, sha256 {odd.sha256[:12]}…', 'odd'))
    limits = (f'{len(content["limits"])} known limits are listed beside', 'limits')
    return build_argument(
        top, contexts, [
            _system_argument(sources, one, values)
            for one, values in zip(systems, content['systems'], strict=True)
        ], limits,
    )


def _system_argument(
    sources: _Sources, system: SystemFacts, values: Mapping[str, Any]
) -> SystemArgument:
    name, network = system.name, system.network
    formula = next(one for one in values['formulas'] if one['name'] == system.spec)
    program = values['program']
    seen = f'network {network.word}' if network.sha256 else network.word
    contexts = [
        (f'Program {program["name"]}, sha256 {program["sha256"][:12]}…', f'{name}/program'),
        (f'{formula["name"]}: {formula["words"]}', f'{name}/formula/{formula["name"]}'),
        (f'{seen[:1].upper()}{seen[1:]}' + (
            f', sha256 {network.sha256[:12]}…' if network.sha256 else ', no hash'
        ), f'{name}/network'),
    ]
    for campaign, one in system.campaigns:
        stacks = recorded_stacks(one.facts)
        for key, stack in stacks.items():
            words = f'{one.name}: taxinet_ros {stack.get("taxinet_ros", "?")}'
            python = f', Python {stack["python"]}' if 'python' in stack else ''
            contexts.append((f'{words}{python}, stack {key}', f'{campaign}/versions/{key}'))
    return SystemArgument(
        text=f'{seen[:1].upper()}{seen[1:]} with controller {values["controller"]["name"]} '
        f'satisfies {system.spec} in the scenes of '
        f'{scenes_words(program["name"], program["overrides"])}',
        contexts=tuple(contexts), parts=tuple(_parts(sources, system, values)),
    )


def _parts(
    sources: _Sources, system: SystemFacts, values: Mapping[str, Any]
) -> Iterator[Part]:
    name = system.name
    yield _rate_part(sources, system, values)
    if system.coverage is None:
        yield Part(text='The runs cover the operational design domain',
                   undeveloped='no domain was given')
    else:
        yield Part(
            text=f'The runs cover every feasible pair of conditions of the ODD '
            f'{system.coverage.odd.name}',
            found=figures.domain_verdict(system.coverage),
            solutions=((f'Coverage, sha256 {digest_of(values["odd"])[:12]}…', f'{name}/odd'),),
        )
    yield _cause_part(sources, system)
    yield _monitor_part(sources, system)
    yield _data_part(system)
    yield Part(
        text='Every figure rests on recorded runs that are bound by hash',
        found=_records_verdict(system),
        solutions=_ledgers(system),
    )


def _judged(system: SystemFacts) -> int:
    return sum(len(one.recorded.judged) for one in system.inputs)


def _records_verdict(system: SystemFacts) -> tuple[Verdict, str]:
    """Whether every judged run has a bag here that was checked, and a sentence on it."""
    judged = _judged(system)
    read = sum(
        row.run_id in one.bags
        for one in system.inputs for row in one.recorded.judged
    )
    if not judged:
        return Verdict.UNDETERMINED, 'ledger and tables were checked; no run was judged'
    if read == judged:
        return Verdict.SUPPORTED, 'ledger, tables and bags were checked'
    return Verdict.UNDETERMINED, (
        f'ledger and tables were checked, and the bags of {read:,} of {judged:,} judged runs; the '
        'others are not here'
    )


def _ledgers(system: SystemFacts) -> tuple[tuple[str, str], ...]:
    return tuple(
        (f'Ledger of {one.name}, {one.ledger_end.lines:,} lines, head '
         f'{one.ledger_end.link[:12]}…', f'{campaign}/{LEDGER_NAME}')
        for campaign, one in system.campaigns
    )


def _rate_part(
    sources: _Sources, system: SystemFacts, values: Mapping[str, Any]
) -> Part:
    claim, rates = sources.options.claim, figures.formula_rates(system.inputs, system.spec)
    solution = (
        f'{rates.satisfied.drawn:,} runs drawn by the program, sha256 '
        f'{digest_of(values["figures"])[:12]}…', f'{system.name}/figures',
    )
    if not rates.satisfied.drawn:
        text = 'How often the formula is satisfied is known'
        return Part(text=text, undeveloped=rates.satisfied.why_not)
    low, high = rates.ends
    if claim is None:
        share = rates.satisfied.drawn_hits / rates.satisfied.drawn
        told = f'{100 * share:.4g} % satisfied, 95 %: {figures.interval_words(low, high)}'
        return Part(text='How often the formula is satisfied is known',
                    found=(Verdict.SUPPORTED, told), solutions=(solution,))
    return Part(
        text=f'Runs drawn by the program satisfy {system.spec} in at least '
        f'{figures.percent(claim)} %',
        found=figures.claim_verdict(rates, claim), solutions=(solution,),
    )


def _cause_part(sources: _Sources, system: SystemFacts) -> Part:
    text = 'Each failed run that was examined is attributed to a part of the system'
    failed = sum(len(one.recorded.counterexamples) for one in system.inputs)
    if not failed:
        return Part(
            text='There is no failed run to attribute',
            found=(
                (Verdict.SUPPORTED, 'none of the judged runs failed') if _judged(system)
                else (Verdict.UNDETERMINED, 'no run was judged')
            ),
            solutions=_ledgers(system),
        )
    if not system.causes:
        return Part(text=text, undeveloped=f'none of {failed:,} failed runs was examined')
    found = [figures.cause_verdict(one) for one in system.causes]
    all_known = all(verdict is Verdict.SUPPORTED for verdict, _ in found)
    return Part(
        text=text, found=(Verdict.SUPPORTED if all_known else Verdict.UNDETERMINED,
                          '; '.join(words for _, words in found)),
        solutions=tuple(
            (f'Localisation of {len(one.found.cases):,} runs',
             f'localisation-{sources.causes.index(one) + 1}/figures') for one in system.causes
        ),
    )


def _monitor_part(sources: _Sources, system: SystemFacts) -> Part:
    text = 'What a run-time monitor of this network notices, and misses, is measured'
    if not system.monitors:
        return Part(text=text, undeveloped='no monitor was judged')
    words = '; '.join(
        f'of {one.judged.failed:,} failed runs {one.judged.in_time:,} with an alarm in time, of '
        f'{one.judged.runs - one.judged.failed:,} satisfied ones {one.judged.false_alarms:,} with '
        'an alarm' for one in system.monitors
    )
    return Part(
        text=text, found=(Verdict.SUPPORTED, words),
        solutions=tuple(
            (f'Monitor {one.options["monitor"]} in {one.judged.runs:,} scenes',
             f'monitor-{sources.monitors.index(one) + 1}/figures') for one in system.monitors
        ),
    )


def _data_part(system: SystemFacts) -> Part:
    network = system.network
    if not network.sha256:
        return Part(text='What the perception was made from is known',
                    undeveloped=network.why_unknown)
    text = f'The training data of {network.word} are known'
    if network.card is None:
        return Part(text=text, undeveloped=network.why_unknown)
    names = ', '.join(f'{one.kind} {one.name}' for one in network.card.training_data)
    return Part(
        text=text, found=(Verdict.SUPPORTED, f'{names}; seed {network.card.seed}'),
        solutions=((f'Model card, sha256 {network.card_sha256[:12]}…', f'{system.name}/card'),),
    )


def json_text(content: Mapping[str, Any]) -> str:
    """Text of ``evidence.json``, whose keys are sorted, with a checksum of itself at its end."""
    return sealed_text(content)
