"""Refuse what a compiled Scenic program holds besides the beginning of runs, by name.

Scenic targets simulators that execute behaviours, move many objects and monitor requirements. Here
a program defines only how a run *begins*: the pose of one aircraft, the weather, and others
on the ground with their paths. Scenic compiles everything else too and silently drops it, so it is
looked for in the compiled scene. docs/scenic.md has the table.

Only the Scenic child may import this module.
"""

from __future__ import annotations

import ast
import contextlib
import difflib
import functools
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from types import FrameType
from typing import Any

import scenic
from scenic.core.distributions import MultiplexerDistribution, Samplable, needsSampling
from scenic.core.object_types import Object
from scenic.core.vectors import Vector
from scenic.syntax import ast as syntax
from scenic.syntax import compiler, translator, veneer

from taxinet_ros.core.datarefs import split_name
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.track import runway_track
from taxinet_ros.core.scenario_fields import (
    CATALOGUES,
    CLOUDS,
    HUMAN_KEYS,
    PARAMETERS,
    PLANE_KEYS,
    RAIN,
    SHORT_FORMS,
    TRAFFIC,
    by_key,
)
from taxinet_ros.core.traffic.traffic_file import typed_traffic
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.overrides import OVERRIDES, check_overrides, check_value
from taxinet_ros.scenes.paper_names import (
    PAPER_NAMES,
    PaperName,
    is_dataref,
    key_of,
    paper_name,
)
from taxinet_ros.scenes.programs import MODEL, beside, is_document_file
from taxinet_ros.scenes.values import (
    Place,
    ProgramError,
    behavior_arguments,
    check_level,
    is_ground_object,
    objects_document,
    placed_objects,
    plain_value,
    scenario_parameters,
)

_SCENIC, _IMPORTLIB = (str(Path(module.__file__ or '').parent) for module in (scenic, importlib))

_BAG = 'the bag of a run holds all of it'
_END = 'a run ends after "param duration_s" or by --stop-on'
_FORMULA = 'what a run has to fulfil is a formula of --spec'
_HELD: Mapping[str, tuple[str, str]] = {
    '_compose': ('compose, precondition or invariant', 'each run is one scene'),
    '_recordedExprs': ('record', _BAG),
    '_recordedInitialExprs': ('record initial', _BAG),
    '_recordedFinalExprs': ('record final', _BAG),
    '_terminationConditions': ('terminate when', _END),
    '_terminateSimulationConditions': ('terminate simulation when', _END),
    '_timeLimit': ('terminate after', 'write "param duration_s = SECONDS"'),
    '_monitorRequirements': ('require monitor', _FORMULA),
}
"""Attributes of a compiled scenario: the statement that fills each, and why it has no effect."""

_MOTION = 'a run begins at the taxiing speed of its aircraft'
_LOOK = 'the look of the aircraft is the same in all runs'
_WITHOUT_EFFECT: Mapping[str, tuple[Any, str]] = {
    'behavior': (None, 'the controller under test steers the aircraft'),
    'speed': (0, _MOTION),
    'velocity': (Vector(0, 0, 0), _MOTION),
    'angularSpeed': (0, _MOTION),
    'angularVelocity': (Vector(0, 0, 0), _MOTION),
    'color': (None, _LOOK),
    'render': (True, _LOOK),
    'showVisibleRegion': (False, 'there is no viewer'),
    'sensors': ({}, 'the camera of the aircraft is fixed, and bags hold what it saw'),
    'lastActions': ((), 'the controller under test steers the aircraft'),
}
"""Built-in Scenic properties that are unused here: the only value allowed for each."""

_OF_GROUND_OBJECTS = {
    'speed': 'a behavior says how fast it moves, such as "with behavior GoStraight(5, 100)"',
    'color': 'write "with colour" and a word, such as "with colour \'red\'"',
}

_PARAMETER_FORMS = tuple(
    name for name in (*PARAMETERS, *SHORT_FORMS) if SHORT_FORMS.get(name, name) in PARAMETERS
)

_DRAWS = 64
"""Draws inspected per parameter; misses a wet share of 1/3 with probability (2/3)**64."""

_IN_PERCENT = (
    'in percent: 100 * (fraction), such as "param rain_percent = Range(25, 100)"; it is a fraction '
    'beside zulu_time or cloud_type only'
)


@dataclass(kw_only=True, slots=True)
class _Made:
    """Place of an object's creation, and its initial values."""

    thing: Any
    place: Place
    began: dict[str, Any]


