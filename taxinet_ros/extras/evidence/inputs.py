"""What evidence rests on, read and bound by SHA-256: campaigns, networks, localisations, monitors.

Nothing is taken on trust: an input whose checksums do not hold, or that cannot be bound to the
campaign it is named with, is refused by name. What an input does not say (such as the training data
of somebody else's network) is kept as unknown, with the reason.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from taxinet_ros.analysis.fault_localisation import JSON_NAME as LOCALISE_NAME
from taxinet_ros.analysis.fault_localisation import Localisation, localisation_of
from taxinet_ros.bag.layout import bag_files
from taxinet_ros.campaign.doctor import examine
from taxinet_ros.campaign.odd.odd_file import Odd, find_odd, read_odd
from taxinet_ros.campaign.past_runs.localisation import TRIALS_NAME, Trial
from taxinet_ros.campaign.past_runs.recorded_campaign import RecordedCampaign, open_campaign
from taxinet_ros.campaign.rates import Planned
from taxinet_ros.campaign.record.facts import FACTS_NAME, LEDGER_NAME, read_facts, recorded_world
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.shard import planned_runs
from taxinet_ros.campaign.record.table import CSV_NAME, PARQUET_NAME
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.perception.substituted import AS_RECORDED
from taxinet_ros.core.perception.weights import (
    SUFFIX,
    ModelCard,
    card_path,
    load_card,
    weights_path,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.assurance.judge import ALARMS_NAME, RESULT_NAME, Judged, read_judged
from taxinet_ros.extras.assurance.judge import TRIALS_NAME as MONITOR_TRIALS_NAME
from taxinet_ros.files.journal import JournalEnd, damaged_line, lost_end, parse_journal
from taxinet_ros.files.sealed_json import file_sha256, read_sealed

TRUTH = 'truth'
"""The perception without a network."""
_ID = re.compile(r'\s*([A-Za-z0-9][A-Za-z0-9_.-]*)\s*:\s+(.*\S)\s*', re.DOTALL)
_LONGEST_REQUIREMENT = 4000
_MOST_BYTES = 4 * _LONGEST_REQUIREMENT + 4
_JOINERS = '\u00ad\u200c\u200d\u200e\u200f'
"""Invisible signs that the writing of some languages needs."""
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
    return hashlib.sha256(text.encode()).hexdigest()


def text_sha256(text: str) -> str:
    """SHA-256 of a text in UTF-8."""
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, kw_only=True, slots=True)
class Requirement:
    """A requirement in words.

    Attributes:
        name: its identifier, such as ``REQ-TAXI-7``.
        text: its wording, in one line.
        given: the whole text as given.
    """

    name: str
    text: str
    given: str

    @property
    def sha256(self) -> str:
        """SHA-256 of the text as given; of a file, that of its bytes."""
        return text_sha256(self.given)


def read_requirement(given: str) -> Requirement:
    """Read a requirement from a text ``ID: wording``, or from a file that contains one.

    Raises:
        UsageError: it has no identifier or no wording, or the file cannot be read.
    """
    path = Path(given)
    if not _is_file(path):
        return requirement_of(given, f'--requirement {given:.60}')
    try:
        with path.open('rb') as file:
            data = file.read(_MOST_BYTES)
        text = data.decode('utf-8', 'ignore' if len(data) == _MOST_BYTES else 'strict')
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f'--requirement {given}: cannot be read ({error})') from error
    return requirement_of(text, f'--requirement {given}')


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a text that is too long for a name, or has a zero
        return False


def requirement_of(text: str, where: str) -> Requirement:
    """Split a requirement ``ID: wording``.

    Args:
        text: the whole text.
        where: beginning of the error message.

    Raises:
        UsageError: it has no identifier or no wording, or is too long.
    """
    if hidden := next((sign for sign in text if _is_hidden(sign)), ''):
        raise UsageError(
            f'{where}: contains {hidden!a}, which cannot be seen or reorders what is seen; '
            'remove it'
        )
    found = _ID.fullmatch(text)
    if found is None or len(text) > _LONGEST_REQUIREMENT:
        raise UsageError(
            f"{where}: expected an identifier, a colon and the wording, as in 'REQ-7: The aircraft "
            f"shall …', in at most {_LONGEST_REQUIREMENT:,} characters; or a file with that"
        )
    return Requirement(name=found[1], text=' '.join(found[2].split()), given=text)


def _is_hidden(sign: str) -> bool:
    """Whether a sign is no text, or makes a text read otherwise than it is written."""
    return not (sign.isprintable() or sign.isspace() or sign in _JOINERS)


class Place(NamedTuple):
    """What evidence says of where an input was.

    Attributes:
        path: relative to the folder of the evidence.
        name: name of its folder; '' for what has none in the evidence.
    """

    path: str
    name: str = ''


@dataclass(frozen=True, kw_only=True)
class CampaignInput:
    """A finished campaign whose checksums hold.

    Attributes:
        folder: its folder.
        name: name of its folder, when the evidence was written.
        recorded: its ledger.
        files: SHA-256 of ``campaign.json``, ledger and tables, by name.
        ledger_end: number of lines and link of the last: the head of the hash chain.
        scenes: number, run and SHA-256 of the scene of each run; '' if not recorded.
        bags: SHA-256 of each run's bag by run: of the lines ``SHA-256  NAME`` of its files.
    """

    folder: Path
    name: str
    recorded: RecordedCampaign
    files: Mapping[str, str]
    ledger_end: JournalEnd
    scenes: tuple[tuple[int, str, str], ...]
    bags: Mapping[str, str]

    @property
    def facts(self) -> Mapping[str, Any]:
        """Facts of the campaign."""
        return self.recorded.facts

    @property
    def rows(self) -> tuple[RunRow, ...]:
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

    @property
    def scenes_sha256(self) -> str:
        """SHA-256 of the set of scenes."""
        return digest_of([list(one) for one in self.scenes])

    @property
    def bags_sha256(self) -> str:
        """SHA-256 of the hashes of all bags; '' without any."""
        return digest_of(dict(self.bags)) if self.bags else ''


def read_campaign(
    path: Path, on_bag: Callable[[Path], None] = lambda bag: None
) -> CampaignInput:
    """Read a finished campaign and check everything that it has checksums of.

    Args:
        path: its folder, or the table in it.
        on_bag: called with each bag before it is checked, which takes time.

    Raises:
        UsageError: it is no campaign, a table alone, unfinished, of an earlier version without
            checksums, or damaged.
    """
    folder = path.parent if path.is_file() and path.name == PARQUET_NAME else path
    if path.is_file() and not (folder / LEDGER_NAME).is_file():
        raise UsageError(
            f'{path}: a table alone is no evidence: without {FACTS_NAME} and {LEDGER_NAME} beside '
            'it, program, formula, network and scenes cannot be bound to its rows by hash; name '
            "the campaign's folder"
        )
    recorded = open_campaign(folder)
    facts = read_facts(folder)
    content = recorded.content
    if facts is None or not facts.sealed:
        raise UsageError(f'{folder}: has no {FACTS_NAME} with checksums; {_mend(folder)}')
    parsed = parse_journal((folder / LEDGER_NAME).read_bytes())
    if parsed.unprotected:
        raise UsageError(
            f'{folder / LEDGER_NAME}: its first {parsed.unprotected} lines were written by an '
            'earlier version without checksums, so nothing binds its runs; run it again'
        )
    recorded = _with_network(recorded)
    content = recorded.content
    if lacking := [name for name in _NEEDED if recorded.facts.get(name) in (None, {})]:
        raise UsageError(
            f'{folder}: its record lacks {", ".join(lacking)}, so runs cannot be bound to program, '
            'formula and network; run it again with this version'
        )
    if text_sha256(recorded.facts['program_text']) != recorded.facts['program_sha256']:
        raise UsageError(f'{folder}: its program text is not the one that its SHA-256 names')
    if content.unfinished or not content.finished:
        raise UsageError(
            f'{folder}: has not ended in order; finish it by the command that began it, with '
            '--resume'
        )
    if not content.rows:
        raise UsageError(f'{folder}: has no run')
    if wrong := examine(folder, on_bag).findings:
        more = f' and {len(wrong) - 1} more' if len(wrong) > 1 else ''
        raise UsageError(f'{wrong[0].where}: {wrong[0].what}{more}; {_mend(folder)}')
    shas = {
        line.event['index']: str(line.event.get('scenario_sha256', ''))
        for line in parsed.lines if line.event is not None and line.event.get('event') == 'intent'
    }
    names = (FACTS_NAME, LEDGER_NAME, CSV_NAME, PARQUET_NAME)
    return CampaignInput(
        folder=folder, name=folder.resolve().name, recorded=recorded,
        bags=_bags(folder, content.rows),
        files={name: file_sha256(folder / name) for name in names},
        ledger_end=parsed.end,
        scenes=tuple((row.index, row.run_id, shas.get(row.index, '')) for row in content.rows),
    )


def _with_network(recorded: RecordedCampaign) -> RecordedCampaign:
    """Add the network's hash to the facts: ``taxinet run`` records it with each run only.

    Raises:
        UsageError: its runs had several networks, or another one than its facts say.
    """
    told = recorded.facts.get('perception_sha256')
    found = sorted({
        row.fingerprint for row in recorded.rows
        if row.outcome.judged and (row.fingerprint or not told)
    })
    if len(found) > 1 or (found and told and found != [told]):
        several = sorted({*found, told or found[0]})
        listed = ', '.join(f'{one[:12]}…' if one else 'none' for one in several)
        raise UsageError(
            f'{recorded.folder}: its runs had several networks (sha256 {listed}), so there is no '
            'one system that they are runs of; run them as campaigns of their own'
        )
    if told is not None or not found:
        return recorded
    facts = {**recorded.content.campaign, 'perception_sha256': found[0]}
    return replace(recorded, content=replace(recorded.content, campaign=facts))


def _mend(folder: Path) -> str:
    return f'no evidence is written of damaged results: taxinet doctor {folder}'


def _bags(folder: Path, rows: Sequence[RunRow]) -> dict[str, str]:
    return {
        row.run_id: bag_sha256(folder / row.bag) for row in rows
        if row.bag and (folder / row.bag).is_dir()
    }


def bag_sha256(bag: Path) -> str:
    """SHA-256 of a bag: of the lines ``SHA-256  NAME`` of its files, as ``sha256sum`` has them."""
    return text_sha256(''.join(f'{file_sha256(path)}  {path.name}\n' for path in bag_files(bag)))


def read_campaigns(
    paths: Sequence[Path], on_bag: Callable[[Path], None] = lambda bag: None
) -> tuple[CampaignInput, ...]:
    """Read several campaigns, each once.

    Raises:
        UsageError: as :func:`read_campaign`; or two of them are the same, or share a run.
    """
    found: list[CampaignInput] = []
    seen: dict[tuple[str, str], CampaignInput] = {}
    for path in paths:
        one = read_campaign(path, on_bag)
        system = digest_of(one.system)
        for index, _, sha in one.scenes:
            other = seen.setdefault((system, sha or f'{one.facts["seed"]} {index}'), one)
            if other is not one:
                raise UsageError(
                    f'{one.folder}: has runs that are in {other.folder} too; name each once'
                )
        found.append(one)
    return tuple(found)


@dataclass(frozen=True, kw_only=True)
class NetworkInput:
    """The perception of a system.

    Attributes:
        word: its name or file as recorded.
        sha256: recorded hash of its weights or code; '' for the truth.
        card: model card, if it has one: training data, seed, command.
        card_sha256: of the card's file.
        why_unknown: why the training data are not known; ''.
    """

    word: str
    sha256: str
    card: ModelCard | None = None
    card_sha256: str = ''
    why_unknown: str = ''


def read_network(facts: Mapping[str, Any], given: Iterable[str] = ()) -> NetworkInput:
    """Find the recorded network and its model card.

    Args:
        facts: facts of a campaign.
        given: files to try if it has moved.

    A network that is gone or has changed is no error: its training data are then unknown.
    """
    word, sha256 = str(facts['perception']), str(facts['perception_sha256'])
    shown = Path(word).name if word.endswith((SUFFIX, '.onnx')) else word
    if not sha256:
        why = 'no network: the controller is given the truth' if word == TRUTH else (
            'the perception did not report a hash'
        )
        return NetworkInput(word=shown, sha256='', why_unknown=why)
    why = ''
    for candidate in (*given, word):
        path = weights_path(candidate)
        if path.suffix != SUFFIX:
            why = why or 'it is no network of taxinet train, so no model card names its data'
            continue
        if not path.is_file():
            why = 'its file is not there any more; name it with --perception FILE'
        elif file_sha256(path) != sha256:
            why = 'its file has changed since the runs; name the former with --perception FILE'
        else:
            try:
                card = load_card(card_path(path))
            except UsageError as error:
                why = f'its model card cannot be used: {error}'
                continue
            if card.weights_sha256 != sha256:
                why = 'its model card describes other weights'
                continue
            return NetworkInput(
                word=shown, sha256=sha256, card=card, card_sha256=file_sha256(card_path(path))
            )
    return NetworkInput(word=shown, sha256=sha256, why_unknown=why)


def usable_network(facts: Mapping[str, Any], given: Iterable[str] = ()) -> str:
    """The word or file by which the recorded perception can be loaded here.

    Raises:
        UsageError: it is gone, or another one now.
    """
    word, sha256 = str(facts['perception']), str(facts['perception_sha256'])
    why = ''
    for candidate in (*given, word):
        try:
            if check_perception(candidate) == sha256:
                return candidate
            why = f'{candidate} has another SHA-256 than the network of the runs'
        except UsageError as error:
            why = str(error)
    raise UsageError(f'{why}; name the network of the runs with --perception FILE')


@dataclass(frozen=True, kw_only=True)
class LocalisationInput:
    """Results of ``taxinet localize`` on one of the campaigns.

    Attributes:
        folder: their folder.
        files: SHA-256 of the summary and the journal of trials, by name.
        campaign: index of the campaign.
        found: the findings, from the trials.
    """

    folder: Path
    files: Mapping[str, str]
    campaign: int
    found: Localisation


def read_localisation(folder: Path, campaigns: Sequence[CampaignInput]) -> LocalisationInput:
    """Read the trials of a localisation, and find its campaign.

    Raises:
        UsageError: it is none, is damaged, or is not about one of the campaigns.
    """
    path, summary = folder / TRIALS_NAME, folder / LOCALISE_NAME
    for needed in (summary, path):
        if not needed.is_file():
            raise UsageError(
                f'{folder}: no results of taxinet localize: {needed.name} is not there'
            )
    sealed = read_sealed(summary)
    parsed = parse_journal(path.read_bytes())
    for number, why in parsed.troubles:
        raise damaged_line(path, number, why)
    ended = sealed.journals.get(path.name)
    if not sealed.sealed or ended is None:
        raise UsageError(f'{summary}: has no checksum of {path.name}; localize again')
    if why := lost_end(parsed, ended):
        raise damaged_line(path, len(parsed.lines) + 1, why)
    events = [line.event for line in parsed.lines if line.event is not None]
    try:
        facts = next(event['facts'] for event in events if event['event'] == 'localize')
        trials = [Trial.from_json(event['trial']) for event in events if event['event'] == 'trial']
        words = [str(one['substitution']) for one in sealed.values['substitutions']]
    except (StopIteration, LookupError, TypeError) as error:
        raise UsageError(f'{path}: damaged ({error!r}); localize again') from error
    runs = {trial.run_id for trial in trials}
    found = [
        number for number, one in enumerate(campaigns)
        if all(
            facts.get(name) == one.facts.get(name)
            for name in ('program_sha256', 'seed', 'specs', 'perception_sha256')
        ) and runs <= {row.run_id for row in one.recorded.counterexamples}
    ]
    if not found or not runs:
        raise UsageError(
            f'{folder}: is not about failed runs of any of these campaigns (program, seed, '
            'formulas, network and runs have to agree)'
        )
    if len(found) > 1:
        raise UsageError(f'{folder}: may be about several of these campaigns; name it with one')
    campaign = campaigns[found[0]].recorded
    return LocalisationInput(
        folder=folder, campaign=found[0],
        files={one.name: file_sha256(one) for one in (summary, path)},
        found=localisation_of(
            campaign, [row for row in campaign.counterexamples if row.run_id in runs],
            {(trial.run_id, trial.word): trial for trial in trials},
            words=tuple(dict.fromkeys((AS_RECORDED, *words))),
            perception=str(campaign.facts['perception']),
        ),
    )


@dataclass(frozen=True, kw_only=True)
class MonitorInput:
    """What ``taxinet assure judge`` found of a run-time monitor.

    Attributes:
        folder: its folder.
        files: SHA-256 of summary, trials and alarms, by name.
        options: what was judged: program, monitor, fallbacks, seed.
        perception_sha256: the network's hash.
        judged: the figures, from trials and alarms.
    """

    folder: Path
    files: Mapping[str, str]
    options: Mapping[str, Any]
    perception_sha256: str
    judged: Judged


def read_monitor(folder: Path, campaigns: Sequence[CampaignInput]) -> MonitorInput:
    """Read a judged monitor, and check that it is of the network of one of the campaigns.

    Raises:
        UsageError: it is none, its summary is not that of its trials, or it is of another network.
    """
    options, judged = read_judged(folder)
    sha256 = str(options['fingerprints']['perception'])
    if sha256 not in {one.facts['perception_sha256'] for one in campaigns}:
        raise UsageError(
            f'{folder}: is of network {options["perception"]} (sha256 {sha256[:12]}…), which none '
            'of these campaigns ran'
        )
    return MonitorInput(
        folder=folder, options=options, perception_sha256=sha256, judged=judged,
        files={
            name: file_sha256(folder / name)
            for name in (RESULT_NAME, MONITOR_TRIALS_NAME, ALARMS_NAME)
        },
    )


@dataclass(frozen=True, kw_only=True)
class OddInput:
    """An operational design domain and its file.

    Attributes:
        odd: the domain.
        path: its file.
        sha256: of the file.
    """

    odd: Odd
    path: Path
    sha256: str


def read_domain(word: str) -> OddInput:
    """Read an ODD by its shipped name or file.

    Raises:
        UsageError: there is none, or it has a mistake.
    """
    path = find_odd(word)
    return OddInput(odd=read_odd(path), path=path, sha256=file_sha256(path))
