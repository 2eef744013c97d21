"""A cause as a Scenic program, to test it on fresh scenes.

It is the program of the analysed runs with an additional requirement: that a scene lies in the
region. Scenic uses rejection sampling, so the scenes follow the program's own distribution within
the region, whatever sampler chose the analysed runs.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from taxinet_ros.analysis.causes.causes import Cause
from taxinet_ros.analysis.causes.region import Either, Kinds, Part, Slant
from taxinet_ros.analysis.runs.campaign import CampaignRuns
from taxinet_ros.analysis.runs.features import BY_NAME
from taxinet_ros.campaign.scenes.programs import SUFFIX, find_program, known_programs
from taxinet_ros.core.controller import STEERING, controller_options
from taxinet_ros.core.pacing.timing import parse_timing
from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS, other_form

RUNS = 100
_ANOTHER_SEED = 1_000_003
_FILE = re.compile(r'^# --- (.+) ---$', re.MULTILINE)
_VALUES = {
    field.key: f'ego.{field.key}' if field.plane else f'scene_{field.key}'
    for field in SCENARIO_FIELDS
}
"""Expression of a program's requirement for each column of the table."""
_SWITCHES = {'on': True, 'off': False}


def program_name(cause: Cause) -> str:
    """File name of a cause's program."""
    return f'cause-{cause.rank}{SUFFIX}'


def cause_program(runs: CampaignRuns, cause: Cause) -> str | None:
    """Text of a cause's program; None if the text of the runs' own program is not known.

    Args:
        runs: runs in which it was found.
        cause: the cause.
    """
    source = _source(runs)
    if source is None:
        return None
    required = [f'require {_condition(part)}' for part in cause.region.parts]
    # A requirement can refer to names of a program, but not to parameters of the world.
    named = sorted({word for text in required for word in re.findall(r'\bscene_\w+', text)})
    required[:0] = [f'{word} = globalParameters.{_parameter(word, source)}' for word in named]
    return '\n'.join([
        source.rstrip(), '', f'# Only scenes of cause {cause.rank} of {runs.label}: '
        f'{cause.region.words()}.', *required, '',
    ])


def confirmation_command(runs: CampaignRuns, cause: Cause, folder: Path = Path()) -> str | None:
    """Command that runs fresh scenes of a cause; None if its program cannot be written.

    Args:
        runs: runs in which it was found.
        cause: the cause.
        folder: folder of its program.
    """
    if _source(runs) is None:
        return None
    seed = int(runs.facts.get('seed') or 0) + _ANOTHER_SEED
    words = ['taxinet', 'run', str(folder / program_name(cause)), '--runs', str(RUNS),
             '--seed', str(seed), '--perception', runs.perception,
             *controller_options(runs.facts.get('controller', STEERING))]
    values = {**runs.facts.get('overrides', {}), **runs.facts.get('laid_over', {})}
    for key, value in values.items():
        words += ['--set', f'{key}={value}']
    specs = runs.facts.get('specs', {})
    words += ['--spec', f'{runs.spec}={specs[runs.spec]}' if runs.spec in specs else runs.spec]
    words += parse_timing(str(runs.facts.get('timing', ''))).options
    return shlex.join([*words, '--images', 'none'])


def _source(runs: CampaignRuns) -> str | None:
    """Text of the program, from the campaign's record or as shipped."""
    record = str(runs.facts.get('program_text', ''))
    files = _FILE.split(record)[1:]
    texts = dict(zip(files[::2], files[1::2], strict=True))
    if texts:
        own = {name: text for name, text in texts.items() if name != f'runway_world{SUFFIX}'}
        return next(iter(own.values())).lstrip('\n') if len(own) == 1 else None
    word = runs.program.removesuffix(SUFFIX)
    return find_program(word).read_text(encoding='utf-8') if word in known_programs() else None


def _parameter(word: str, source: str) -> str:
    """The parameter that a requirement calls ``word``, in the form set by the program."""
    key = word.removeprefix('scene_')
    short = other_form(key)
    said = short and re.search(rf'^[ \t]*param\b.*\b{short}[ \t]*=', source, re.MULTILINE)
    return short if said else key


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