@dataclass(slots=True)
class Constructs:
    """Notes where a program sets parameters and makes objects, and checks it when it is compiled.

    Attributes:
        params: place where each global parameter was last set.
        overrides: values of ``param overrides``, as text.
    """

    params: dict[str, Place] = field(default_factory=dict)
    overrides: dict[str, str] = field(default_factory=dict)
    _path: Path = field(default_factory=Path)
    _made: dict[int, _Made] = field(default_factory=dict)

    def _install(self) -> None:
        _keep_lines()
        parse = translator.parse_string
        translator.parse_string = lambda text, *args, **kwargs: parse(
            text.removeprefix('\ufeff'), *args, **kwargs
        )
        veneer.override = _refuse_override
        veneer.param = self._watching_param(veneer.param)
        veneer.new = self._watching_new(veneer.new)

    def begin(self, program: Path) -> None:
        """Forget the program before, and begin with another."""
        self._path = program
        for memory in (self.params, self.overrides, self._made):
            memory.clear()

    def notes(self, scenario: Any) -> list[list[Any]]:
        """File, line and text of notes on likely mistakes in a program."""
        name = RAIN.key if RAIN.key in scenario.params else RAIN.short
        if paper_name(name, scenario.params) is not None:
            text = f'param {name} is a fraction, as in the paper, beside zulu_time or cloud_type'
            return [[*self.params.get(name, (str(self._path), 0)), text]]
        values = _numbers(scenario.params.get(name, 0))
        if not 0 < max(values, default=0) <= 1:
            return []
        shown = ' to '.join(dict.fromkeys(f'{end:.2g}' for end in (min(values), max(values))))
        text = (
            f'param {name} is {shown}, and rain is in percent: less than anybody sees; if '
            'fractions are meant, write 100 times as much'
        )
        return [[*self.params.get(name, (str(self._path), 0)), text]]

    def named_documents(self, scenario: Any) -> list[str]:
        """Files of documents that a compiled program's parameters name, by themselves or chosen."""
        words: list[Any] = []
        for value in (scenario.params[key] for key in CATALOGUES if key in scenario.params):
            words += value.options if isinstance(value, MultiplexerDistribution) else [value]
        return [word for word in words if isinstance(word, str) and is_document_file(word)]

    def check(self, scenario: Any) -> None:
        """Refuse constructs without effect in a compiled program.

        Raises:
            ProgramError: the first such construct, its place, and what to do.
        """
        self._check_statements(scenario)
        params = scenario_parameters(scenario.params)
        for name in params:
            self._check_name(name)
        self._check_forms(params)
        self._check_fraction(params)
        for name, value in params.items():
            meant = paper_name(name, params)
            if meant is None:
                self._check_value(name, value)
            else:
                self._check_paper_value(name, meant, value)
        others = [thing for thing in scenario.objects if thing is not scenario.egoObject]
        for thing in scenario.objects:
            self._check_object(thing, is_ego=thing is scenario.egoObject)
        if others and TRAFFIC.key in params:
            raise ProgramError(
                'param traffic has no effect here: objects are placed below; leave one out',
                self.params.get(TRAFFIC.key),
            )

    # While it is compiled ----------------------------------------------------------------------

    def _watching_param(self, param: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(param)
        def watched(params: Mapping[str, Any]) -> Any:
            place = _place(sys._getframe(1))
            # Not Scenic's business: they replace what it has drawn.
            others = {name: value for name, value in params.items() if name != OVERRIDES}
            if OVERRIDES in params:
                self.overrides |= _fixed_values(params[OVERRIDES], self._path, place)
            for name in others:
                if not (veneer.loadingModel and name in veneer._globalParameters):
                    self.params[name] = place
            return param(others)

        return watched

    def _watching_new(self, new: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(new)
        def watched(kind: Any, specifiers: list[Any]) -> Any:
            thing = new(kind, specifiers)
            self._made[id(thing)] = _Made(
                thing=thing, place=_place(sys._getframe(1)), began=dict(vars(thing))
            )
            return thing

        return watched

    # When it is compiled -----------------------------------------------------------------------

    def _check_statements(self, scenario: Any) -> None:
        held = scenario.dynamicScenario
        for attribute, (statement, why) in _HELD.items():
            filled = getattr(held, attribute)
            if filled or (attribute == '_timeLimit' and filled is not None):
                line = getattr(filled[0], 'line', 0) if isinstance(filled, list) else 0
                raise ProgramError(_sentence(statement, why), self._line(statement, line))
        if scenario.simulator is not None:
            raise ProgramError(_sentence('simulator', 'the graph of taxinet_ros runs the scenes'))
        for required in scenario.userRequirements:
            for part in required.proposition.flatten():
                if part.is_temporal:
                    word = f'require {type(part).__name__.lower()}'
                    raise ProgramError(
                        _sentence(word, f'a scene says how a run begins; {_FORMULA}'),
                        self._line('require', required.line),
                    )

    def _line(self, statement: str, line: int) -> Place:
        """Place of a statement, whose line is of the program or of a module that it imports."""
        with contextlib.suppress(OSError, UnicodeDecodeError, IndexError):
            text = self._path.read_text(encoding='utf-8').splitlines()[line - 1]
            if line and statement.split()[0] in text:
                return str(self._path), line
        return str(self._path), 0

    def _check_name(self, name: str) -> None:
        place = self.params.get(name)
        key = SHORT_FORMS.get(name, name)
        if key in PLANE_KEYS:
            raise ProgramError(
                f'parameter {name!r} belongs to the plane: place the ego there', place
            )
        if key in HUMAN_KEYS or name in PAPER_NAMES:
            return
        if is_dataref(name):
            try:
                split_name(name)
            except UsageError as error:
                raise ProgramError(f'param {error}', place) from error
            return
        raise ProgramError(
            f'param {name}: unknown, so it has no effect{_meant(name, _PARAMETER_FORMS)}; '
            f'known: {", ".join(PARAMETERS)}', place,
        )

    def _check_forms(self, params: Mapping[str, Any]) -> None:
        said: dict[str, str] = {}
        for name in sorted(params, key=len):
            other = said.setdefault(key_of(name, params), name)
            if other != name and not (is_dataref(name) and is_dataref(other)):
                raise ProgramError(
                    f'param {other} and param {name} are the same; leave one out',
                    max(self.params.get(other, ('', 0)), self.params.get(name, ('', 0))),
                )

    def _check_fraction(self, params: Mapping[str, Any]) -> None:
        """Detect rain given as a fraction, as in the paper, instead of a percentage."""
        value = params.get(RAIN.key)
        if paper_name(RAIN.key, params) is not None:
            return
        if needsSampling(value) and 0 < max(_numbers(value), default=0) <= 1:
            raise ProgramError(
                f'param {RAIN.key}: here it is {_IN_PERCENT}', self.params.get(RAIN.key)
            )

    def _check_value(self, name: str, value: Any) -> None:
        place = self.params.get(name)
        for drawn in _drawn(value):
            plain = plain_value(name, drawn, place)
            if is_dataref(name) and not isinstance(plain, float):
                raise ProgramError(f'{name} is {plain!r:.60}; expected a number', place)
            if name == 'clouds' and not isinstance(plain, str):
                raise ProgramError(f'clouds is {plain:g}, not one of {", ".join(CLOUDS)}', place)
            if isinstance(plain, str) and name != 'date':  # a date may be computed, and invalid
                self._check_word(name, plain, place)
        for option in value.options if isinstance(value, MultiplexerDistribution) else ():
            if isinstance(option, str):
                self._check_word(name, option, place)

    def _check_word(self, name: str, word: str, place: Place | None) -> None:
        """Refuse a word that is misspelt, hence invalid in every run."""
        if name in CATALOGUES and is_document_file(word):
            word = str(beside(self._path, word))
        try:
            check_value(name, word)
        except UsageError as error:
            raise ProgramError(f'param {str(error).removeprefix("scenario: ")}', place) from error

    def _check_paper_value(self, name: str, meant: PaperName, value: Any) -> None:
        place = self.params.get(name)
        for drawn in _drawn(value):
            try:
                meant.check(name, plain_value(name, drawn, place))
            except UsageError as error:
                raise ProgramError(f'param {error}', place) from error

    def _check_object(self, thing: Any, *, is_ego: bool) -> None:
        made, kind = self._made[id(thing)], type(thing).__name__
        if not is_ego and not is_ground_object(thing):
            raise ProgramError(
                f'a further {kind}: it is no ground object of {MODEL} (ParkedAircraft, Vehicle, '
                '…), so it has no effect; leave it out, or write "new OrientedPoint" for a place '
                'to refer to', made.place,
            )
        for name, (neutral, why) in _WITHOUT_EFFECT.items():
            value = getattr(thing, name)
            if (needsSampling(value) or value != neutral) and (is_ego or name != 'behavior'):
                if not is_ego and name in _OF_GROUND_OBJECTS:
                    raise ProgramError(f'with {name}: {_OF_GROUND_OBJECTS[name]}', made.place)
                raise ProgramError(_sentence(name, why), made.place)
        for name in sorted({*thing.properties} - {*type(thing)._defaults, 'name'}):
            known = sorted({*Object._defaults, *type(thing)._defaults})
            raise ProgramError(
                f'with {name}: no property of {kind}, so it has no effect{_meant(name, known)}; '
                'one that the program reads is declared in a class', made.place,
            )
        _check_kept(made)
        if not needsSampling(thing):
            if thing.mutationScale != 0:
                raise ProgramError(
                    'mutationScale: has no effect here; write "mutate ego by SCALE"', made.place
                )
            check_level(thing, made.place)
        if not is_ego:
            _check_traffic(thing, made.place)


def _check_traffic(thing: Any, place: Place) -> None:
    """Check that a ground object can stand and move as it is to."""
    try:
        if thing.behavior is not None:
            behavior_arguments(thing.behavior)
        if not needsSampling(thing):
            line = runway_track(default_runway())
            typed_traffic(placed_objects(objects_document([thing]), line))
    except (ProgramError, UsageError) as error:
        text = str(error).removeprefix('traffic: objects[0].').removeprefix('path[0].')
        raise ProgramError(text, place) from error


def _fixed_values(given: Any, program: Path, place: Place) -> dict[str, str]:
    """The values of ``param overrides``, checked, as text by key."""
    if not isinstance(given, Mapping) or not all(
        isinstance(value, bool | Real | str) for value in given.values()
    ):
        raise ProgramError(
            f'param {OVERRIDES}: expected fixed values by key, such as '
            "{'clouds': 'stratus', 'cross_track_m': 3}", place,
        )
    texts = {
        str(key): str(beside(program, value) if is_document_file(str(value)) else value)
        for key, value in given.items()
    }
    try:
        check_overrides(texts)
        return by_key(texts)
    except UsageError as error:
        raise ProgramError(f'param {OVERRIDES}: {error}', place) from error


def _drawn(value: Any) -> list[Any]:
    """Values of a parameter in some draws, or its constant value."""
    if not needsSampling(value):
        return [value]
    values: list[Any] = []
    with contextlib.suppress(Exception):  # program errors are reported when a scene is drawn
        values += (Samplable.sampleAll([value])[value] for _ in range(_DRAWS))
    return values


def _numbers(value: Any) -> list[float]:
    """Numbers among the drawn values of a parameter, or its constant value."""
    return [float(number) for number in _drawn(value) if isinstance(number, Real)]


@functools.cache
def watch_constructs() -> Constructs:
    """What notes a program's parameters and objects; one per process, as Scenic is global.

    Compiled code keeps the program's line numbers from then on.
    """
    constructs = Constructs()
    constructs._install()
    return constructs


def _refuse_override(*_: Any) -> None:
    raise ProgramError(
        _sentence('override', 'nothing changes an aircraft under way but its controller'),
        _place(sys._getframe(1)),
    )


def _sentence(word: str, why: str) -> str:
    return f'{word} has no effect here: {why}; leave it out'


def _meant(name: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, known, 1)
    return f'; did you mean {SHORT_FORMS.get(close[0], close[0])}?' if close else ''


def _place(frame: FrameType) -> Place:
    """Place in the program's own text that is being executed, skipping Scenic's frames."""
    place, step = (frame.f_code.co_filename, frame.f_lineno), frame
    while step.f_code.co_filename.startswith((_SCENIC, '<', _IMPORTLIB)):
        if step.f_back is None:
            return place
        step = step.f_back
    return step.f_code.co_filename, step.f_lineno


def _check_kept(made: _Made) -> None:
    """Refuse other changes to an existing object, as in a function; the line is unknown."""
    for name, value in vars(made.thing).items():
        if name.startswith('_') or name == 'mutationScale':  # set by the statement mutate
            continue
        if name not in made.began or made.began[name] is not value:
            raise ProgramError(_late(f'{name} of the {type(made.thing).__name__}'), made.place)


def _late(what: str) -> str:
    return (f'{what} is set when the object is made already, so it has no effect; say it where '
            'the object is made: new Plane at (x, y), facing ANGLE')


def _keep_lines() -> None:
    """Make the Python code that Scenic generates keep the program's line numbers."""
    kind = compiler.ScenicToPythonTransformer
    for name in ('visit', 'transformPropertyDef'):
        setattr(kind, name, _with_line(getattr(kind, name)))


def _with_line(translate: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(translate)
    def translated(self: Any, node: Any) -> Any:
        placed = None
        if isinstance(node, syntax.AST):  # some have no line, but their parts do
            placed = next((part for part in _below(node) if _line(part)), None)
        made = translate(self, node)
        if placed is not None and isinstance(made, ast.AST) and not _line(made):
            ast.copy_location(made, placed)
        return made

    return translated


def _below(tree: ast.AST) -> Iterator[ast.AST]:
    """Every node of a Scenic syntax tree."""
    yield tree
    for _, value in ast.iter_fields(tree):
        for node in value if isinstance(value, (list, tuple)) else [value]:
            if isinstance(node, ast.AST):
                yield from _below(node)


def _line(node: ast.AST) -> int:
    return int(getattr(node, 'lineno', 0))
