"""A cause as a Scenic program, to test it on fresh scenes.

It is the program of the analysed runs with an additional requirement: that a scene lies in the
region. Scenic uses rejection sampling, so the scenes follow the program's own distribution within
the region, whatever sampler chose the analysed runs.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.causes.causes import Cause
from taxinet_ros.analysis.causes.region import Either, Kinds, Part, Slant
from taxinet_ros.analysis.runs.campaign import CampaignRuns
from taxinet_ros.analysis.runs.features import BY_NAME
from taxinet_ros.campaign.past_runs.recorded_campaign import open_campaign
from taxinet_ros.campaign.record.facts import FACTS_NAME, LEDGER_NAME
from taxinet_ros.campaign.run_command import RunSettings
from taxinet_ros.campaign.scenes.paper_names import key_of, our_value, paper_name
from taxinet_ros.campaign.scenes.programs import (
    NAMED_FILE,
    SUFFIX,
    find_program,
    known_programs,
)
from taxinet_ros.core import scenario_fields
from taxinet_ros.core.place.catalogue import DEFAULT_PLACE
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CATALOGUES, DATE, PLACE, SCENARIO_FIELDS
from taxinet_ros.errors import UsageError

RUNS = 100
_ANOTHER_SEED = 1_000_003
_FILE = re.compile(r'^# --- (.+) ---$', re.MULTILINE)
_VALUES = {
    field.key: f'ego.{field.key}' if field.plane else f'scene_{field.key}'
    for field in SCENARIO_FIELDS
}
"""Expression of a program's requirement for each column of the table."""
_SCENE = re.compile(r'\bscene_(\w+)')
_STATEMENT = re.compile(r'^[ \t]*param\b.*', re.MULTILINE)
_PARAMETER = re.compile(r'(?:param\s+|,\s*)["\']?([\w/\[\]]+)["\']?\s*=(?!=)')
_SWITCHES = {'on': True, 'off': False}


def program_name(cause: Cause) -> str:
    """File name of a cause's program."""
    return f'cause-{cause.rank}{SUFFIX}'


def why_no_program(runs: CampaignRuns) -> str:
    """Why the causes of these runs cannot be tested on fresh scenes; '' if they can."""
    if not runs.facts:
        return f'there is no {FACTS_NAME} beside the table, so the settings of its runs are unknown'
    if not runs.perception:
        return 'the graph of its runs was started before the campaign'
    if recorded_program(runs) is None:
        return 'the text of their program is not recorded, or has several files'
    try:
        fresh_settings(runs)
    except UsageError as error:
        return str(error)
    return ''


def cause_program(runs: CampaignRuns, cause: Cause) -> str | None:
    """Text of a cause's program; None if there is none, see :func:`why_no_program`.

    Args:
        runs: runs in which it was found.
        cause: the cause.
    """
    source = recorded_program(runs)
    if source is None or why_no_program(runs):
        return None
    required = [f'require {_condition(part)}' for part in cause.region.parts]
    required = _adapted(required, source, fresh_settings(runs).values)
    return '\n'.join([
        _whole(source, runs).rstrip(), '', f'# Only scenes of cause {cause.rank} of {runs.label}: '
        f'{cause.region.words()}.', *required, '',
    ])


def confirmation_command(runs: CampaignRuns, cause: Cause, folder: Path = Path()) -> str | None:
    """Command that runs fresh scenes of a cause; None without a program of it.

    Args:
        runs: runs in which it was found.
        cause: the cause.
        folder: folder of its program.
    """
    if why_no_program(runs):
        return None
    seed = int(runs.facts.get('seed') or 0) + _ANOTHER_SEED
    words = ('--runs', str(RUNS), '--seed', str(seed))
    program = str(folder / program_name(cause))
    return f'{fresh_settings(runs).command(program, *words, folder=folder)} --images none'


def program_documents(runs: CampaignRuns) -> dict[str, str]:
    """Text by file name of the documents that confirmation commands read beside the programs."""
    return {} if why_no_program(runs) else fresh_settings(runs).documents()


def fresh_settings(runs: CampaignRuns) -> RunSettings:
    """Settings of fresh runs like the analysed ones, with the analysed requirement alone."""
    facts = dict(runs.facts)
    settings = RunSettings.from_facts(facts)
    told = runs.spec in facts.get('specs', {}) and _documents_known(settings)
    if not told and (runs.folder / LEDGER_NAME).is_file():
        # The ledger has the requirements added later, and the documents in full.
        added = open_campaign(runs.folder).content.added
        facts['specs'] = {**added, **facts.get('specs', {})}
        settings = RunSettings.from_facts(facts)
    values = {
        key: CATALOGUES[key].typed(str(value)).text if key in CATALOGUES else value
        for key, value in settings.values.items()
    }
    return replace(settings.judged_by(runs.spec), perception=runs.perception, values=values)


