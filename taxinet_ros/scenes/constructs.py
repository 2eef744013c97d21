"""Read what a compiled Scenic program says of a run's beginning; refuse all else it says.

Scenic targets simulators that execute behaviours, move many objects and monitor requirements. Here
a program defines only how a run *begins*: its global parameters, the pose of one aircraft, and
others on the ground with their paths. A statement, an object or a property with another purpose is
refused by name and line: statements where they are executed, objects and properties where they are
made. docs/scenic.md has the table.

Only the Scenic child may import this module.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib
import sys
import tokenize
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
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

from taxinet_ros.errors import near_miss
from taxinet_ros.scenes.programs import MODEL, SUFFIX, is_of_program
from taxinet_ros.scenes.values import (
    OVERRIDES,
    PLANE_KEYS,
    SHORT_PLANE_KEYS,
    UNTIL,
    Place,
    ProgramError,
    behavior_arguments,
    check_level,
    is_ground_object,
    objects_document,
    plain_value,
    scenario_parameters,
)

_NO_PROGRAMS = (
    *(str(Path(module.__file__ or '').parent) for module in (scenic, importlib)),
    str(Path(__file__).parent), '<',
)

_BAG = 'the bag of a run holds all of it'
_END = 'a run ends after "param duration_s" or by a rule of stop_on'
_FORMULA = 'a scene says how a run begins; what it has to fulfil is given as a formula'
_STATEMENTS: Mapping[str, tuple[str, str]] = {
    'record': ('record', _BAG),
    'record_initial': ('record initial', _BAG),
    'record_final': ('record final', _BAG),
    'terminate_when': ('terminate when', _END),
    'terminate_simulation_when': ('terminate simulation when', _END),
    'terminate_after': ('terminate after', _END),
    'require_monitor': ('require monitor', _FORMULA),
    'override': ('override', 'nothing changes an aircraft under way but its controller'),
    'simulator': ('simulator', 'the graph of taxinet_ros runs the scenes'),
}
"""Scenic's functions for statements without effect: the statement, and why."""

_NEUTRAL: Mapping[str, Any] = {
    'behavior': None, 'speed': 0, 'velocity': Vector(0, 0, 0), 'angularSpeed': 0,
    'angularVelocity': Vector(0, 0, 0), 'color': None, 'render': True, 'showVisibleRegion': False,
    'sensors': {}, 'lastActions': (), 'requireVisible': False, 'allowCollisions': True,
    'occluding': True,
}
"""Scenic's properties that mostly have no effect: the value that is none, too."""

_WITH_EFFECT = frozenset({
    *PLANE_KEYS, *SHORT_PLANE_KEYS, 'position', 'yaw', 'pitch', 'roll', 'orientation', 'heading',
    'parentOrientation', 'regionContainedIn', 'mutationScale', 'name',
})
_OF_GROUND_OBJECTS = frozenset({'kind', 'colour', 'behavior', 'width', 'length'})
_MUTATION = frozenset({'mutator', 'positionStdDev', 'headingStdDev', 'orientationStdDev'})
_SIZE = frozenset({
    'width', 'length', 'height', 'shape', 'baseOffset', 'contactTolerance',
    'sideComponentThresholds', 'onDirection',
})
_SIZE_READERS = frozenset({
    'require', 'workspace', 'contained', 'regionContainedIn', 'allowCollisions', 'requireVisible',
    'visible', 'of', 'on',
})
_VIEW_READERS = frozenset({'see', 'visible', 'requireVisible', 'visibleRegion'})
_VIEW = frozenset({
    'viewAngle', 'viewAngles', 'visibleDistance', 'viewRayDensity', 'viewRayCount',
    'viewRayDistanceScaling', 'cameraOffset', 'visionSensorOffset', 'occluding',
})

_WHY: Mapping[str, str] = {
    'behavior': 'the controller under test steers the aircraft',
    'color': 'the look of the aircraft is the same in all runs; of others write "with colour"',
    'speed': 'write "param speed_mps" for the aircraft, "with behavior GoStraight(5, 100)" for '
             'others',
    **dict.fromkeys(_MUTATION, 'without "mutate" nothing applies it'),
    **dict.fromkeys(_SIZE, 'no region, requirement or other place refers to it'),
    **dict.fromkeys(_VIEW, 'nothing asks what is visible'),
}

