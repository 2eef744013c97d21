"""A cause as a Scenic program, to test it on fresh scenes.

It is the program of the analysed runs with an additional requirement: that a scene lies in the
region. Scenic uses rejection sampling, so the scenes follow the program's own distribution within
the region, whatever sampler chose the analysed runs.
"""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

from taxinet_ros.analysis.causes.causes import Cause
from taxinet_ros.analysis.causes.region import Either, Kinds, Part, Slant
from taxinet_ros.analysis.runs.campaign import CampaignRuns
from taxinet_ros.analysis.runs.features import BY_NAME
from taxinet_ros.core import scenario_fields
from taxinet_ros.core.place.catalogue import DEFAULT_PLACE
from taxinet_ros.core.place.track import RUNWAY_TRACK
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    CATALOGUES,
    DATE,
    DISTANCE,
    PLACE,
    SCENARIO_FIELDS,
    TRACK,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.scenes.overrides import overrides_statement
from taxinet_ros.scenes.paper_names import START, key_of, our_value, paper_name
from taxinet_ros.scenes.programs import (
    SUFFIX,
    find_program,
    known_programs,
    stored_files,
    stored_text,
    write_program,
)
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
from taxinet_ros.trials.record.facts import is_campaign
from taxinet_ros.trials.run_command import RunSettings

RUNS = 100
ANOTHER_SEED = 1_000_003
_VALUES = {
    field.key: f'ego.{field.key}' if field.plane else f'scene_{field.key}'
    for field in SCENARIO_FIELDS
}
"""Expression of a program's requirement for each column of the table."""
_SCENE = re.compile(r'\bscene_(\w+)')
_STATEMENT = re.compile(r'^[ \t]*param\b.*', re.MULTILINE)
_PARAMETER = re.compile(r'(?:param\s+|,\s*)["\']?([\w/\[\]@.]+)["\']?\s*=(?!=)')
_SCENARIO = re.compile(r'^scenario\b', re.MULTILINE)
_EGO = re.compile(r'^ego\b', re.MULTILINE)
_NO_WORDS = (tokenize.NL, tokenize.COMMENT, tokenize.INDENT, tokenize.DEDENT)
_SWITCHES = {'on': True, 'off': False}


def program_name(cause: Cause) -> str:
    """File name of a cause's program."""
    return f'cause-{cause.rank}{SUFFIX}'


def why_no_program(runs: CampaignRuns) -> str:
    """Why the causes of these runs cannot be tested on fresh scenes; '' if they can."""
    if not runs.facts:
        return f'no {RECORD_NAME} is beside the table, so the settings of its runs are unknown'
    if not runs.perception:
        return 'the graph of its runs was started before the campaign'
    try:
        files = stored_files(_program_text(runs))
        if not files:
            return 'the text of their program is not recorded'
        if lost := [name for name, data in files.items() if data is None]:
            return f'{lost[0]} is too large to be recorded with their program'
        _check_requirements_fit(files)
        scenes_program(runs)
        fresh_settings(runs)
    except UsageError as error:
        return str(error)
    return ''


def scenes_program(
    runs: CampaignRuns, requirements: Sequence[str] = (), source: str = ''
) -> str:
    """Source of a program that draws scenes as those of the runs.

    It has the runs' overrides as its own, so the command that runs it needs no option for them.

    Args:
        runs: runs with a program, see :func:`why_no_program`.
        requirements: statements to add.
        source: source of the program itself; that of the runs if empty.

    Raises:
        UsageError: a document is known by its digest only.
    """
    overrides = overrides_statement(_recorded_settings(runs).values)
    said = (f'# Of every scene, as set in the runs of {runs.label}.', overrides)
    return '\n'.join([
        (source or _source(runs)).rstrip(), '', *requirements, *(said if overrides else ()),
    ])


