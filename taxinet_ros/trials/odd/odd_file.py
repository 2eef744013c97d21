"""An operational design domain (ODD) as a file: parameters, their cells, and exclusions.

The YAML format:

    name: my_odd
    source: concept of operations, issue 3     # who says so
    parameters:
      time_of_day: {range: ['6:00', '18:00'], cells: 6, source: daylight}
      distance: {range: [0, 2], unit: km, edges: [0, 0.5, 1, 2]}
      rain: {values: [0], range: [25, 100], unit: '%', cells: 3}
      clouds: {values: [clear, broken, overcast]}
    exclude:                                   # boxes inside the ranges that are not in the ODD
      - when: {clouds: clear, rain: [25, 100]}
        why: no rain from a clear sky

A parameter is a scenario key. Numbers are in its ``unit``, or with their own as after ``--set``;
without either, in the key's unit. A cell holds its lower end but not its upper one, except the last
cell of a range. ``values`` of a number are cells of a single number beside the range.

An ODD is a box of cells less its exclusions. A scene is inside if each parameter is in a cell and
no exclusion holds. A combination of cells is *feasible* if it can be completed to a cell of every
parameter that no single exclusion removes entirely; cells that are partly excluded are feasible.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    FORM,
    HUMAN_KEYS,
    SHORT_FORMS,
    TIME_OF_DAY,
    Kind,
    ScenarioField,
    by_key,
    is_point,
    split_point,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, expected, read_yaml
from taxinet_ros.scenes.programs import find_document, shipped_documents

FOLDER, SUFFIX = 'odds', '.yaml'
MOST_CELLS = 50
"""Most cells of one parameter."""
MOST_COMBINATIONS = 1_000_000
"""Most combinations of cells that are counted at once."""
_DEFAULT_CELLS = 4
_KEYS = ('name', 'source', 'parameters', 'exclude')
_PARAMETER_KEYS = ('range', 'values', 'unit', 'cells', 'edges', 'source')
_SLACK = 1e-6
"""Share of a range by which a number may lie beyond its ends: a conversion of units adds a bit."""
_SHOWN = 0.02
"""Share of a cell's width by which a shown end may differ from the true one."""
OUTSIDE, UNKNOWN = -1, -2
"""In place of a cell's number: in no cell; not recorded."""

Combination = tuple[int, ...]
"""Numbers of parameters, ascending."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """A cell of a parameter.

    Attributes:
        label: display text, with its unit.
        low, high: ends of a number [unit of the key]; equal for a single number, 0 for a word.
        word: the value of a parameter that is no number, as in tables.
    """

    label: str
    low: float = 0.0
    high: float = 0.0
    word: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """A parameter of an ODD.

    Attributes:
        field: the scenario key.
        cells: its cells, in order: single values first, then those of the range.
        source: who says so.
    """

    field: ScenarioField
    cells: tuple[Cell, ...]
    source: str = ''

    @property
    def key(self) -> str:
        """Its scenario key."""
        return self.field.key

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers."""
        return self.field.kind is Kind.NUMBER

    def words(self, cell: int) -> str:
        """A cell for people: ``clouds clear``."""
        label = self.cells[cell].label
        return label if label.startswith(self.field.label) else f'{self.field.label} {label}'

    @property
    def ends(self) -> tuple[float, float]:
        """Least and greatest number in any cell."""
        return min(cell.low for cell in self.cells), max(cell.high for cell in self.cells)

    @property
    def slack(self) -> float:
        """Width by which numbers may differ and be the same [unit of the key]."""
        low, high = self.ends
        return _SLACK * ((high - low) or max(1.0, abs(low)))

    def place(self, value: Any) -> int:
        """Number of the cell of a value as in tables; :data:`OUTSIDE` or :data:`UNKNOWN`."""
        if not self.numeric:
            word = str(value)
            found = [number for number, cell in enumerate(self.cells) if cell.word == word]
            return found[0] if found else OUTSIDE if word else UNKNOWN
        number = float(value)
        if number != number:
            return UNKNOWN
        slack = self.slack
        singles = [place for place, cell in enumerate(self.cells)
                   if cell.low == cell.high and abs(number - cell.low) <= slack]
        if singles:
            return singles[0]
        ranged = [(place, cell) for place, cell in enumerate(self.cells) if cell.low < cell.high]
        if not ranged or not ranged[0][1].low - slack <= number <= ranged[-1][1].high + slack:
            return OUTSIDE
        below = [place for place, cell in ranged if number >= cell.low]
        return below[-1] if below else ranged[0][0]


