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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from taxinet_ros.analysis.odd.coverage import coverage_json, odd_coverage
from taxinet_ros.analysis.runs.campaign import read_runs
from taxinet_ros.bag.layout import STORAGE_ID
from taxinet_ros.core.mtl.lint import formula_words
from taxinet_ros.core.mtl.specs import SIGNALS, parse_spec
from taxinet_ros.core.pacing.timing import is_free
from taxinet_ros.core.perception.weights import SHIPPED, ModelCard
from taxinet_ros.core.provenance import COMMIT, differences, provenance, words
from taxinet_ros.core.renderer import OURS
from taxinet_ros.core.scenario_fields import BY_KEY
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.evidence import figures
from taxinet_ros.extras.evidence.argument import mermaid, parse_argument
from taxinet_ros.extras.evidence.inputs import (
    CampaignInput,
    digest_of,
    read_campaigns,
    read_localisation,
    read_monitor,
    read_network,
    text_sha256,
)
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.files.sealed_json import file_sha256
from taxinet_ros.registry import KMWH
from taxinet_ros.scenes.overrides import scenes_words
from taxinet_ros.trials.odd.odd_file import Odd, find_odd, read_odd
from taxinet_ros.trials.options import check_new, make_out
from taxinet_ros.trials.record.facts import EXTENSIONS, WORLD, recorded_stacks

Progress = Callable[[str, int, int], None]
SCHEMA = 'taxinet-evidence-3'
JSON_NAME, PAGE_NAME, ARGUMENT_NAME, MANIFEST_NAME = (
    'evidence.json', 'evidence.html', 'argument.mmd', 'MANIFEST'
)
WORDS = (
    'This is evidence toward a requirement. It says what was run and what came out; whether that '
    'is enough is for others to decide.'
)
"""What evidence is, for page and JSON."""


def parse_claim(text: str) -> float:
    """A share as people write it: ``0.99``, ``99%`` or ``99 %``."""
    number, percent, rest = text.strip().partition('%')
    try:
        value = float(number)
    except ValueError:
        value, rest = 0.0, 'no number'
    if rest.strip():
        raise UsageError(f'claim {text}: expected a share such as 0.99 or 99%')
    return value / 100 if percent else value


class Collected(NamedTuple):
    """Evidence, ready to be written: all as JSON values, and the campaigns by their ids."""

    content: dict[str, Any]
    inputs: Mapping[str, CampaignInput]


def collect(
    campaigns: Sequence[Path], folder: Path,
    on_progress: Progress = lambda stage, done, of: None, *,
    requirement: Mapping[str, str] | None = None, claim: float | None = None,
    spec: str | None = None, odd: str | None = None, localisations: Sequence[Path] = (),
    monitors: Sequence[Path] = (), networks: Sequence[str] = (),
    recorded: Mapping[Path, str] | None = None, names: Sequence[str] = (),
) -> Collected:
    """Read all inputs and compute all figures.

    Args:
        campaigns: folders of finished campaigns.
        folder: folder of the evidence.
        on_progress: called with the stage, how much is done, and of how much.
        requirement: the requirement in words.
        claim: least share of satisfied runs that is claimed, in (0, 1).
        spec: formula that the claim and the ODD are about; None for the headline of each system.
        odd: name or file of an operational design domain.
        localisations: folders of ``taxinet localize``.
        monitors: folders of ``taxinet assure judge``.
        networks: files of networks that have moved.
        recorded: paths to record of inputs that have moved since they were recorded.
        names: names to record of the campaigns, if they have moved.

    Raises:
        UsageError: an input is refused; the line names it.
    """
    if not campaigns:
        raise UsageError('evidence: name at least one campaign')
    if claim is not None and not 0 < claim < 1:
        raise UsageError(
            f'claim {claim:g}: expected a share between 0 and 1, such as 0.99 or 99%; '
            'no number of runs shows 100 %'
        )
    bags = sum(1 for one in campaigns for _ in one.glob(f'*/*.{STORAGE_ID}'))
    done = itertools.count(1)

    def on_bag(bag: Path) -> None:
        on_progress('bags', min(next(done), bags), bags)

    def path(place: Path) -> str:
        return (recorded or {}).get(place) or os.path.relpath(place.resolve(), folder.resolve())

    domain = None if odd is None else read_odd(find_odd(odd))
    inputs = {
        f'campaign-{number}': one
        for number, one in enumerate(read_campaigns(campaigns, names, on_bag), 1)
    }
    systems: dict[str, dict[str, CampaignInput]] = {}
    for name, one in inputs.items():
        systems.setdefault(digest_of(one.system), {})[name] = one
    content: dict[str, Any] = {
        'schema': SCHEMA, 'about': WORDS, 'claim': claim, 'asked_spec': spec,
        'requirement': requirement,
        'odd': None if domain is None else _odd(domain, str(odd), path),
        'localisations': [
            {'id': f'localisation-{number}', 'path': path(each), **read_localisation(each, inputs)}
            for number, each in enumerate(localisations, 1)
        ],
        'monitors': [
            {'id': f'monitor-{number}', 'path': path(each), **read_monitor(each, inputs)}
            for number, each in enumerate(monitors, 1)
        ],
        'systems': [
            _system(f'system-{number}', own, claim, spec, networks, domain)
            for number, own in enumerate(systems.values(), 1)
        ],
        'campaigns': [
            _campaign(name, one, path) for own in systems.values() for name, one in own.items()
        ],
    }
    _refuse_repeated(content)
    content['limits'] = known_limits(content)
    content['items'] = known_items(content)
    content['argument'] = parse_argument(
        _rendered('argument.j2', content | {'record': RECORD_NAME}, finalize=_plain)
    )
    content['computed_by'] = {
        name: value for name, value in provenance().items() if name in ('taxinet_ros', COMMIT)
    }
    return Collected(
        content=json.loads(json.dumps(content, sort_keys=True, allow_nan=False)), inputs=inputs,
    )


