"""What evidence rests on, read and bound by SHA-256: campaigns, networks, localisations, monitors.

An input whose checksums do not hold, or that cannot be bound to the campaign it is named with, is
refused by name. What an input does not say (such as the training data of somebody else's network)
is kept as unknown, with the reason.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.fault_localisation import JSON_NAME as LOCALISE_NAME
from taxinet_ros.bag.layout import bag_files
from taxinet_ros.core.assurance.switch import parts_of
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.perception.weights import (
    SUFFIX,
    ModelCard,
    card_path,
    load_card,
    weights_path,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, read_record
from taxinet_ros.files.sealed_json import file_sha256, read_sealed
from taxinet_ros.trials.doctor import examine
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign, open_campaign
from taxinet_ros.trials.past_runs.trials import SETTINGS, TRIAL
from taxinet_ros.trials.rates import Planned
from taxinet_ros.trials.record.facts import planned_runs, recorded_world
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import CSV_NAME, PARQUET_NAME

MONITOR_NAME = 'assurance.json'
"""Summary of ``taxinet assure judge``, with the digests of its runs."""
_JUDGED_OPTIONS = (
    'program', 'perception', 'controller', 'monitor', 'fallbacks', 'runs', 'seed', 'fingerprints',
)
_FILES = (RECORD_NAME, CSV_NAME, PARQUET_NAME)
"""Of a campaign."""
TRUTH = 'truth'
"""The perception without a network."""
OnBag = Callable[[Path], None]
_ID = re.compile(r'\s*([A-Za-z0-9][A-Za-z0-9_.-]*)\s*:\s+(.*\S)\s*', re.DOTALL)
_LONGEST_REQUIREMENT = 4000
_NEEDED = ('program', 'program_sha256', 'program_text', 'specs', 'perception_sha256', 'seed')
"""Facts without which runs cannot be bound to program, formula and network."""
_SYSTEM = (
    'program', 'program_sha256', 'specs', 'stop_on', 'bounds', 'rates', 'perception',
    'perception_sha256', 'controller', 'controller_sha256', 'gains', 'timing', 'overrides',
    'laid_over',
)
"""Facts that make two campaigns runs of one system, in one distribution of scenes."""


def digest_of(value: Any) -> str:
    """SHA-256 of a JSON value in its canonical form: sorted keys, no spaces, no NaN."""
    text = json.dumps(value, sort_keys=True, separators=(',', ':'), allow_nan=False)
    return text_sha256(text)


def text_sha256(text: str) -> str:
    """SHA-256 of a text in UTF-8."""
    return hashlib.sha256(text.encode()).hexdigest()


def read_requirement(given: str) -> dict[str, str]:
    """Read a requirement from a text ``ID: wording``, or from a file that contains one.

    Returns:
        ``id``, such as ``REQ-TAXI-7``; ``text``, its wording in one line; ``given``, the text as
        given; ``sha256`` of that, or of the file.
    """
    try:
        is_file = Path(given).is_file()
    except (OSError, ValueError):  # a text that is too long for a name, or has a zero
        is_file = False
    try:
        text = Path(given).read_bytes().decode() if is_file else given
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f'requirement {given}: cannot be read ({error})') from error
    return requirement_of(text, f'requirement {given:.60}')


def requirement_of(text: str, where: str) -> dict[str, str]:
    """Split a requirement ``ID: wording``; see :func:`read_requirement`."""
    found = _ID.fullmatch(text)
    if found is None or len(text) > _LONGEST_REQUIREMENT:
        raise UsageError(
            f"{where}: expected an identifier, a colon and the wording, as in 'REQ-7: The aircraft "
            f"shall …', in at most {_LONGEST_REQUIREMENT:,} characters; or a file with that"
        )
    return {
        'id': found[1], 'text': ' '.join(found[2].split()), 'given': text,
        'sha256': text_sha256(text),
    }


@dataclass(frozen=True, kw_only=True)
class CampaignInput:
    """A finished campaign whose checksums hold.

    Attributes:
        folder: its folder.
        name: name of its folder, when the evidence was written.
        recorded: its record.
        facts: its facts, with the hash of the network of its runs.
        files: SHA-256 of record and tables, by name.
        bags: SHA-256 of each run's bag by run: of the lines ``SHA-256  NAME`` of its files.
    """

    folder: Path
    name: str
    recorded: RecordedCampaign
    facts: Mapping[str, Any]
    files: Mapping[str, str]
    bags: Mapping[str, str]

    @property
    def rows(self) -> Sequence[RunRow]:
        """Its runs."""
        return self.recorded.rows

    @property
    def planned(self) -> Planned:
        """Runs planned before the first one."""
        return planned_runs(self.facts)

    @property
    def system(self) -> dict[str, Any]:
        """What it tested: program, formulas, network, controller, world, timing."""
        world, sha256 = recorded_world(self.facts)
        return {
            **{name: self.facts.get(name) for name in _SYSTEM},
            'world': world, 'world_sha256': sha256,
        }


def read_campaign(folder: Path, name: str, on_bag: OnBag) -> CampaignInput:
    """Read a finished campaign and check everything that it has checksums of.

    It is recorded under a name, or if that is '', that of its folder.
    """
    recorded = open_campaign(folder)
    facts = {**recorded.facts, 'perception_sha256': _network_of(recorded)}
    if lacking := [name for name in _NEEDED if facts.get(name) in (None, {})]:
        raise UsageError(
            f'{folder}: its record lacks {", ".join(lacking)}, so runs cannot be bound to program, '
            'formula and network; run it again with this version'
        )
    if recorded.content.unfinished or not recorded.content.finished:
        raise UsageError(f'{folder}: has not ended in order; resume it to its end')
    if not recorded.rows:
        raise UsageError(f'{folder}: has no run')
    _refuse_damaged(folder, on_bag)
    return CampaignInput(
        folder=folder, name=name or folder.resolve().name, recorded=recorded, facts=facts,
        files={file: file_sha256(folder / file) for file in _FILES},
        bags={
            row.run_id: bag_sha256(bag) for row in recorded.rows
            if (bag := recorded.bag(row)) is not None
        },
    )


def _refuse_damaged(folder: Path, on_bag: OnBag = lambda bag: None) -> None:
    """Refuse results of which a checksum does not hold."""
    if wrong := examine(folder, on_bag).findings:
        more = f' and {len(wrong) - 1} more' if len(wrong) > 1 else ''
        raise UsageError(
            f'{wrong[0].where}: {wrong[0].what}{more}; no evidence is written of damaged results: '
            f'taxinet doctor {folder}'
        )


def _network_of(recorded: RecordedCampaign) -> str | None:
    """Hash of the network of the runs: ``taxinet run`` records it with each run only."""
    named: str | None = recorded.facts.get('perception_sha256')
    used = {row.fingerprint for row in recorded.judged if row.fingerprint or not named}
    all_of_them = sorted(used | ({named} if named else set()))
    if len(all_of_them) > 1:
        listed = ', '.join(f'{one[:12]}…' if one else 'none' for one in all_of_them)
        raise UsageError(
            f'{recorded.folder}: its runs had several networks (sha256 {listed}), so there is no '
            'one system that they are runs of; run them as campaigns of their own'
        )
    return all_of_them[0] if all_of_them else named


def bag_sha256(bag: Path) -> str:
    """SHA-256 of a bag: of the lines ``SHA-256  NAME`` of its files, as ``sha256sum`` has them."""
    return text_sha256(''.join(f'{file_sha256(path)}  {path.name}\n' for path in bag_files(bag)))


def read_campaigns(
    paths: Sequence[Path], names: Sequence[str], on_bag: OnBag
) -> tuple[CampaignInput, ...]:
    """Read several campaigns, each once, under these names if there are any."""
    seen: dict[tuple[Any, ...], CampaignInput] = {}
    found = tuple(
        read_campaign(path, name, on_bag)
        for path, name in zip(paths, names or [''] * len(paths), strict=True)
    )
    for one in found:
        system = digest_of(one.system)
        for row in one.rows:
            other = seen.setdefault((system, row.run_id, *row.scene.values()), one)
            if other is not one:
                raise UsageError(
                    f'{one.folder}: has runs that are in {other.folder} too; name each once'
                )
    return found


def read_network(
    facts: Mapping[str, Any], given: Iterable[str] = ()
) -> tuple[dict[str, Any], ModelCard | None]:
    """Find the recorded network and its model card: training data, seed, command.

    A network that is gone or has changed is no error: its training data are then unknown.

    Returns:
        Its ``name``, ``sha256`` of its weights or code, None for the truth, ``card_sha256`` and
        ``why_unknown`` its data are; and its card, if it has one.
    """
    word, sha256 = str(facts['perception']), str(facts['perception_sha256'])
    shown = Path(word).name if word.endswith((SUFFIX, '.onnx')) else word
    found = {'name': shown, 'sha256': sha256 or None, 'card_sha256': None, 'why_unknown': ''}
    why = ''
    if not sha256:
        why = 'no network: the controller is given the truth' if word == TRUTH else (
            'the perception did not report a hash')
        return {**found, 'why_unknown': why}, None
    for candidate in (*given, word):
        path = weights_path(candidate)
        why = why or _why_unusable(path, sha256)
        if not _why_unusable(path, sha256):
            card = card_path(path)
            return {**found, 'card_sha256': file_sha256(card)}, load_card(card)
    return {**found, 'why_unknown': why}, None


def _why_unusable(path: Path, sha256: str) -> str:
    """Why a file and its card do not say what the network of this hash was trained on; ''."""
    if path.suffix != SUFFIX:
        return 'it is no network of taxinet train, so no model card names its data'
    if not path.is_file():
        return 'its file is not there any more; name it as perception'
    if file_sha256(path) != sha256:
        return 'its file has changed since the runs; name the former as perception'
    try:
        own = load_card(card_path(path)).weights_sha256 == sha256
    except UsageError as error:
        return f'its model card cannot be used: {error}'
    return '' if own else 'its model card describes other weights'


def usable_network(facts: Mapping[str, Any], given: Iterable[str] = ()) -> str:
    """The word or file by which the recorded perception can be loaded here."""
    word, sha256 = str(facts['perception']), str(facts['perception_sha256'])
    why = ''
    for candidate in (*given, word):
        try:
            if check_perception(candidate) == sha256:
                return candidate
            why = f'{candidate} has another SHA-256 than the network of the runs'
        except UsageError as error:
            why = str(error)
    raise UsageError(f'{why}; name the network of the runs as perception')


Results = dict[str, Any]
"""Results of another command on campaigns: ``summary``, the name of the file that has the digests
of the rest; ``files``, SHA-256 by name; ``campaigns``, ids; ``figures``, the findings."""


def read_localisation(folder: Path, campaigns: Mapping[str, CampaignInput]) -> Results:
    """Read the summary of a localisation, and find its campaign by its trials."""
    path, summary = folder / RECORD_NAME, folder / LOCALISE_NAME
    for needed in (summary, path):
        if not needed.is_file():
            raise UsageError(
                f'{folder}: no results of taxinet localize: {needed.name} is not there'
            )
    sealed = read_sealed(summary)
    if sealed.files.get(path.name) != file_sha256(path):
        raise UsageError(f'{path}: is not what {summary.name} was made from; localize again')
    entries = read_record(path)
    facts = entries.get(SETTINGS, {}).get('', {})
    runs = {trial.get('run_id') for trial in entries.get(TRIAL, {}).values()}
    found = [
        name for name, one in campaigns.items()
        if all(
            facts.get(fact) == one.facts.get(fact)
            for fact in ('program_sha256', 'seed', 'specs', 'perception_sha256')
        ) and runs and runs <= {row.run_id for row in one.recorded.counterexamples}
    ]
    if len(found) != 1:
        why = 'may be about several of these campaigns; name it with one' if found else (
            'is not about failed runs of any of these campaigns (program, seed, formulas, network '
            'and runs have to agree)'
        )
        raise UsageError(f'{folder}: {why}')
    return {
        'summary': summary.name, 'campaigns': found, 'files': {summary.name: file_sha256(summary)},
        'figures': {name: value for name, value in sealed.values.items() if name != 'made_on'},
    }


def read_monitor(folder: Path, campaigns: Mapping[str, CampaignInput]) -> Results:
    """Read the judgement of a monitor, and find the campaigns that it is about.

    Those are of the same network, without a monitor or with the same one and a judged fallback.
    """
    path = folder / MONITOR_NAME
    if not path.is_file():
        raise UsageError(f'{folder}: no results of taxinet assure judge: {path.name} is not there')
    _refuse_damaged(folder)
    sealed = read_sealed(path)
    try:
        options = {name: sealed.values['options'][name] for name in _JUDGED_OPTIONS}
        figures, digests = {**options, **sealed.values['judged']}, dict(options['fingerprints'])
        network = str(digests.pop('perception'))
    except (LookupError, TypeError, ValueError) as error:
        raise UsageError(f'{path}: is of another form ({error!r}); judge again') from error
    about = [
        name for name, one in campaigns.items()
        if network and network == one.facts['perception_sha256'] and (
            parts_of(str(one.facts.get('controller', ''))) is None
            or one.facts.get('controller_sha256') in digests.values()
        )
    ]
    if not about:
        raise UsageError(
            f'{folder}: is about network {options["perception"]} (sha256 {network[:12]}…) under '
            f'monitor {options["monitor"]} with {", ".join(options["fallbacks"])}; no campaign '
            'named here ran that network without a monitor, or with this monitor and fallback'
        )
    return {
        'summary': path.name, 'campaigns': about, 'figures': figures,
        'files': {name: file_sha256(folder / name) for name in (path.name, *sealed.files)},
    }