@dataclass(frozen=True, kw_only=True, slots=True)
class Exclusion:
    """A box inside the ranges that is not part of the ODD.

    Attributes:
        numbers: least and greatest number, both excluded, by number of the parameter.
        slack: width by which they may be exceeded, by number of the parameter.
        words: excluded words by number of the parameter.
        why: the reason.
        text: the conditions for people.
    """

    numbers: Mapping[int, tuple[float, float]]
    slack: Mapping[int, float]
    words: Mapping[int, frozenset[str]]
    why: str
    text: str

    @property
    def parameters(self) -> frozenset[int]:
        """Numbers of the parameters that it depends on."""
        return frozenset(self.numbers) | frozenset(self.words)

    def holds(self, values: Mapping[int, Any]) -> bool:
        """Whether a scene's values, by number of the parameter, are in the box."""
        return all(
            low - self.slack[one] <= float(values[one]) <= high + self.slack[one]
            for one, (low, high) in self.numbers.items()
        ) and all(str(values[one]) in words for one, words in self.words.items())

    def removes(self, cells: Mapping[int, Cell]) -> bool:
        """Whether it removes all of a combination of cells, by number of the parameter."""
        return self.parameters <= set(cells) and all(
            self.contains(one, cells[one]) for one in self.parameters
        )

    def contains(self, parameter: int, cell: Cell) -> bool:
        """Whether all of a cell meets the condition on a parameter that this depends on."""
        if parameter in self.words:
            return cell.word in self.words[parameter]
        (low, high), slack = self.numbers[parameter], self.slack[parameter]
        return low - slack <= cell.low and cell.high <= high + slack


