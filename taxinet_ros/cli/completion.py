"""What a shell offers behind TAB: names, and behind ``key=`` the values that are a closed set.

Typer asks the functions here with the beginning of a word. bash alone splits words at ``=`` and
``:`` and wants back what follows the last of them, so :func:`answer_shell` stands between the two.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import re
from collections.abc import Callable, Iterable, Mapping, MutableMapping
from operator import attrgetter

import typer

from taxinet_ros.errors import ExitCode
from taxinet_ros.registry import (
    CAMERAS,
    CONTROLLERS,
    PERCEPTIONS,
    REQUIREMENTS,
    SAMPLERS,
    WORLDS,
    names,
)

ASKED_BY = '_TAXINET_COMPLETE'
"""Environment variable that a shell sets to ask; its value says which shell."""
_BASH = 'complete_bash'
_BREAKS = re.compile(r'[=:]+')
_AFTER_BREAK = re.compile(r'.*[=:]', re.DOTALL)
Completer = Callable[[str], list[str]]


def complete_fallback(incomplete: str) -> list[str]:
    """What a monitor may do, ``second:`` with the perceptions by name."""
    from taxinet_ros.core.assurance.switch import SECOND, SLOW, STOPPING, WATCH

    second = [f'{SECOND}:{name}' for name in names(PERCEPTIONS)]
    return _begin([STOPPING, SLOW, WATCH, *second], incomplete)


def complete_sampler_option(context: typer.Context, incomplete: str) -> list[str]:
    """Options of the sampler that is named before, else of any, with ``=``."""
    from taxinet_ros.samplers.registry import SAMPLERS as BY_NAME

    chosen = str(context.params.get('sampler'))
    kinds = [BY_NAME[chosen]] if chosen in BY_NAME else [*BY_NAME.values()]
    found = [f'{key}=' for kind in kinds for key in kind.options]
    found += [f'rule={rule}' for kind in kinds for rule in kind.rules]
    return _begin(dict.fromkeys(found), incomplete)


def complete_signal(incomplete: str) -> list[str]:
    """Signals of requirements, with ``=``."""
    from taxinet_ros.core.mtl import SIGNALS

    return _begin([f'{name}=' for name in SIGNALS], incomplete)


def complete_gain(incomplete: str) -> list[str]:
    """Gains of the steering law, with ``=``."""
    from taxinet_ros.core.motion.controller import GAIN_RANGES

    return _begin([f'steering.{name}=' for name in GAIN_RANGES], incomplete)


def complete_setting(incomplete: str) -> list[str]:
    """Keys of a scenario and gains that begin so, with ``=``; behind it, values that are words.

    A single key comes with its values: a shell puts a space behind what it completes alone.
    """
    from taxinet_ros.core.scenario_fields import HUMAN_KEYS, SHORT_FORMS

    key, equals, value = incomplete.partition('=')
    if equals:
        return [f'{key}={word}' for word in _begin(_values(key), value)]
    found = _begin((*HUMAN_KEYS, *SHORT_FORMS), key)
    gains = complete_gain(incomplete) if incomplete else []
    if len(found) == 1 and not gains and (values := _values(found[0])):
        return [f'{found[0]}={word}' for word in values]
    return [*(f'{name}=' for name in found), *gains]


def _values(key: str) -> tuple[str, ...]:
    """All values of a key, if they are a closed set; of documents, the shipped ones."""
    from taxinet_ros.core.scenario_fields import BY_KEY, SHORT_FORMS, Kind

    field = BY_KEY.get(SHORT_FORMS.get(key, key))
    if field is None:
        return ()
    if field.catalogue is not None:
        return tuple(field.catalogue.shipped)
    return ('on', 'off') if field.kind is Kind.SWITCH else field.words


def one_of(*words: str) -> Completer:
    """Completion of an option whose values are these words."""
    return lambda incomplete: _begin(words, incomplete)


def registered(kind: str) -> Completer:
    """Completion of what is shipped or installed under a name, by its extension point."""
    return lambda incomplete: _begin(names(kind), incomplete)


def shipped(names_of: str) -> Completer:
    """Completion of shipped documents; the shell itself completes names of files.

    Args:
        names_of: module below the package, and what in it has, or says, their names.
    """
    module, _, attribute = names_of.partition(':')

    def complete(incomplete: str) -> list[str]:
        found = attrgetter(attribute)(importlib.import_module(f'taxinet_ros.{module}'))
        return _begin(found() if callable(found) else found, incomplete)

    return complete


complete_program = shipped('scenes.programs:known_programs')
complete_experiment = shipped('trials.experiment:known_experiments')
complete_odd = shipped('trials.odd.odd_file:known_odds')
complete_aircraft = shipped('core.rig.catalogue:AIRCRAFT.shipped')
complete_perception = registered(PERCEPTIONS)
complete_sampler = registered(SAMPLERS)
complete_controller = registered(CONTROLLERS)
complete_world = registered(WORLDS)
complete_renderer = registered(CAMERAS)
complete_spec = registered(REQUIREMENTS)


def _begin(words: Iterable[str], incomplete: str) -> list[str]:
    return [word for word in words if word.startswith(incomplete)]


def answer_shell(ask: Callable[[], object], environment: MutableMapping[str, str]) -> object:
    """Have typer answer a shell; for bash, with the words as they were typed.

    Args:
        ask: calls typer, which prints what fits, a line each, and ends with SystemExit.
        environment: the variables in which the shell asks; changed for typer.

    Returns:
        The exit code.
    """
    begun = _rejoined(environment) if environment.get(ASKED_BY) == _BASH else ''
    if not begun:
        return _ended(ask)
    with contextlib.redirect_stdout(io.StringIO()) as caught:
        code = _ended(ask)
    for line in caught.getvalue().split():
        print(line.removeprefix(begun))
    return code


def _ended(ask: Callable[[], object]) -> object:
    try:
        return ask()
    except SystemExit as end:
        return ExitCode.USAGE if end.code else 0  # typer ends with 1 where it knows no such shell


def _rejoined(environment: MutableMapping[str, str]) -> str:
    """Put bash's pieces of words together again.

    Returns:
        The part of the word to be completed that bash has split off, as typer sees it; '' if none.
    """
    words, at = _bash_words(environment)
    whole: list[str] = []
    current, open_end = at, False
    for place, word in enumerate(words):
        broken = bool(_BREAKS.fullmatch(word))
        if whole and word and (broken or open_end):
            whole[-1] += word
        else:
            whole.append(word)
        open_end = broken and len(whole) > 1
        if place == at:
            current = len(whole) - 1
    environment['COMP_WORDS'] = '\n'.join(whole[:current + 1])
    environment['COMP_CWORD'] = str(current)
    word = whole[current] if current < len(whole) else ''
    if word.startswith('--'):
        word = word.partition('=')[2]
    found = _AFTER_BREAK.match(word)
    return found[0] if found else ''


def _bash_words(environment: Mapping[str, str]) -> tuple[list[str], int]:
    """The words of bash, a line each in its script, and the place of the one to complete."""
    text = environment.get('COMP_WORDS', '')
    words = text.split('\n') if '\n' in text else text.split(' ')
    try:
        return words, int(environment.get('COMP_CWORD', ''))
    except ValueError:
        return words, len(words)
