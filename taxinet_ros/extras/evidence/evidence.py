"""Evidence as one document: collected from its inputs, and written as page, JSON and argument.

The content is a function of the inputs alone: nothing of the clock, of this machine or of the order
of files is in it. :func:`collect` is used twice: to write, and by :mod:`.verify` to compute
everything again.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from taxinet_ros.analysis.odd.coverage import coverage_json
from taxinet_ros.bag.layout import STORAGE_ID
from taxinet_ros.campaign.odd.odd_file import Odd, find_odd, read_odd
from taxinet_ros.campaign.options import check_new, make_out
from taxinet_ros.campaign.record.facts import recorded_stacks
from taxinet_ros.campaign.scenes.overrides import scenes_words
from taxinet_ros.core.mtl.lint import formula_words
from taxinet_ros.core.mtl.specs import SIGNALS, parse_spec
from taxinet_ros.core.perception.weights import ModelCard
from taxinet_ros.core.provenance import COMMIT, provenance, words
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.evidence import figures
from taxinet_ros.extras.evidence.argument import (
    Goal,
    Reference,
    argument_values,
    mermaid,
    open_goal,
    shown,
    whole,
)
from taxinet_ros.extras.evidence.figures import Verdict
from taxinet_ros.extras.evidence.inputs import (
    CampaignInput,
    OnBag,
    Requirement,
    ResultsInput,
    digest_of,
    read_campaigns,
    read_localisation,
    read_monitor,
    read_network,
    read_requirement,
    text_sha256,
)
from taxinet_ros.extras.evidence.limits import WORDS, SystemFacts, known_limits
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.files.sealed_json import file_sha256

SCHEMA = 'taxinet-evidence-2'
JSON_NAME, PAGE_NAME, ARGUMENT_NAME, MANIFEST_NAME = (
    'evidence.json', 'evidence.html', 'argument.mmd', 'MANIFEST'
)


@dataclass(frozen=True, kw_only=True)
class EvidenceOptions:
    """What evidence is asked for.

    Attributes:
        campaigns: folders of finished campaigns.
        requirement: ``ID: wording``, or a file with that; None for none.
        claim: least share of satisfied runs that is claimed, in (0, 1); None for none.
        spec: formula that the claim and the ODD are about; None for the headline of each system.
        odd: name or file of an operational design domain; None for none.
        localisations: folders of ``taxinet localize``.
        monitors: folders of ``taxinet assure judge``.
        networks: files of networks that have moved.

    Raises:
        UsageError: no campaign, or a claim that is no share.
    """

    campaigns: tuple[Path, ...]
    requirement: str | None = None
    claim: float | None = None
    spec: str | None = None
    odd: str | None = None
    localisations: tuple[Path, ...] = ()
    monitors: tuple[Path, ...] = ()
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
        inputs: the campaigns by their ids.
    """

    content: dict[str, Any]
    inputs: Mapping[str, CampaignInput]


@dataclass(frozen=True, kw_only=True)
class _Sources:
    """All inputs, read and checked, and where they are by their folder or file."""

    options: EvidenceOptions
    requirement: Requirement | None
    campaigns: tuple[CampaignInput, ...]
    odd: Odd | None
    causes: tuple[ResultsInput, ...]
    monitors: tuple[ResultsInput, ...]
    folder: Path
    recorded: Mapping[Path, str]

    def path(self, path: Path) -> str:
        """Path of an input relative to the evidence."""
        return self.recorded.get(path) or os.path.relpath(path.resolve(), self.folder.resolve())