@dataclass(frozen=True, kw_only=True)
class Odd:
    """An operational design domain.

    Attributes:
        name: its name.
        source: who says so.
        parameters: in the order of the file.
        exclusions: what is not part of it.
        text: the file's values as canonical JSON.
    """

    name: str
    source: str
    parameters: tuple[Parameter, ...]
    exclusions: tuple[Exclusion, ...]
    text: str

    @cached_property
    def digest(self) -> str:
        """SHA-256 of its values."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def keys(self) -> tuple[str, ...]:
        """Scenario keys of its parameters."""
        return tuple(one.key for one in self.parameters)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of cells of each parameter."""
        return tuple(len(one.cells) for one in self.parameters)

    def place(self, scene: Mapping[str, Any]) -> tuple[int, ...]:
        """Cell of each parameter in a scene given by key, as in tables.

        A value that changes within the run from one cell to another is in none.
        """
        moments = [
            [one.place(moment[one.key]) for one in self.parameters] for moment in _moments(scene)
        ]
        return tuple(
            cells[0] if len(set(cells)) == 1 else OUTSIDE for cells in zip(*moments, strict=True)
        )

    def excluded_by(self, scene: Mapping[str, Any]) -> Exclusion | None:
        """The first exclusion that a scene is in at any control point, or None."""
        moments = [
            {number: moment[one.key] for number, one in enumerate(self.parameters)}
            for moment in _moments(scene)
        ]
        return next((one for one in self.exclusions if any(map(one.holds, moments))), None)

    def inside(self, scene: Mapping[str, Any]) -> tuple[int, ...] | None:
        """Cells of a scene inside the ODD; None if it is outside."""
        cells = self.place(scene)
        return None if min(cells) < 0 or self.excluded_by(scene) is not None else cells

    def words(self, parameters: Combination, cells: Sequence[int]) -> str:
        """A combination for people: ``clouds clear with rain 0 %``."""
        return ' with '.join(
            self.parameters[one].words(cell) for one, cell in zip(parameters, cells, strict=True)
        )

    def feasible(self, strength: int) -> dict[Combination, npt.NDArray[np.bool_]]:
        """Which combinations of ``strength`` cells are feasible.

        Returns:
            For each set of parameters an array with an axis for each of them.

        Raises:
            UsageError: there are more combinations than :data:`MOST_COMBINATIONS`.
        """
        sets = list(itertools.combinations(range(len(self.parameters)), strength))
        total = sum(int(np.prod([self.sizes[one] for one in each])) for each in sets)
        if total > MOST_COMBINATIONS:
            raise UsageError(
                f'ODD {self.name}: {total:,} combinations of {strength} cells, more than '
                f'{MOST_COMBINATIONS:,}; use fewer cells or a smaller strength'
            )
        return {each: self._feasible(each) for each in sets}

    @cached_property
    def _restricted(self) -> frozenset[int]:
        return frozenset().union(*(one.parameters for one in self.exclusions))

    def _feasible(self, each: Combination) -> npt.NDArray[np.bool_]:
        among = [axis for axis, number in enumerate(each) if number in self._restricted]
        sizes = [self.sizes[number] for number in each]
        found = np.ones(sizes, dtype=bool)
        for cells in itertools.product(*(range(sizes[axis]) for axis in among)):
            partial = {each[axis]: cell for axis, cell in zip(among, cells, strict=True)}
            if not self._completes(partial):
                at: list[int | slice] = [slice(None)] * len(each)
                for axis, cell in zip(among, cells, strict=True):
                    at[axis] = cell
                found[tuple(at)] = False
        return found

    def _completes(self, partial: Mapping[int, int]) -> bool:
        """Whether cells can be completed to a cell of every parameter that is not excluded."""
        cells = {number: self.parameters[number].cells[cell] for number, cell in partial.items()}
        if any(one.removes(cells) for one in self.exclusions):
            return False
        rest = sorted(self._restricted - set(partial))
        return not rest or any(
            self._completes({**partial, rest[0]: cell}) for cell in self._freest[rest[0]]
        )

    @cached_property
    def _freest(self) -> Mapping[int, tuple[int, ...]]:
        """Cells to try for each restricted parameter: others meet more conditions of exclusions."""
        found = {}
        for number in self._restricted:
            met = [
                frozenset(at for at, one in enumerate(self.exclusions)
                          if number in one.parameters and one.contains(number, cell))
                for cell in self.parameters[number].cells
            ]
            least = {one for one in met if not any(other < one for other in met)}
            found[number] = tuple(met.index(one) for one in sorted(least, key=sorted))
        return found