def _refuse_repeated(content: Mapping[str, Any]) -> None:
    for option, key, part, why in (
        ('localize', 'localisations', 'campaigns', 'about the same campaign'),
        ('monitor_table', 'monitors', 'figures', 'the same judgement'),
    ):
        each = [digest_of(one[part]) for one in content[key]]
        if len(set(each)) != len(each):
            raise UsageError(f'{option}: two are {why}; name one of them')


def _odd(domain: Odd, word: str, path: Callable[[Path], str]) -> dict[str, Any]:
    file, sha256 = Path(word), file_sha256(find_odd(word))
    shipped = not file.is_file()  # and found by its name
    return {
        'id': 'odd', 'name': domain.name, 'source': domain.source, 'sha256': sha256,
        'given': file.name, 'path': '' if shipped else path(file.parent),
        'files': {} if shipped else {file.name: sha256},
    }


def _system(
    name: str, own: Mapping[str, CampaignInput], claim: float | None, asked_spec: str | None,
    networks: Sequence[str], domain: Odd | None,
) -> dict[str, Any]:
    """Campaigns of one program, formula, network, …, whose figures are added up."""
    inputs = list(own.values())
    first, facts = inputs[0], inputs[0].facts
    spec = _spec(asked_spec, first)
    network, card = read_network(facts, networks)
    counts = figures.counts_json(inputs, list(facts['specs']))
    formula = next(one for one in counts['formulas'] if one['formula'] == spec)
    verdict = None if claim is None else figures.claim_verdict(formula, claim)
    simulator, camera = world_and_camera(first.system['world'])
    timing = str(facts.get('timing', ''))
    stacks = [stack for one in inputs for stack in recorded_stacks(one.facts).values()]
    return {
        'id': name, 'sha256': digest_of(first.system),
        'program': {
            'name': facts['program'], 'sha256': facts['program_sha256'],
            'text': facts['program_text'],
            'overrides': {**facts.get('laid_over', {}), **facts.get('overrides', {})},
        },
        'formulas': [_formula(*named) for named in facts['specs'].items()],
        'headline': spec,
        'assumptions': {name: facts.get(name, []) for name in ('stop_on', 'bounds', 'rates')},
        'network': {
            **network, 'shipped': network['name'] in SHIPPED,
            'training': None if card is None else _training(card, inputs),
        },
        'controller': {
            'name': facts.get('controller', ''), 'sha256': facts.get('controller_sha256') or None,
            'gains': facts.get('gains', {}),
        },
        'world': {
            'name': first.system['world'], 'sha256': first.system['world_sha256'] or None,
            'simulator': simulator, 'camera': camera, 'recorded': WORLD in facts,
            'own': (simulator, camera) == (KMWH, OURS),
        },
        'timing': timing, 'free': is_free(timing), 'extensions': facts.get(EXTENSIONS, {}),
        'stacks_differ': differences(*stacks), 'campaigns': list(own),
        'figures': counts,
        'odd': None if domain is None else coverage_json(odd_coverage(
            domain, [replace(read_runs(one.folder, spec), label=one.name) for one in inputs],
            limit=None if claim is None else 1 - claim,
        )),
        'claim': None if verdict is None else {
            'target': claim, 'formula': spec, 'verdict': verdict[0].value, 'why': verdict[1],
        },
    }


def _spec(wanted: str | None, one: CampaignInput) -> str:
    known = list(one.facts['specs'])
    if wanted is not None and wanted not in known:
        raise UsageError(
            f'spec {wanted}: not judged in {one.folder}; known: {", ".join(known)}'
        )
    return wanted or str(known[0])


def _formula(name: str, text: str) -> dict[str, str]:
    formula = parse_spec(f'{name}={text}').formula
    return {
        'name': name, 'text': text, 'sha256': text_sha256(f'{name}={text}'),
        'words': formula_words(formula, SIGNALS),
    }


def _training(card: ModelCard, inputs: Sequence[CampaignInput]) -> dict[str, Any]:
    ours = {sha256 for one in inputs for sha256 in one.files.values()}
    return {
        **{
            name: [{'kind': one.kind, 'name': one.name, 'sha256': one.sha256} for one in sources]
            for name, sources in (
                ('data', card.training_data), ('validation', card.validation_data),
            )
        },
        'on_these_runs': any(
            one.kind == 'runs' and one.sha256 in ours for one in card.training_data
        ),
        'seed': card.seed, 'images': card.images, 'start_sha256': card.start_sha256,
        'command': card.command_line, 'date': card.date, 'package_version': card.package_version,
        'errors': {name: dict(values) for name, values in card.errors.items()},
    }