def collect(
    options: EvidenceOptions, folder: Path, *, requirement: Requirement | None = None,
    recorded: Mapping[Path, str] | None = None, names: Sequence[str] = (),
    on_bag: OnBag = lambda bag: None,
) -> Collected:
    """Read all inputs and compute all figures.

    Args:
        options: what is asked for.
        folder: folder of the evidence, to which paths of inputs are relative.
        requirement: the requirement as read before, instead of that of the options.
        recorded: paths to record of inputs that have moved.
        names: names to record of the campaigns, if they have moved.
        on_bag: called with each bag before it is checked.

    Raises:
        UsageError: an input is refused; the line names it.
    """
    if requirement is None and options.requirement is not None:
        requirement = read_requirement(options.requirement)
    odd = read_odd(find_odd(options.odd)) if options.odd is not None else None
    campaigns = read_campaigns(options.campaigns, on_bag)
    if names:
        campaigns = tuple(
            replace(one, name=name) for one, name in zip(campaigns, names, strict=True)
        )
    sources = _Sources(
        options=options, requirement=requirement, campaigns=campaigns, odd=odd,
        causes=tuple(read_localisation(path, campaigns) for path in options.localisations),
        monitors=tuple(read_monitor(path, campaigns) for path in options.monitors),
        folder=folder, recorded=recorded or {},
    )
    if len({one.campaigns for one in sources.causes}) != len(sources.causes):
        raise UsageError('--localize: two are about the same campaign; name one of them')
    if len({digest_of(one.figures) for one in sources.monitors}) != len(sources.monitors):
        raise UsageError('--monitor-table: two are the same judgement; name one of them')
    systems = _systems(sources)
    content = _content(sources, systems)
    limits = known_limits(
        systems, requirement=requirement is not None, claim=options.claim is not None
    )
    content['limits'] = [one._asdict() for one in limits]
    content['items'] = {item.pop('id'): item for item in _items(content)}
    content['argument'] = argument_values(_argument(sources, systems, content))
    content['computed_by'] = {
        name: value for name, value in provenance().items() if name in ('taxinet_ros', COMMIT)
    }
    return Collected(
        content=json.loads(json.dumps(content, sort_keys=True, allow_nan=False)),
        inputs={name: one for system in systems for name, one in system.campaigns},
    )


def _systems(sources: _Sources) -> tuple[SystemFacts, ...]:
    """Campaigns of one program, formula, network, … together, in the order given."""
    groups: dict[str, list[tuple[str, CampaignInput]]] = {}
    for number, one in enumerate(sources.campaigns, 1):
        groups.setdefault(digest_of(one.system), []).append((f'campaign-{number}', one))
    claim, found = sources.options.claim, []

    def about(
        inputs: Sequence[CampaignInput], results: Sequence[ResultsInput]
    ) -> tuple[ResultsInput, ...]:
        return tuple(
            one for one in results if any(sources.campaigns[at] in inputs for at in one.campaigns)
        )

    for number, members in enumerate(groups.values(), 1):
        inputs = [one for _, one in members]
        facts, spec = inputs[0].facts, _spec(sources.options.spec, inputs[0])
        found.append(SystemFacts(
            name=f'system-{number}', spec=spec, campaigns=tuple(members),
            network=read_network(facts, sources.options.networks),
            coverage=None if sources.odd is None else figures.domain_of(
                inputs, sources.odd, spec, None if claim is None else 1 - claim,
            ),
            causes=about(inputs, sources.causes), monitors=about(inputs, sources.monitors),
        ))
    return tuple(found)


def _spec(wanted: str | None, one: CampaignInput) -> str:
    known = list(one.facts['specs'])
    if wanted is not None and wanted not in known:
        raise UsageError(
            f'--spec {wanted}: not judged in {one.folder}; known: {", ".join(known)}'
        )
    return wanted or str(known[0])


# Values ------------------------------------------------------------------------------------------


def _content(sources: _Sources, systems: Sequence[SystemFacts]) -> dict[str, Any]:
    requirement, odd, options = sources.requirement, sources.odd, sources.options
    ids = {one.folder: name for system in systems for name, one in system.campaigns}

    def results(kind: str, found: Sequence[ResultsInput]) -> list[dict[str, Any]]:
        return [
            {
                'id': f'{kind}-{number}', 'path': sources.path(one.folder),
                'files': dict(one.files), 'figures': dict(one.figures),
                'campaigns': [ids[sources.campaigns[at].folder] for at in one.campaigns],
            } for number, one in enumerate(found, 1)
        ]

    return {
        'schema': SCHEMA, 'about': WORDS,
        'requirement': None if requirement is None else {
            'id': requirement.name, 'text': requirement.text, 'given': requirement.given,
            'sha256': requirement.sha256,
        },
        'claim': options.claim, 'asked_spec': options.spec,
        'systems': [_system(one, options.claim) for one in systems],
        'campaigns': [
            _campaign(sources, name, one) for system in systems for name, one in system.campaigns
        ],
        'odd': None if odd is None or options.odd is None else _odd(sources, odd, options.odd),
        'localisations': results('localisation', sources.causes),
        'monitors': results('monitor', sources.monitors),
    }