def _moments(scene: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """A scene, and the same with the value of each of its control points."""
    yield scene
    for name in filter(is_point, scene):
        key, part = split_point(name)
        if part != FORM:
            yield {**scene, key: scene[name]}


def known_odds() -> tuple[str, ...]:
    """Sorted names of the shipped ODDs."""
    return shipped_documents(FOLDER, SUFFIX)


def find_odd(word_or_path: str) -> Path:
    """Find the file of a shipped ODD's name, or of a path.

    Raises:
        UsageError: it is neither; the known names are listed.
    """
    return find_document(
        word_or_path, FOLDER, SUFFIX, f'odd {word_or_path}: no such file, and no shipped ODD',
    )


def read_odd(path: Path) -> Odd:
    """Read an ODD.

    Raises:
        UsageError: one line with the file, the key, and the expected value.
    """
    values = read_yaml(path)
    top = Section(path, values, _KEYS)
    name = top.text('name')
    source = top.text('source', '', kind='a text', empty=True)
    section = top.section('parameters')
    try:
        keys = by_key({key: key for key in section})
    except UsageError as error:
        raise section.wrong(str(error)) from None
    for given in keys.values():
        if given not in HUMAN_KEYS and given not in SHORT_FORMS:
            raise section.wrong(f'unknown key; known: {", ".join(HUMAN_KEYS)}', given)
    if not keys:
        raise top.wrong('has no parameter', 'parameters')
    parameters = tuple(
        _parameter(BY_KEY[key], section.section(given, _PARAMETER_KEYS))
        for key, given in keys.items()
    )
    units = {
        key: section.section(given).text('unit', '') for key, given in keys.items()
    }
    exclusions = tuple(
        _exclusion(one, parameters, units)
        for one in top.sections('exclude', ('when', 'why'), optional=True)
    )
    odd = Odd(
        name=name, source=source, parameters=parameters, exclusions=exclusions,
        text=json.dumps(values, sort_keys=True, ensure_ascii=False, default=str),
    )
    for number, each in odd.feasible(1).items():
        if not each.any():
            raise top.wrong('nothing of the ODD is left', 'exclude')
        for place in np.flatnonzero(~each):
            one = parameters[number[0]]
            raise top.wrong(
                f'{one.cells[place].label} of {one.field.label} is excluded with all else; leave '
                'it out of the parameter', 'exclude',
            )
    return odd


def _parameter(field: ScenarioField, given: Section) -> Parameter:
    source = given.text('source', '', kind='a text', empty=True)
    if field.kind is not Kind.NUMBER:
        for key in ('range', 'unit', 'cells', 'edges'):
            if key in given:
                raise given.wrong(f'{field.key} is no number; use values', key)
        return Parameter(field=field, cells=tuple(_words(field, given)), source=source)
    unit = given.text('unit', '')
    cells = [
        Cell(label=field.value_words(number), low=number, high=number)
        for number in _listed(field, given, 'values', unit, least=1)
    ] if 'values' in given else []
    if 'range' in given or 'edges' in given:
        cells += _ranged(field, given, unit)
    elif 'cells' in given:
        raise given.wrong('has no effect without a range', 'cells')
    if not cells:
        raise given.wrong('expected a range, edges or values')
    found = Parameter(field=field, cells=tuple(cells), source=source)
    if len(cells) > MOST_CELLS:
        raise given.wrong(f'{len(cells)} cells, more than {MOST_CELLS}')
    for one, other in itertools.combinations(cells, 2):
        if one.low == one.high and other.low - found.slack <= one.low <= other.high + found.slack:
            raise given.wrong(f'{one.label} is in two cells', 'values')
    return found


def _words(field: ScenarioField, given: Section) -> Iterator[Cell]:
    seen = set()
    for one in given.several('values'):
        value = _word(field, one, 'values')
        if value in seen:
            raise given.wrong(f'{value} is given twice', 'values')
        seen.add(value)
        switch = field.kind is Kind.SWITCH
        label = f'{field.label} {field.value_words(value == "True")}' if switch else value
        yield Cell(label=label, word=value)


def _word(field: ScenarioField, given: Section, key: str) -> str:
    """A value as in tables."""
    raw = given.take(key, 'a word')
    try:
        value = field.from_human(raw if isinstance(raw, bool) else str(raw))
        if field.catalogue is None:
            value = field.checked(value)
        return str(field.to_human(value))
    except UsageError as error:
        raise given.wrong(str(error).removeprefix('scenario: '), key) from None


def _number(field: ScenarioField, given: Section, key: str, raw: object, unit: str) -> float:
    """A number in the key's unit, of one in a unit."""
    plain = isinstance(raw, int | float) and not isinstance(raw, bool)
    try:
        typed = f'{raw} {unit}' if plain and unit else raw
        return float(field.to_human(field.from_human(typed)))
    except UsageError as error:
        # YAML reads 6:00 as 360, in the numbers of the Babylonians.
        clock = "; put a time in '…' quotes" if field is TIME_OF_DAY and plain else ''
        raise given.wrong(str(error).removeprefix('scenario: ') + clock, key) from None


def _listed(
    field: ScenarioField, given: Section, key: str, unit: str, *, least: int
) -> list[float]:
    """Numbers of a list, ascending."""
    raw = given.take(key, f'a list of {least} or more numbers')
    if not isinstance(raw, list) or len(raw) < least:
        raise given.wrong(expected(f'a list of {least} or more numbers', raw), key)
    found = [_number(field, given, key, one, unit) for one in raw]
    for one, other in itertools.pairwise(found):
        if not one < other:
            raise given.wrong(
                f'{field.value_words(other)} does not lie above {field.value_words(one)}; each '
                'number has to lie above the one before', key,
            )
    return found


def _ranged(field: ScenarioField, given: Section, unit: str) -> list[Cell]:
    if 'edges' in given:
        if 'cells' in given:
            raise given.wrong('edges are the cells already; leave one out', 'cells')
        edges = _listed(field, given, 'edges', unit, least=2)
        if 'range' in given and _ends(field, given, unit) != [edges[0], edges[-1]]:
            raise given.wrong('do not begin and end with the range', 'edges')
    else:
        low, high = _ends(field, given, unit)
        cells = given.whole('cells', 1, MOST_CELLS, _DEFAULT_CELLS)
        edges = [low + (high - low) * number / cells for number in range(cells)] + [high]
    return [
        Cell(label=_span(field, low, high), low=low, high=high)
        for low, high in itertools.pairwise(edges)
    ]


def _ends(field: ScenarioField, given: Section, unit: str) -> list[float]:
    found = _listed(field, given, 'range', unit, least=2)
    if len(found) != 2:
        raise given.wrong('expected two numbers; edges may be more', 'range')
    return found


def _span(field: ScenarioField, low: float, high: float) -> str:
    """Two ends and one unit: ``25 to 50 %``."""
    if field is TIME_OF_DAY:
        return f'{field.value_words(low)} to {field.value_words(high)}'
    ends = [field.form.format(end) if end else '0' for end in (low, high)]
    if any(abs(float(text) - end) > _SHOWN * (high - low)
           for text, end in zip(ends, (low, high), strict=True)):
        ends = [f'{end:.4g}' for end in (low, high)]
    unit = 'deg' if field.unit == '°' else field.unit
    return f'{ends[0]} to {ends[1]} {unit}'.rstrip()


def _exclusion(
    given: Section, parameters: tuple[Parameter, ...], units: Mapping[str, str]
) -> Exclusion:
    why = given.text('why', kind='a reason')
    when = given.section('when')
    known = {one.key: number for number, one in enumerate(parameters)}
    numbers: dict[int, tuple[float, float]] = {}
    words: dict[int, frozenset[str]] = {}
    texts = []
    for name in when:
        key = SHORT_FORMS.get(name, name)
        if key not in known:
            raise when.wrong(f'is no parameter of this ODD; known: {", ".join(known)}', name)
        one, number = parameters[known[key]], known[key]
        if number in numbers or number in words:
            raise when.wrong('is given twice', name)
        if one.numeric:
            numbers[number], text = _excluded_numbers(one, when, name, units[key])
        else:
            words[number], text = _excluded_words(one, when, name)
        texts.append(f'{one.field.label} {text}')
    if not texts:
        raise given.wrong('has no condition', 'when')
    slack = {number: parameters[number].slack for number in numbers}
    return Exclusion(
        numbers=numbers, slack=slack, words=words, why=why, text=', '.join(texts)
    )


def _excluded_numbers(
    one: Parameter, when: Section, name: str, unit: str
) -> tuple[tuple[float, float], str]:
    raw = when.take(name, 'a number or [low, high]')
    ends = raw if isinstance(raw, list) else [raw, raw]
    if len(ends) != 2:
        raise when.wrong(expected('a number or [low, high]', raw), name)
    low, high = (_number(one.field, when, name, end, unit) for end in ends)
    if low > high:
        raise when.wrong(f'{low:g} to {high:g} is empty', name)
    if not any(cell.low <= high and low <= cell.high for cell in one.cells):
        raise when.wrong(f'{low:g} to {high:g} is outside its cells already', name)
    text = _span(one.field, low, high) if low < high else one.field.value_words(low)
    return (low, high), text


def _excluded_words(one: Parameter, when: Section, name: str) -> tuple[frozenset[str], str]:
    found = [_word(one.field, value, name) for value in when.several(name)]
    for value in found:
        if value not in [cell.word for cell in one.cells]:
            raise when.wrong(f'{value} is none of its values', name)
    labels = {cell.word: cell.label.removeprefix(f'{one.field.label} ') for cell in one.cells}
    return frozenset(found), ' or '.join(labels[value] for value in found)