def _whole(source: str, runs: CampaignRuns) -> str:
    """The program with files of documents replaced by those that the runs had."""
    if not (NAMED_FILE.search(source) and (runs.folder / LEDGER_NAME).is_file()):
        return source
    recorded = open_campaign(runs.folder).content.documents

    def document(found: re.Match[str]) -> str:
        for key, catalogue in CATALOGUES.items():
            with contextlib.suppress(UsageError):
                named = catalogue.typed(found[2])
                if (key, named.reference) in recorded:
                    return repr(named.text)
        return found[0]

    return NAMED_FILE.sub(document, source)


def _documents_known(settings: RunSettings) -> bool:
    try:
        settings.documents()
    except UsageError:
        return False
    return True


def recorded_program(runs: CampaignRuns) -> str | None:
    """Text of the program, from the campaign's record or as shipped; None if it is unknown."""
    record = str(runs.facts.get('program_text', ''))
    files = _FILE.split(record)[1:]
    texts = dict(zip(files[::2], files[1::2], strict=True))
    if texts:
        own = {name: text for name, text in texts.items() if name != f'runway_world{SUFFIX}'}
        return next(iter(own.values())).lstrip('\n') if len(own) == 1 else None
    word = runs.program.removesuffix(SUFFIX)
    return find_program(word).read_text(encoding='utf-8') if word in known_programs() else None


def _parameters(source: str) -> list[str]:
    """Names that the program's ``param`` statements set."""
    lines = _STATEMENT.findall(source)
    return [name for line in lines for name in _PARAMETER.findall(line)]


def _parameter(key: str, source: str) -> str:
    """The parameter that sets a key, under the name by which the program sets it."""
    said = _parameters(source)
    return next((name for name in said if key_of(name, said) == key), key)


def _adapted(required: list[str], source: str, overrides: Mapping[str, Any]) -> list[str]:
    """Requirements with what they call ``scene_KEY`` defined, in the table's units and words."""
    said = _parameters(source)
    names = {key: _parameter(key, source) for key in _named(required)}
    of_paper = {key: name for key, name in names.items() if paper_name(name, said)}
    values = {
        key: f'our_value({name!r}, scene_{key}, scene_{PLACE.key}, scene_{DATE.key})'
        for key, name in of_paper.items()
    }
    documents = [key for key in names if key in CATALOGUES]
    # The cause has references; a program may have names, files or whole documents.
    values |= {key: f'CATALOGUES[{key!r}].typed(scene_{key}).reference' for key in documents}
    lines = [f'from {our_value.__module__} import our_value'] * bool(of_paper)
    lines += [f'from {scenario_fields.__name__} import CATALOGUES'] * bool(documents)
    # A requirement knows the names of a program, but not the parameters of the world.
    lines += [f'scene_{key} = globalParameters[{name!r}]' for key, name in sorted(names.items())]
    for key, usual in ((PLACE.key, DEFAULT_PLACE), (DATE.key, Scenario().date)) * bool(of_paper):
        if key in overrides:
            lines.append(f'scene_{key} = {overrides[key]!r}')
        elif key not in names:
            lines.append(f'scene_{key} = globalParameters.get({key!r}, {usual!r})')
    return lines + [
        _SCENE.sub(lambda found: values.get(found[1], found[0]), text) for text in required
    ]


def _named(required: list[str]) -> set[str]:
    return {key for text in required for key in _SCENE.findall(text)}


def _value(name: str) -> str:
    """Expression for a feature in a requirement."""
    source = BY_NAME[name].source
    return _VALUES[source] if name == source else f'abs({_VALUES[source]})'


def _condition(part: Part) -> str:
    if isinstance(part, Either):
        return f'({_condition(part.first)}) != ({_condition(part.second)})'
    if isinstance(part, Kinds):
        kinds = tuple(_SWITCHES.get(kind, kind) for kind in part.kinds)
        return f'{_value(part.feature)} in {kinds!r}'
    value = _value(part.feature)
    if isinstance(part, Slant):
        value = f'{value} + {part.factor!r} * {_value(part.other)}'
    low, high = part.low, part.high
    bounds = [f'{low!r} <= {value}'] * (low is not None) + [f'{value} <= {high!r}'] * (
        high is not None)
    joined = ' or ' if low is not None and high is not None and low > high else ' and '
    return f'({joined.join(bounds) or "True"})'