def _odd(sources: _Sources, odd: Odd, word: str) -> dict[str, Any]:
    file, sha256 = Path(word), file_sha256(find_odd(word))
    shipped = not file.is_file()  # and found by its name
    return {
        'id': 'odd', 'name': odd.name, 'source': odd.source, 'sha256': sha256, 'given': file.name,
        'path': '' if shipped else sources.path(file.parent),
        'files': {} if shipped else {file.name: sha256},
    }


def _system(system: SystemFacts, claim: float | None) -> dict[str, Any]:
    first, network = system.inputs[0], system.network
    facts, rates = first.facts, figures.formula_rates(system.inputs, system.spec)
    verdict = None if claim is None else figures.claim_verdict(rates, claim)
    return {
        'id': system.name, 'sha256': digest_of(first.system),
        'program': {
            'name': facts['program'], 'sha256': facts['program_sha256'],
            'text': facts['program_text'],
            'overrides': {**facts.get('laid_over', {}), **facts.get('overrides', {})},
        },
        'formulas': [_formula(name, text) for name, text in facts['specs'].items()],
        'headline': system.spec,
        'assumptions': {name: facts.get(name, []) for name in ('stop_on', 'bounds', 'rates')},
        'network': {
            'name': network.word, 'sha256': network.sha256 or None,
            'card_sha256': network.card_sha256 or None, 'why_unknown': network.why_unknown,
            'training': None if network.card is None else _training(network.card),
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
        'figures': figures.counts_json(system.inputs, list(facts['specs'])),
        'odd': None if system.coverage is None else coverage_json(system.coverage),
        'claim': None if verdict is None else {
            'target': claim, 'formula': system.spec, 'verdict': verdict[0].value,
            'why': verdict[1],
        },
    }


def _formula(name: str, text: str) -> dict[str, str]:
    formula = parse_spec(f'{name}={text}').formula
    return {
        'name': name, 'text': text, 'sha256': text_sha256(f'{name}={text}'),
        'words': formula_words(formula, SIGNALS),
    }


def _training(card: ModelCard) -> dict[str, Any]:
    return {
        **{
            name: [{'kind': one.kind, 'name': one.name, 'sha256': one.sha256} for one in sources]
            for name, sources in (
                ('data', card.training_data), ('validation', card.validation_data),
            )
        },
        'seed': card.seed, 'images': card.images, 'start_sha256': card.start_sha256,
        'command': card.command_line, 'date': card.date, 'package_version': card.package_version,
        'errors': {name: dict(values) for name, values in card.errors.items()},
    }


def _campaign(sources: _Sources, name: str, one: CampaignInput) -> dict[str, Any]:
    facts = one.facts
    return {
        'id': name, 'name': one.name, 'path': sources.path(one.folder), 'files': dict(one.files),
        'seed': facts['seed'], 'sampler': str(facts.get('sampler', '')),
        'planned': facts.get('first_runs', facts.get('runs')),
        'engine': str(facts.get('engine', '')), 'audit_percent': facts.get('audit_percent'),
        'images': str(facts.get('images', '')),
        'bags': {'sha256': digest_of(dict(one.bags)) if one.bags else None, 'each': dict(one.bags)},
        'stacks': {key: dict(stack) for key, stack in recorded_stacks(facts).items()},
        'figures': figures.counts_json([one], list(facts['specs'])),
    }


def _items(content: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Everything that evidence rests on, each with its hash or why it has none."""
    requirement, odd = content['requirement'], content['odd']
    yield _item('requirement', 'requirement', requirement['id'] if requirement else 'unknown',
                requirement and requirement['sha256'], 'no wording was given')
    for system in content['systems']:
        yield from _system_items(system)
    if odd:
        yield _item('odd', 'operational design domain', odd['name'], odd['sha256'])
    for one in content['campaigns']:
        name = one['id']
        for key, stack in one['stacks'].items():
            yield _item(f'{name}/versions/{key}', 'tool versions', words(stack), digest_of(stack))
        if not one['stacks']:
            yield _item(f'{name}/versions', 'tool versions', 'unknown')
        yield _item(f'{name}/bags', 'recordings', f'{len(one["bags"]["each"]):,} bags',
                    one['bags']['sha256'], 'the runs were made without bags, or these are gone')
    for one in (*content['campaigns'], *content['localisations'], *content['monitors']):
        for file, sha256 in one['files'].items():
            yield _item(f'{one["id"]}/{file}', 'record', f'{one.get("name", one["path"])}/{file}',
                        sha256)
    yield _item('limits', 'known limits', f'{len(content["limits"])} known limits',
                digest_of(content['limits']))


def _item(
    name: str, kind: str, shown_name: str, sha256: str | None = None, why: str = 'not recorded'
) -> dict[str, Any]:
    return {
        'id': name, 'kind': kind, 'name': shown_name, 'sha256': sha256,
        'why_unknown': '' if sha256 else why,
    }


def _system_items(system: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    name, network, program = system['id'], system['network'], system['program']
    yield _item(f'{name}/program', 'program', f'{program["name"]} with all it imports',
                program['sha256'])
    for formula in system['formulas']:
        yield _item(f'{name}/formula/{formula["name"]}', 'formula', formula['name'],
                    formula['sha256'])
    why = network['why_unknown'] or 'not recorded'
    yield _item(f'{name}/network', 'network', network['name'], network['sha256'], why)
    yield _item(f'{name}/card', 'model card', network['name'], network['card_sha256'], why)
    training = network['training']
    if training is None:
        yield _item(f'{name}/data', 'training data', 'unknown', None, why)
    else:
        for key in ('data', 'validation'):
            what = 'training data' if key == 'data' else 'validation data'
            for number, source in enumerate(training[key], 1):
                yield _item(f'{name}/{key}-{number}', what, f'{source["kind"]} {source["name"]}',
                            source['sha256'])
    shipped = 'part of the package, whose version and commit are recorded'
    for part in ('controller', 'world'):
        yield _item(f'{name}/{part}', part, system[part]['name'], system[part]['sha256'], shipped)
    yield _item(f'{name}/figures', 'figures', f'figures of {name}', digest_of(system['figures']))
    if system['odd'] is not None:
        yield _item(f'{name}/odd', 'figures', f'coverage by {name}', digest_of(system['odd']))


# Argument ----------------------------------------------------------------------------------------


def _argument(
    sources: _Sources, systems: Sequence[SystemFacts], content: Mapping[str, Any]
) -> Goal:
    requirement, odd = sources.requirement, sources.odd
    context = []
    if requirement is not None:
        context.append(Reference(f'Requirement {requirement.name}', 'requirement'))
    if odd is not None:
        context.append(Reference(f'ODD {odd.name}', 'odd'))
    return whole(
        f'Evidence toward {requirement.name}: {requirement.text}' if requirement is not None
        else 'Evidence toward the formula: no wording of a requirement was given',
        [
            _system_goal(sources, one, values)
            for one, values in zip(systems, content['systems'], strict=True)
        ],
        [*context, Reference(f'{len(content["limits"])} known limits', 'limits')],
        assumptions=[Reference('What is true of the simulated world, camera and weather is true '
                               'of the real ones')],
        strategy='Argue over each system that was run: program, formula, network, controller, '
        'world; by rates of runs that the program itself drew, with exact 95 % intervals',
    )


def _system_goal(sources: _Sources, system: SystemFacts, values: Mapping[str, Any]) -> Goal:
    name, network, program = system.name, system.network, values['program']
    formula = next(one for one in values['formulas'] if one['name'] == system.spec)
    seen = f'network {network.word}' if network.sha256 else network.word
    seen = f'{seen[:1].upper()}{seen[1:]}'
    return whole(
        f'{seen} with controller {values["controller"]["name"]} satisfies {system.spec} in the '
        f'scenes of {scenes_words(program["name"], program["overrides"])}',
        [
            _rate_goal(sources.options.claim, system), _domain_goal(system),
            _cause_goal(sources, system), _monitor_goal(sources, system), _data_goal(system),
            shown('Every figure rests on recorded runs that are bound by hash',
                  _records_verdict(system), *_ledgers(system)),
        ],
        [
            Reference(f'Program {program["name"]}', f'{name}/program'),
            Reference(f'{formula["name"]}: {formula["words"]}', f'{name}/formula/{system.spec}'),
            Reference(seen if network.sha256 else f'{seen}, no hash', f'{name}/network'),
        ],
    )


def _rate_goal(claim: float | None, system: SystemFacts) -> Goal:
    rates = figures.formula_rates(system.inputs, system.spec)
    known = 'How often the formula is satisfied is known'
    if not rates.satisfied.drawn:
        return open_goal(known, rates.satisfied.why_not)
    solution = Reference(
        f'{rates.satisfied.drawn:,} runs drawn by the program', f'{system.name}/figures'
    )
    if claim is not None:
        return shown(
            f'Runs drawn by the program satisfy {system.spec} in at least '
            f'{figures.percent(claim)} %', figures.claim_verdict(rates, claim), solution,
        )
    share = rates.satisfied.drawn_hits / rates.satisfied.drawn
    why = f'{100 * share:.4g} % satisfied, 95 %: {figures.interval_words(*rates.ends)}'
    return shown(known, (Verdict.SUPPORTED, why), solution)


def _domain_goal(system: SystemFacts) -> Goal:
    if system.coverage is None:
        return open_goal('The runs cover the operational design domain', 'no domain was given')
    return shown(
        f'The runs cover every feasible pair of conditions of the ODD {system.coverage.odd.name}',
        figures.domain_verdict(system.coverage), Reference('Coverage', f'{system.name}/odd'),
    )


def _cause_goal(sources: _Sources, system: SystemFacts) -> Goal:
    failed = sum(len(one.recorded.counterexamples) for one in system.inputs)
    if not failed:
        return shown('There is no failed run to attribute', (
            (Verdict.SUPPORTED, 'none of the judged runs failed') if _judged(system)
            else (Verdict.UNDETERMINED, 'no run was judged')
        ), *_ledgers(system))
    text = 'Each failed run that was examined is attributed to a part of the system'
    if not system.causes:
        return open_goal(text, f'none of {failed:,} failed runs was examined')
    found = [figures.cause_verdict(one) for one in system.causes]
    known = all(verdict is Verdict.SUPPORTED for verdict, _ in found)
    return shown(
        text,
        (Verdict.SUPPORTED if known else Verdict.UNDETERMINED, '; '.join(why for _, why in found)),
        *(
            Reference(f'Localisation of {one.figures["looked_into"]:,} runs',
                      f'localisation-{sources.causes.index(one) + 1}/{next(iter(one.files))}')
            for one in system.causes
        ),
    )


def _monitor_goal(sources: _Sources, system: SystemFacts) -> Goal:
    text = 'What a run-time monitor of this network notices, and misses, is measured'
    if not system.monitors:
        return open_goal(text, 'no monitor was judged')
    words = '; '.join(
        f'of {one["failed"]:,} failed runs {one["in_time"]:,} with an alarm in time, of '
        f'{one["runs"] - one["failed"]:,} satisfied ones {one["false_alarms"]:,} with an alarm'
        for one in (each.figures for each in system.monitors)
    )
    return shown(text, (Verdict.SUPPORTED, words), *(
        Reference(f'Monitor {one.figures["monitor"]} in {one.figures["runs"]:,} scenes',
                  f'monitor-{sources.monitors.index(one) + 1}/{next(iter(one.files))}')
        for one in system.monitors
    ))


def _data_goal(system: SystemFacts) -> Goal:
    network = system.network
    if not network.sha256:
        return open_goal('What the perception was made from is known', network.why_unknown)
    text = f'The training data of {network.word} are known'
    if network.card is None:
        return open_goal(text, network.why_unknown)
    names = ', '.join(f'{one.kind} {one.name}' for one in network.card.training_data)
    return shown(text, (Verdict.SUPPORTED, f'{names}; seed {network.card.seed}'),
                 Reference('Model card', f'{system.name}/card'))


def _judged(system: SystemFacts) -> int:
    return sum(len(one.recorded.judged) for one in system.inputs)


def _records_verdict(system: SystemFacts) -> tuple[Verdict, str]:
    """Whether every judged run has a bag here that was checked, and a sentence on it."""
    judged = _judged(system)
    if not judged:
        return Verdict.UNDETERMINED, 'ledger and tables were checked; no run was judged'
    read = sum(row.run_id in one.bags for one in system.inputs for row in one.recorded.judged)
    if read == judged:
        return Verdict.SUPPORTED, 'ledger, tables and bags were checked'
    return Verdict.UNDETERMINED, (
        f'ledger and tables were checked, and the bags of {read:,} of {judged:,} judged runs; the '
        'others are not here'
    )


def _ledgers(system: SystemFacts) -> list[Reference]:
    return [
        Reference(f'Record of {one.name}', f'{name}/{RECORD_NAME}')
        for name, one in system.campaigns
    ]


# Folder ------------------------------------------------------------------------------------------


def make_evidence(
    options: EvidenceOptions, out: Path, *,
    on_progress: Callable[[str, int, int], None] = lambda stage, done, of: None,
) -> Collected:
    """Collect evidence and write its folder, whole or not at all.

    Args:
        options: what is asked for.
        out: its folder, which is new.
        on_progress: called with the stage, what is done of it, and how much there is.

    Returns:
        The evidence.

    Raises:
        UsageError: an input is refused, or the folder is not new.
        OSError: it cannot be written.
    """
    check_new(out)
    bags = sum(1 for folder in options.campaigns for _ in folder.glob(f'*/*.{STORAGE_ID}'))
    done = itertools.count(1)
    found = collect(
        options, out, on_bag=lambda bag: on_progress('bags', min(next(done), bags), bags)
    )
    make_out(out.absolute().parent)
    with tempfile.TemporaryDirectory(prefix=f'.{out.name}-', dir=out.absolute().parent) as scratch:
        draft = Path(scratch) / out.name
        draft.mkdir()
        write_evidence(found.content, draft)
        shutil.move(draft, out)
    return found


def write_evidence(content: Mapping[str, Any], folder: Path) -> None:
    """Write all files of evidence into an existing folder, the manifest last.

    Raises:
        OSError: it cannot be written.
    """
    text = json.dumps(content, indent=2, sort_keys=True, allow_nan=False)
    write_atomically(folder / JSON_NAME, f'{text}\n')
    write_atomically(folder / ARGUMENT_NAME, mermaid(content['argument']))
    write_atomically(folder / PAGE_NAME, _page(content))
    write_atomically(folder / MANIFEST_NAME, manifest_text(folder))


def _page(content: Mapping[str, Any]) -> str:
    """The page; everything is escaped, an unknown name is an error."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )
    environment.filters['percent'] = lambda share, digits=2: (
        '' if share is None else f'{100 * share:.{digits}f}'
    )
    environment.globals['interval'] = figures.interval_words
    return environment.get_template('page.html').render(content)


def manifest_text(folder: Path) -> str:
    """Text of the manifest, for ``sha256sum -c``: every file of a folder but itself, by name."""
    return ''.join(
        f'{file_sha256(path)}  {path.name}\n' for path in sorted(folder.iterdir())
        if path.name != MANIFEST_NAME
    )