def cause_program(runs: CampaignRuns, cause: Cause) -> str:
    """Source of a program that draws the scenes of a cause alone; else :func:`scenes_program`.

    Args:
        runs: runs in which it was found.
        cause: the cause.
    """
    required = [f'require {_condition(part)}' for part in cause.region.parts]
    source = _source(runs)
    lines = _adapted(required, source, _recorded_settings(runs).values)
    about = f'# Only scenes of cause {cause.rank} of {runs.label}: {cause.region.words()}.'
    if block := _setup_block(source):
        # Its parameters and ego are not yet set at the end of the module.
        imports = [line for line in lines if line.startswith('from ')]
        rest = (about, *(line for line in lines if line not in imports))
        rows = source.split('\n')
        last = block[-1].last_row
        rows[last:last] = [f'{block[0].indent}{line}' for line in rest]
        return scenes_program(runs, imports, '\n'.join(rows))
    return scenes_program(runs, [about, *lines, ''])


def write_scenes_program(runs: CampaignRuns, source: str, path: Path) -> None:
    """Write a program made of that of the runs, with all that it runs beside it.

    Raises:
        UsageError: another file of such a name lies there; nothing is written.
        OSError: a file cannot be written.
    """
    write_program(path, source, _program_text(runs))


def confirmation_command(runs: CampaignRuns, cause: Cause, folder: Path = Path()) -> str | None:
    """Command that runs fresh scenes of a cause; None without a program of it.

    Args:
        runs: runs in which it was found.
        cause: the cause.
        folder: folder of its program.
    """
    if why_no_program(runs):
        return None
    words = ('--runs', str(RUNS), '--seed', str(fresh_seed(runs)))
    command = fresh_settings(runs).command(str(folder / program_name(cause)), *words)
    return f'{command} --images none'


def fresh_seed(runs: CampaignRuns) -> int:
    """A seed that gives other scenes than the runs had."""
    return int(runs.facts.get('seed') or 0) + ANOTHER_SEED


def fresh_settings(runs: CampaignRuns) -> RunSettings:
    """Settings of fresh runs like the analysed ones, with the analysed requirement first.

    The values of the scenes are not among them: :func:`scenes_program` has them.
    """
    settings = _recorded_settings(runs).headed_by(runs.spec)
    return replace(settings, perception=runs.perception, values={})


def _recorded_settings(runs: CampaignRuns) -> RunSettings:
    facts = dict(runs.facts)
    settings = RunSettings.from_facts(facts)
    told = runs.spec in facts.get('specs', {}) and _documents_known(settings)
    if not told and is_campaign(runs.folder):
        # The record has the requirements added later, and the documents in full.
        added = open_campaign(runs.folder).content.added
        asked = {name: text for name, text in added.items() if name == runs.spec}
        facts['specs'] = {**facts.get('specs', {}), **asked}
        settings = RunSettings.from_facts(facts)
    return replace(settings, values={
        key: CATALOGUES[key].typed(str(value)).text if key in CATALOGUES else value
        for key, value in settings.values.items()
    })


def _documents_known(settings: RunSettings) -> bool:
    try:
        settings.documents()
    except UsageError:
        return False
    return True


def _program_text(runs: CampaignRuns) -> str:
    """The program with all that it runs, as recorded or as shipped; '' if it is unknown."""
    recorded, word = str(runs.facts.get('program_text', '')), runs.program.removesuffix(SUFFIX)
    if recorded or word not in known_programs():
        return recorded
    path = find_program(word)
    return stored_text({path.name: path})


def _source(runs: CampaignRuns) -> str:
    """Source of the program itself."""
    data = next(iter(stored_files(_program_text(runs)).values()))
    return (data or b'').decode()


class _Line(NamedTuple):
    """A line of a program's statements, which may have several rows, counted from 1."""

    indent: str
    words: Sequence[str]
    last_row: int


def _check_requirements_fit(files: Mapping[str, bytes | None]) -> None:
    """Check that requirements can be added to a program.

    Raises:
        UsageError: its scenario is in a module, or as :func:`_setup_block`.
    """
    (_, own), *others = ((name, (data or b'').decode(errors='replace'))
                         for name, data in files.items())
    if not _setup_block(own) and not _EGO.search(own):
        for name, source in others:
            if name.endswith(SUFFIX) and _SCENARIO.search(source):
                raise UsageError(
                    f'the scenario of their program is in {name}, to which requirements cannot be '
                    'added'
                )