_DRAWS = 64
"""Draws inspected per parameter; misses a wet share of 1/3 with probability (2/3)**64."""


@dataclass(kw_only=True, slots=True)
class _Made:
    """An object: where it was made, what its specifiers say, and its values then."""

    thing: Any
    place: Place
    said: frozenset[str]
    began: dict[str, Any]


@dataclass(slots=True)
class Constructs:
    """Notes where a program sets parameters and makes objects, and checks it when it is compiled.

    Attributes:
        params: place where each global parameter was last set.
        overrides: place and values of each ``param overrides``.
    """

    params: dict[str, Place] = field(default_factory=dict)
    overrides: list[tuple[Place, dict[str, Any]]] = field(default_factory=list)
    _made: dict[int, _Made] = field(default_factory=dict)

    def _install(self) -> None:
        _keep_lines()
        parse = translator.parse_string
        translator.parse_string = lambda text, *args, **kwargs: parse(
            text.removeprefix('\ufeff'), *args, **kwargs
        )
        for function, (statement, why) in _STATEMENTS.items():
            setattr(veneer, function, _refusing(statement, why))
        veneer.require = _checking_require(veneer.require)
        veneer.mutate = _checking_mutate(veneer.mutate)
        veneer.param = self._watching_param(veneer.param)
        veneer.new = self._watching_new(veneer.new)

    def begin(self) -> None:
        """Forget the program before."""
        for memory in (self.params, self.overrides, self._made):
            memory.clear()

    def read(self, scenario: Any, files: Iterable[str]) -> dict[str, Any]:
        """Parameters, overrides and fixed ground objects of a compiled program, as JSON values.

        Args:
            scenario: what Scenic has compiled.
            files: the files that were read while it was compiled.

        Raises:
            ProgramError: the first construct without effect, its place, and what to do.
        """
        if compose := scenario.dynamicScenario._compose:
            code = compose.__code__
            raise ProgramError(
                _sentence('compose, precondition or invariant', 'each run is one scene'),
                (code.co_filename, code.co_firstlineno),
            )
        params = {
            name: self._parameter(name, value)
            for name, value in scenario_parameters(scenario.params).items()
        }
        readable = _Words(files).readable()
        for thing in scenario.objects:
            self._check_object(thing, scenario)
        for made in self._made.values():
            _check_properties(made, _with_effect(made.thing, scenario) | readable)
            _check_kept(made)
        others = [thing for thing in scenario.objects if thing is not scenario.egoObject]
        fixed: list[tuple[Place, str]] = []
        for thing in others:
            if not needsSampling(thing):
                place = self._made[id(thing)].place
                with _at(place):
                    fixed.append((place, objects_document([thing])))
        return {
            'params': params, 'overrides': self.overrides, 'objects': fixed,
            'random_objects': len(others) - len(fixed),
        }

    def place_of(self, key: str, scenario: Any) -> Place | None:
        """Where the program says a value of its scenes, by the name of a parameter or key."""
        objects = [thing for thing in scenario.objects
                   if (thing is scenario.egoObject) == (key in PLANE_KEYS)]
        if key in self.params or not objects:
            return self.params.get(key)
        return self._made[id(objects[0])].place

    # While it is compiled ----------------------------------------------------------------------

    def _watching_param(self, param: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(param)
        def watched(params: Mapping[str, Any]) -> Any:
            place = program_place()
            # Not Scenic's business: they replace what it has drawn.
            others = {name: value for name, value in params.items() if name != OVERRIDES}
            if OVERRIDES in params:
                self.overrides.append((place, _fixed_values(params[OVERRIDES], place)))
            for name in others:
                if not (veneer.loadingModel and name in veneer._globalParameters):
                    self.params[name] = place
            return param(others)

        return watched

    def _watching_new(self, new: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(new)
        def watched(kind: Any, specifiers: list[Any]) -> Any:
            thing = new(kind, specifiers)
            said = (name for one in specifiers if one.name.startswith('With(')
                    for name in one.priorities)
            made = _Made(thing=thing, place=program_place(), said=frozenset(said),
                         began=dict(vars(thing)))
            _check_names(made)
            self._made[id(thing)] = made
            return thing

        return watched

    # When it is compiled -----------------------------------------------------------------------

    def _parameter(self, name: str, value: Any) -> dict[str, Any]:
        """Place, some values, and the words to choose from, of a parameter."""
        place = self.params.get(name)
        words = value.options if isinstance(value, MultiplexerDistribution) else [value]
        return {
            'place': place, 'random': needsSampling(value),
            'values': [plain_value(name, drawn, place) for drawn in _drawn(value)],
            'words': [word for word in words if isinstance(word, str)],
        }

    def _check_object(self, thing: Any, scenario: Any) -> None:
        made, kind, is_ego = self._made[id(thing)], type(thing), thing is scenario.egoObject
        if not is_ego and not is_ground_object(thing):
            raise ProgramError(
                f'a further {kind.__name__}: it is no ground object of {MODEL} (ParkedAircraft, '
                'Vehicle, …), so it has no effect; leave it out, or write "new OrientedPoint" for '
                'a place to refer to', made.place,
            )
        if not needsSampling(thing):
            if thing.mutationScale != 0:
                raise ProgramError(
                    'mutationScale: has no effect here; write "mutate ego by SCALE"', made.place
                )
            check_level(thing, made.place)
        if not is_ego and thing.behavior is not None:
            with _at(made.place):
                behavior_arguments(thing.behavior)


class _Words:
    """The words of a program's sources, without comments and texts: what may read a property."""

    def __init__(self, files: Iterable[str]) -> None:
        self._words: set[str] = set()
        self._attributes: set[str] = set()
        for file in map(Path, filter(is_of_program, files)):
            if file.suffix in (SUFFIX, '.py') and file.name != f'{MODEL}{SUFFIX}':
                self._add(file)

    def _add(self, file: Path) -> None:
        before = ''
        with contextlib.suppress(OSError, SyntaxError, tokenize.TokenError), open(
            file, 'rb'
        ) as stream:
            for token in tokenize.tokenize(stream.readline):
                if token.type == tokenize.NAME:
                    (self._attributes if before == '.' else self._words).add(token.string)
                before = token.string

    def readable(self) -> set[str]:
        """Properties that the program may read; by ``getattr``, any."""
        found = self._attributes - _NEUTRAL.keys()
        if self._words & _SIZE_READERS:
            found |= _SIZE
        if self._words & _VIEW_READERS:
            found |= _VIEW
        if 'getattr' in self._words:
            found |= self._words - _NEUTRAL.keys()
        return found


def _with_effect(thing: Any, scenario: Any) -> set[str]:
    """Properties of an object that have an effect, whether the program reads them or not."""
    found = set(_WITH_EFFECT)
    if is_ground_object(thing):
        found |= _OF_GROUND_OBJECTS
        found.add('requireVisible')
        if any('height' in _declared(kind) for kind in type(thing).__mro__
               if kind.__module__ == MODEL):
            found.add('height')  # not of what lies flat
        found.add(UNTIL)
    others = (one for one in scenario.objects if one is not thing)
    if any(one.allowCollisions is not True for one in others):
        found.add('allowCollisions')
    if needsSampling(thing.mutationScale) or thing.mutationScale != 0:
        found |= _MUTATION
    return found


def _declared(kind: type) -> Iterable[str]:
    """Properties to which a class itself gives a value."""
    return vars(kind).get('_scenic_properties', ())


def _is_models(kind: type) -> bool:
    return kind.__module__ == MODEL or kind.__module__.partition('.')[0] in ('scenic', 'builtins')


@contextlib.contextmanager
def _at(place: Place) -> Iterator[None]:
    try:
        yield
    except ProgramError as error:
        raise ProgramError(str(error), place) from error


def _check_names(made: _Made) -> None:
    """Refuse a property that the class of an object does not have."""
    kind = type(made.thing)
    for name in sorted(made.said - kind._defaults.keys() - {'name'}):
        known = sorted({*Object._defaults, *kind._defaults})
        raise ProgramError(
            f'with {name}: no property of {kind.__name__}, so it has no effect'
            f'{near_miss(name, known)}; one that the program reads is declared in a class',
            made.place,
        )


def _check_properties(made: _Made, with_effect: Collection[str]) -> None:
    """Refuse properties without effect that the program says, or its classes."""
    own = (kind for kind in type(made.thing).__mro__ if not _is_models(kind))
    for name in sorted(made.said.union({'sensors'}, *map(_declared, own)).difference(with_effect)):
        value = getattr(made.thing, name, _NEUTRAL.get(name))
        if name not in _NEUTRAL or needsSampling(value) or value != _NEUTRAL[name]:
            raise ProgramError(
                _sentence(name, _WHY.get(name, 'nothing reads it')), made.place
            )


def _check_kept(made: _Made) -> None:
    """Refuse other changes to an existing object, as in a function; the line is unknown."""
    for name, value in vars(made.thing).items():
        if name.startswith('_') or name == 'mutationScale':  # set by the statement mutate
            continue
        if name not in made.began or made.began[name] is not value:
            raise ProgramError(
                f'{name} of the {type(made.thing).__name__} is set when the object is made '
                'already, so it has no effect; say it where the object is made: new Plane at '
                '(x, y), facing ANGLE', made.place,
            )


def _fixed_values(given: Any, place: Place) -> dict[str, Any]:
    """The values of ``param overrides``."""
    if not isinstance(given, Mapping) or not all(
        isinstance(value, bool | Real | str) for value in given.values()
    ):
        raise ProgramError(
            f'param {OVERRIDES}: expected fixed values by key, such as '
            "{'clouds': 'stratus', 'cross_track_m': 3}", place,
        )
    return {str(key): str(value) for key, value in given.items()}


def _drawn(value: Any) -> list[Any]:
    """Values of a parameter in some draws, or its constant value."""
    if not needsSampling(value):
        return [value]
    values: list[Any] = []
    with contextlib.suppress(Exception):  # program errors are reported when a scene is drawn
        values += (Samplable.sampleAll([value])[value] for _ in range(_DRAWS))
    return values


@functools.cache
def watch_constructs() -> Constructs:
    """What notes a program's parameters and objects; one per process, as Scenic is global."""
    constructs = Constructs()
    constructs._install()
    return constructs


def _refusing(statement: str, why: str) -> Callable[..., Any]:
    def refuse(*_: Any, **__: Any) -> None:
        raise ProgramError(_sentence(statement, why), program_place())

    return refuse


def _checking_require(require: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(require)
    def checked(
        number: int, condition: Any, line: int, name: str | None, prob: float = 1
    ) -> Any:
        for part in condition.flatten():
            if part.is_temporal:
                word = f'require {type(part).__name__.lower()}'
                raise ProgramError(_sentence(word, _FORMULA), program_place())
        if prob == 0:
            raise ProgramError(_sentence('require[0]', 'it never has to hold'), program_place())
        return require(number, condition, line, name, prob)

    return checked


def _checking_mutate(mutate: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(mutate)
    def checked(*objects: Any, scale: Any = 1) -> Any:
        if scale == 0 or not (objects or veneer.currentScenario._objects):
            raise ProgramError(
                _sentence('mutate', 'there is nothing yet that it moves'), program_place()
            )
        return mutate(*objects, scale=scale)

    return checked


def _sentence(word: str, why: str) -> str:
    return f'{word} has no effect here: {why}; leave it out'


def program_frame() -> FrameType | None:
    """The innermost frame of a program or of a module that it imports."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and frame.f_code.co_filename.startswith(_NO_PROGRAMS):
        frame = frame.f_back
    return frame


def program_place() -> Place:
    """The line of the program that is being executed."""
    frame = program_frame()
    return ('', 0) if frame is None else (frame.f_code.co_filename, frame.f_lineno)


def _keep_lines() -> None:
    """Give the code that Scenic generates the program's lines, which it loses."""
    kind = compiler.ScenicToPythonTransformer
    for name in ('visit', 'transformPropertyDef'):
        setattr(kind, name, _with_line(getattr(kind, name)))


def _with_line(translate: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(translate)
    def translated(self: Any, node: Any) -> Any:
        placed = None
        if isinstance(node, syntax.AST):  # some have no line, but their parts do
            placed = next((part for part in ast.walk(node) if hasattr(part, 'lineno')), None)
        made = translate(self, node)
        if placed is not None and isinstance(made, ast.AST) and not hasattr(made, 'lineno'):
            ast.copy_location(made, placed)
        return made

    return translated
