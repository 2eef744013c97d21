"""Check the global parameters of a compiled program, its overrides and its fixed ground objects.

The Scenic child has read them (:mod:`.constructs`), with the line of each.
"""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.core.datarefs import split_name
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.track import runway_track
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CATALOGUES,
    PARAMETERS,
    PLANE_KEYS,
    RAIN,
    SHORT_FORMS,
    SKY,
    TRAFFIC,
    by_key,
    full_key,
)
from taxinet_ros.core.traffic.traffic_file import typed_traffic
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.overrides import check_overrides, check_value
from taxinet_ros.scenes.paper_names import PAPER_NAMES, is_dataref, key_of, paper_name
from taxinet_ros.scenes.programs import beside, is_document_file, shown_place
from taxinet_ros.scenes.values import OVERRIDES, Place, placed_objects

_FORMS = tuple(name for name in (*PARAMETERS, *SHORT_FORMS)
               if SHORT_FORMS.get(name, name) in PARAMETERS)


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """A global parameter of a program.

    Attributes:
        place: where it was last set.
        random: whether its value is drawn.
        values: its constant value, or some draws of it.
        words: its constant word, or the words from which it is chosen.
    """

    place: Place
    random: bool
    values: Sequence[Any]
    words: Sequence[str]


def checked_parameters(
    program: Path, params: Mapping[str, Mapping[str, Any]],
    objects: Sequence[tuple[Place, str]], random_objects: int,
) -> dict[str, Parameter]:
    """The parameters of a compiled program; refuse those without effect or with impossible values.

    Args:
        program: the program's file.
        params: attributes of each parameter by name.
        objects: place and document of each fixed ground object, which are checked, too.
        random_objects: number of the others, which are drawn.

    Raises:
        UsageError: the first that is refused, with its line.
    """
    found = {
        name: Parameter(**{**values, 'place': values['place'] or (str(program), 0)})
        for name, values in params.items()
    }
    _check_names(found)
    for name, param in found.items():
        with _at(param.place):
            _check_values(name, param, params, program)
    if TRAFFIC.key in found and (objects or random_objects):
        with _at(found[TRAFFIC.key].place):
            raise UsageError(
                'param traffic has no effect here: objects are placed below; leave one out')
    for place, document in objects:
        with _at(place):
            _check_object(document)
    return found


def _check_names(params: Mapping[str, Parameter]) -> None:
    for name, param in params.items():
        with _at(param.place):
            _check_name(name)
    said: dict[str, str] = {}
    for name in sorted(params, key=len):
        other = said.setdefault(key_of(name, params), name)
        if other != name and not (is_dataref(name) and is_dataref(other)):
            later = max(params[name], params[other], key=lambda one: one.place)
            with _at(later.place):
                raise UsageError(f'param {other} and param {name} are the same; leave one out')


def checked_overrides(
    program: Path, given: Sequence[tuple[Place, Mapping[str, str]]]
) -> dict[str, str]:
    """The values of all ``param overrides`` of a program by key, the last said of each.

    Raises:
        UsageError: one is impossible, with its line.
    """
    found: dict[str, str] = {}
    for place, values in given:
        texts = {key: str(beside(program, text)) if is_document_file(text) else text
                 for key, text in values.items()}
        with _at(place, f'param {OVERRIDES}: '):
            check_overrides(texts)
            found |= by_key(texts)
    return found


def rain_notes(params: Mapping[str, Parameter]) -> tuple[str, ...]:
    """That a constant percentage of rain looks like a fraction."""
    for name in {RAIN.key, RAIN.short} & params.keys():
        param = params[name]
        numbers = _numbers(param)
        if paper_name(name, params) is None and 0 < max(numbers, default=0) <= 1:
            where = shown_place(*param.place)
            return (f'{where}: param {name} is {numbers[0]:.2g}, and rain is in percent: less than '
                    'anybody sees; if fractions are meant, write 100 times as much',)
    return ()


def _check_name(name: str) -> None:
    try:
        key = full_key(name)
    except UsageError as error:
        raise UsageError(f'param {str(error).removeprefix("scenario: ")}') from None
    if key in PLANE_KEYS:
        raise UsageError(f'parameter {name!r} belongs to the plane: place the ego there')
    if is_dataref(name):
        split_name(name)
    elif key not in BY_KEY and name not in PAPER_NAMES:
        close = difflib.get_close_matches(name, _FORMS, 1)
        hint = f'; did you mean {SHORT_FORMS.get(close[0], close[0])}?' if close else ''
        raise UsageError(
            f'param {name}: unknown, so it has no effect{hint}; known: {", ".join(PARAMETERS)}')


def _check_values(
    name: str, param: Parameter, names: Collection[str], program: Path
) -> None:
    meant = paper_name(name, names)
    if meant is not None:
        for value in param.values:
            meant.check(f'param {name}', value)
        return
    if name in (RAIN.key, RAIN.short) and param.random and 0 < max(
        _numbers(param), default=0
    ) <= 1:
        raise UsageError(
            f'param {name}: here it is in percent: 100 * (fraction), such as "param rain_percent = '
            'Range(25, 100)"; it is a fraction beside zulu_time or cloud_type only')
    for value in param.values:
        if is_dataref(name) and type(value) is not float:
            raise UsageError(f'{name} is {value!r:.60}; expected a number')
        if name == SKY.key and not isinstance(value, str):
            _check_word(name, f'{value:g}', program)
        if isinstance(value, str) and name != 'date':  # a date may be computed, and invalid
            _check_word(name, value, program)
    for word in param.words:
        _check_word(name, word, program)


def _check_word(name: str, word: str, program: Path) -> None:
    """Refuse a word that is misspelt, hence invalid in every run."""
    if name in CATALOGUES and is_document_file(word):
        word = str(beside(program, word))
    try:
        check_value(name, word)
    except UsageError as error:
        raise UsageError(f'param {str(error).removeprefix("scenario: ")}') from error


def _check_object(document: str) -> None:
    """Refuse a ground object that cannot stand or move as it is to."""
    try:
        typed_traffic(placed_objects(document, runway_track(default_runway())))
    except UsageError as error:
        text = str(error).removeprefix('traffic: objects[0].').removeprefix('path[0].')
        raise UsageError(text) from error


def _numbers(param: Parameter) -> list[float]:
    return [value for value in param.values if type(value) is float]


@contextlib.contextmanager
def _at(place: Place, prefix: str = '') -> Iterator[None]:
    try:
        yield
    except UsageError as error:
        raise UsageError(f'{shown_place(*place)}: {prefix}{error}') from error