def _setup_block(source: str) -> Sequence[_Line]:
    """The lines of ``setup`` of the scenario that a program runs; none if it has no scenario.

    Raises:
        UsageError: the scenario is in one line.
    """
    if not _SCENARIO.search(source):
        return []
    lines = _lines(source)
    heads = [at for at, line in enumerate(lines)
             if line.words[0] == 'scenario' and not line.indent]
    mains = [at for at in heads if lines[at].words[1] == 'Main']
    if not heads:  # in a text
        return []
    body = _block(lines, (mains or heads)[0])
    setups = [at for at, line in enumerate(body) if line.words[:2] == ['setup', ':']]
    block = _block(body, setups[0]) if setups else body
    if not block:
        raise UsageError(
            'the scenario of their program is in one line, to which requirements cannot be added')
    return block


def _lines(source: str) -> list[_Line]:
    lines: list[_Line] = []
    words: list[tokenize.TokenInfo] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.NEWLINE:
            indent = words[0].line[:words[0].start[1]]
            lines.append(_Line(indent, [word.string for word in words], token.start[0]))
            words = []
        elif token.type not in _NO_WORDS:
            words.append(token)
    return lines


def _block(lines: Sequence[_Line], head: int) -> Sequence[_Line]:
    """The lines after one that are deeper than it."""
    depth = len(lines[head].indent)
    return list(takewhile(lambda line: len(line.indent) > depth, lines[head + 1:]))


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
    if START in said:  # the plane itself stands at 0
        required = [text.replace(_VALUES[DISTANCE.key], f'scene_{DISTANCE.key}')
                    for text in required]
    names = {key: _parameter(key, source) for key in _named(required)}
    of_paper = {key: name for key, name in names.items() if paper_name(name, said)}
    where = {PLACE.key: DEFAULT_PLACE, DATE.key: Scenario().date, TRACK.key: RUNWAY_TRACK}
    values = {
        key: f'our_value({name!r}, scene_{key}, {", ".join(f"scene_{one}" for one in where)})'
        for key, name in of_paper.items()
    }
    documents = [key for key in names if key in CATALOGUES]
    # The cause has references; a program may have names, files or whole documents.
    values |= {key: f'CATALOGUES[{key!r}].typed(scene_{key}).reference' for key in documents}
    lines = [f'from {our_value.__module__} import our_value'] * bool(of_paper)
    lines += [f'from {scenario_fields.__name__} import CATALOGUES'] * bool(documents)
    # A requirement knows the names of a program, but not the parameters of the world.
    lines += [
        f'scene_{_identifier(key)} = globalParameters[{name!r}]'
        for key, name in sorted(names.items())
    ]
    for key, usual in where.items() if of_paper else ():
        if key in overrides:
            lines.append(f'scene_{key} = {overrides[key]!r}')
        elif key not in names:
            lines.append(f'scene_{key} = globalParameters.get({key!r}, {usual!r})')
    return lines + [
        _SCENE.sub(lambda found: values.get(found[1], found[0]), text) for text in required
    ]


def _named(required: list[str]) -> set[str]:
    return {
        key.replace('_at_', '@').replace('_point_', '.')
        for text in required for key in _SCENE.findall(text)
    }


def _identifier(key: str) -> str:
    """A key, or a control point as ``wind_speed_mps@2.5``, as part of a name in a program."""
    return key.replace('@', '_at_').replace('.', '_point_')


def _value(name: str) -> str:
    """Expression for a feature in a requirement."""
    source = BY_NAME[name].source
    value = _VALUES.get(source) or f'scene_{_identifier(source)}'
    return value if name == source else f'abs({value})'


def _condition(part: Part) -> str:
    if isinstance(part, Either):
        return ' != '.join(f'({_condition(each)})' for each in part.either)
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