def _campaign(name: str, one: CampaignInput, path: Callable[[Path], str]) -> dict[str, Any]:
    facts, judged = one.facts, one.recorded.judged
    return {
        'id': name, 'name': one.name, 'path': path(one.folder), 'files': dict(one.files),
        'seed': facts['seed'], 'sampler': str(facts.get('sampler', '')),
        'planned': facts.get('first_runs', facts.get('runs')),
        'engine': str(facts.get('engine', '')), 'audit_percent': facts.get('audit_percent'),
        'images': str(facts.get('images', '')), 'warnings': list(facts.get('warnings', ())),
        'judged': len(judged), 'passed_blind': sum(row.passed_blind for row in one.rows),
        'judged_without_bag': sum(row.run_id not in one.bags for row in judged),
        'bags': {'sha256': digest_of(dict(one.bags)) if one.bags else None, 'each': dict(one.bags)},
        'stacks': {key: dict(stack) for key, stack in recorded_stacks(facts).items()},
        'figures': figures.counts_json([one], list(facts['specs'])),
    }


def known_limits(content: Mapping[str, Any]) -> list[dict[str, str]]:
    """All limits, from ``limits.j2``: first those of these inputs, then the fixed ones.

    Each has the id of what it is about, '' for everything; and its source, ``fixed``, or ``inputs``
    if it follows from a fact of these inputs.
    """
    found, at = [], ''
    for line in _rendered('limits.j2', content, finalize=_plain).splitlines():
        if line.startswith('@'):
            at = line.removeprefix('@')
        elif line:
            name, _, text = line.partition(': ')
            fixed = at == 'fixed'
            found.append({
                'id': name, 'about': '' if fixed else at, 'words': text,
                'source': 'fixed' if fixed else 'inputs',
            })
    return found


def known_items(content: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Everything that evidence rests on by id, from ``items.j2``: its hash, or why it has none."""
    found = {}
    for line in filter(None, _rendered('items.j2', content, finalize=_plain).splitlines()):
        name, kind, rest = line.split('|', 2)
        shown, sha256, why = rest.rsplit('|', 2)
        found[name] = {
            'kind': kind, 'name': shown, 'sha256': sha256 or None, 'why_unknown': why,
        }
    return found


# Folder ------------------------------------------------------------------------------------------


def make_evidence(
    campaigns: Sequence[Path], out: Path,
    on_progress: Progress = lambda stage, done, of: None, **asked: Any,
) -> Collected:
    """Collect evidence and write its folder, whole or not at all.

    Arguments as of :func:`collect`.
    """
    check_new(out)
    found = collect(campaigns, out, on_progress, **asked)
    make_out(out.absolute().parent)
    with tempfile.TemporaryDirectory(prefix=f'.{out.name}-', dir=out.absolute().parent) as scratch:
        draft = Path(scratch) / out.name
        draft.mkdir()
        text = json.dumps(found.content, indent=2, sort_keys=True, allow_nan=False)
        write_atomically(draft / JSON_NAME, f'{text}\n')
        write_atomically(draft / ARGUMENT_NAME, mermaid(found.content['argument']))
        write_atomically(draft / PAGE_NAME, _rendered('page.html', found.content, autoescape=True))
        write_atomically(draft / MANIFEST_NAME, manifest_text(draft))
        shutil.move(draft, out)
    return found


def _rendered(template: str, content: Mapping[str, Any], **options: Any) -> str:
    """A template beside this file with the content; an unknown name is an error."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, **options,
    )
    environment.globals['interval'] = figures.interval_words
    environment.filters |= {
        'about': _about, 'stem': lambda path: Path(path).stem, 'scenes': scenes_words,
        'digest': digest_of, 'stack': words,
        'source': lambda one: f'{one["kind"]} {one["name"]}',
        'labels': lambda keys: ', '.join(BY_KEY[key].label for key in keys),
        'sentence': lambda text: f'{str(text).rstrip(".")}.',
        'percent': lambda share, digits=2: (
            '' if share is None else f'{100 * share:.{digits}f}'
        ),
    }
    return environment.get_template(template).render(content)


def _about(
    results: Sequence[Mapping[str, Any]], system: Mapping[str, Any]
) -> list[Mapping[str, Any]]:
    """Those of the results that are about a campaign of a system."""
    return [one for one in results if set(one['campaigns']) & set(system['campaigns'])]


def _plain(value: Any) -> str:
    """A value in one line of text, numbers with commas."""
    return f'{value:,}' if type(value) is int else ' '.join(str(value).split())


def manifest_text(folder: Path) -> str:
    """Text of the manifest, for ``sha256sum -c``: every file of a folder but itself, by name."""
    return ''.join(
        f'{file_sha256(path)}  {path.name}\n' for path in sorted(folder.iterdir())
        if path.name != MANIFEST_NAME
    )
