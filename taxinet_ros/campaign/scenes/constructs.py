"""Refuse Scenic constructs that have no effect on a run, by name and line.

Scenic targets simulators that execute behaviours, move many objects and monitor requirements. Here
a program defines only how a run *begins*: the pose of one aircraft, the weather, and others
on the ground with their paths. Scenic compiles everything else too and silently drops it, so it is
detected during compilation: statements
(``record``, ``terminate when``, …) when executed, so that a library may contain ones that the
program does not use; definitions in the program itself (``behavior``, …) where they are defined;
objects and their properties after compilation. docs/scenic.md has the table.

Only the Scenic child may import this module.
"""

from __future__ import annotations

import ast
import contextlib
import difflib
import functools
import importlib
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from types import FrameType
from typing import Any

import scenic
from scenic.core.distributions import MultiplexerDistribution, Samplable, needsSampling
from scenic.core.object_types import Object
from scenic.core.regions import AllRegion
from scenic.core.vectors import Vector
from scenic.syntax import ast as syntax
from scenic.syntax import compiler, translator, veneer

from taxinet_ros.campaign.scenes.chance import check_clocks
from taxinet_ros.campaign.scenes.overrides import OVERRIDES, check_overrides, check_value
from taxinet_ros.campaign.scenes.paper_names import (
    PAPER_NAMES,
    PaperName,
    is_dataref,
    key_of,
    paper_name,
)
from taxinet_ros.campaign.scenes.programs import MODEL, beside, is_document_file
from taxinet_ros.campaign.scenes.values import (
    BEHAVIORS,
    KIND,
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
    other_form,
)
from taxinet_ros.core.traffic.traffic import KINDS
from taxinet_ros.core.traffic.traffic_file import typed_traffic
from taxinet_ros.errors import UsageError

_SCENIC, _IMPORTLIB = (str(Path(module.__file__ or '').parent) for module in (scenic, importlib))

_STATEMENTS = {
    'record': ('record', 'the bag of a run holds all of it'),
    'record_initial': ('record initial', 'the bag of a run holds all of it'),
    'record_final': ('record final', 'the bag of a run holds all of it'),
    'terminate_when': ('terminate when', 'a run ends after "param duration_s" or by --stop-on'),
    'terminate_simulation_when': (
        'terminate simulation when', 'a run ends after "param duration_s" or by --stop-on'
    ),
    'terminate_after': ('terminate after', 'write "param duration_s = SECONDS"'),
    'require_monitor': ('require monitor', 'what a run has to fulfil is a formula of --spec'),
    'override': ('override', 'nothing changes an aircraft under way but its controller'),
    'simulator': ('simulator', 'the graph of taxinet_ros runs the scenes'),
}
"""Scenic functions: the statement that calls each, and why it has no effect."""

_DEFINITIONS = {
    syntax.BehaviorDef: (
        'behavior', f'other objects move by {", ".join(BEHAVIORS)} of {MODEL}, and the controller '
        'under test steers the aircraft',
    ),
    syntax.MonitorDef: ('monitor', 'what a run has to fulfil is a formula of --spec'),
    syntax.Precondition: ('precondition', 'write "require" for what has to hold at the start'),
    syntax.Invariant: ('invariant', 'what a run has to fulfil is a formula of --spec'),
}

_COMPOSE = ('compose', 'each run is one scene')

_MOTION = 'a run begins at the taxiing speed of its aircraft'
_LOOK = 'the look of the aircraft is the same in all runs'
_LEVEL = 'the aircraft stands on its wheels'
_WITHOUT_EFFECT: Mapping[str, tuple[Any, str]] = {
    'behavior': (None, 'the controller under test steers the aircraft'),
    'speed': (0, _MOTION),
    'velocity': (Vector(0, 0, 0), _MOTION),
    'angularSpeed': (0, _MOTION),
    'angularVelocity': (Vector(0, 0, 0), _MOTION),
    'pitch': (0, _LEVEL),
    'roll': (0, _LEVEL),
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

_SIZE = 'the size of the aircraft matters only where the program asks for it: in a region that ' \
        'contains it, beside another place, or in a require'
_VIEW = 'it matters to "visible" and "can see" only; the camera of the aircraft is fixed'
_NOISE = 'it matters with "mutate ego" only'
_MATTERS_WITH: Mapping[str, tuple[str, str]] = {
    **dict.fromkeys(
        ('width', 'length', 'height', 'shape', 'baseOffset', 'contactTolerance',
         'sideComponentThresholds', 'onDirection'), ('size', _SIZE),
    ),
    **dict.fromkeys(
        ('visibleDistance', 'viewAngle', 'viewAngles', 'viewRayDensity', 'viewRayCount',
         'viewRayDistanceScaling', 'cameraOffset', 'visionSensorOffset'), ('view', _VIEW),
    ),
    **dict.fromkeys(
        ('mutator', 'positionStdDev', 'headingStdDev', 'orientationStdDev'), ('mutate', _NOISE),
    ),
}
"""Properties that Scenic reads only for some constructs: which, and why."""

_USES: Mapping[str, tuple[type, ...]] = {
    'size': (
        syntax.DirectionOfSpecifier, syntax.OnSpecifier, syntax.PositionOfOp, syntax.Require,
        syntax.ContainedInSpecifier,
    ),
    'view': (
        syntax.VisibleSpecifier, syntax.NotVisibleSpecifier, syntax.VisibleOp, syntax.NotVisibleOp,
        syntax.VisibleFromOp, syntax.NotVisibleFromOp, syntax.CanSeeOp,
    ),
}

_PARAMETER_FORMS = tuple(
    name for name in (*PARAMETERS, *SHORT_FORMS) if SHORT_FORMS.get(name, name) in PARAMETERS
)

_DRAWS = 64
"""Draws inspected per parameter; misses a wet share of 1/3 with probability (2/3)**64."""

_KEPT = frozenset({'name', 'allowCollisions', 'requireVisible', 'occluding'})
"""Properties allowed although they have no effect: a label, and those for several objects."""

_IN_PERCENT = (
    'in percent: 100 * (fraction), such as "param rain_percent = Range(25, 100)"; it is a fraction '
    'beside zulu_time or cloud_type only'
)


@dataclass(kw_only=True, slots=True)
class _Made:
    """Place of an object's creation, places of its ``with`` specifiers, and its initial values."""

    thing: Any
    place: Place
    given: dict[str, Place]
    began: dict[str, Any]


@dataclass(slots=True)
class Constructs:
    """Monitors each program while Scenic compiles it.

    Attributes:
        params: place where each global parameter was last set.
        overrides: values of ``param overrides``, as text.
    """

    params: dict[str, Place] = field(default_factory=dict)
    overrides: dict[str, str] = field(default_factory=dict)
    _path: Path = field(default_factory=Path)
    _program: str = ''
    _depths: dict[str, int] = field(default_factory=dict)
    _made: dict[int, _Made] = field(default_factory=dict)
    _uses: set[str] = field(default_factory=set)
    _read: set[str] = field(default_factory=set)

    def _install(self) -> None:
        _keep_lines()
        parse = translator.parse_string
        translator.parse_string = lambda text, *args, **kwargs: parse(
            text.removeprefix('\ufeff'), *args, **kwargs
        )
        translator.compileScenicAST = self._watching_text(translator.compileScenicAST)
        for name, (statement, why) in _STATEMENTS.items():
            setattr(veneer, name, functools.partial(_refuse_here, statement, why))
        translator.constructScenarioFrom = _choosing(translator.constructScenarioFrom)
        veneer.require = _watching_require(veneer.require)
        veneer.param = self._watching_param(veneer.param)
        veneer.mutate = _watching_mutate(veneer.mutate)
        veneer.With = _watching_with(veneer.With)
        veneer.new = self._watching_new(veneer.new)

    def begin(self, program: Path) -> None:
        """Reset, and start monitoring a program."""
        self._path, self._program = program, str(program.resolve())
        for memory in (
            self.params, self.overrides, self._depths, self._made, self._uses, self._read,
        ):
            memory.clear()

    def notes(self, scenario: Any) -> list[list[Any]]:
        """File, line and text of notes on likely mistakes in a program."""
        name = RAIN.key if RAIN.key in scenario.params else RAIN.short
        if paper_name(name, scenario.params) is not None:
            text = f'param {name} is a fraction, as in the paper, beside zulu_time or cloud_type'
            return [[*self.params.get(name, (self._program, 0)), text]]
        values = _numbers(scenario.params.get(name, 0))
        if not 0 < max(values, default=0) <= 1:
            return []
        shown = ' to '.join(dict.fromkeys(f'{end:.2g}' for end in (min(values), max(values))))
        text = (
            f'param {name} is {shown}, and rain is in percent: less than anybody sees; if '
            'fractions are meant, write 100 times as much'
        )
        return [[*self.params.get(name, (self._program, 0)), text]]

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
        self._check_scenario(scenario.dynamicScenario)
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
        for made in self._made.values():
            _check_kept(made)
        others = [thing for thing in scenario.objects if thing is not scenario.egoObject]
        for thing in others:
            if not is_ground_object(thing):
                self._refuse_object(thing)
            self._check_ground_object(scenario, thing)
        if others and TRAFFIC.key in params:
            raise ProgramError(
                'param traffic has no effect here: objects are placed below; leave one out',
                self.params.get(TRAFFIC.key),
            )
        if scenario.egoObject is not None:
            self._check_ego(scenario, scenario.egoObject)

    # While it is compiled ----------------------------------------------------------------------

    def _watching_text(self, compile_text: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(compile_text)
        def watched(tree: Any, filename: str = '<unknown>', **others: Any) -> Any:
            nodes = sorted(_below(tree), key=_line)
            for use, kinds in _USES.items():
                if any(isinstance(node, kinds) for node in nodes):
                    self._uses.add(use)
            self._read |= {node.attr for node in nodes if isinstance(node, ast.Attribute)}
            if filename == self._program:
                _check_definitions(nodes, filename)
            return compile_text(tree, filename=filename, **others)

        return watched

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
                    self._note_param(name, place)
            return param(others)

        return watched

    def _note_param(self, name: str, place: Place) -> None:
        """Record where a parameter is set; only imported ones may be set again."""
        depth = veneer.activity
        if depth >= self._depths.get(name, depth + 1):
            file, line = self.params[name]
            where = f'line {line}' if file == place[0] else f'{Path(file).name}:{line}'
            raise ProgramError(
                f'param {name} is set twice, so {where} has no effect; leave one out', place
            )
        self.params[name], self._depths[name] = place, depth

    def _watching_new(self, new: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(new)
        def watched(kind: Any, specifiers: list[Any]) -> Any:
            given = {
                name: specifier._taxinet_place for specifier in specifiers
                for name in specifier.priorities if hasattr(specifier, '_taxinet_place')
            }
            for name in (*PLANE_KEYS, *map(other_form, PLANE_KEYS)):
                if name in given and name in getattr(kind, '_finalProperties', ()):
                    raise ProgramError(
                        f'with {name}: it follows from where the aircraft stands; say that with '
                        '"at", "in", "on" or "facing"', given[name],
                    )
            thing = new(kind, specifiers)
            self._made[id(thing)] = _Made(
                thing=thing, place=_place(sys._getframe(1)), given=given, began=dict(vars(thing)),
            )
            return thing

        return watched

    # When it is compiled -----------------------------------------------------------------------

    def _check_scenario(self, chosen: Any) -> None:
        """Check the scenario block of a library; Scenic makes guards part of ``compose``."""
        if chosen._compose is not None:
            code = chosen._compose.__code__
            raise ProgramError(_sentence(*_COMPOSE), (code.co_filename, code.co_firstlineno))

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

    def _refuse_object(self, thing: Any) -> None:
        made = self._made.get(id(thing))
        kind = type(thing).__name__
        raise ProgramError(
            f'a further {kind}: it is no ground object of {MODEL} (ParkedAircraft, Vehicle, …), so '
            'it has no effect; leave it out, or write "new OrientedPoint" for a place to refer to',
            made.place if made else None,
        )

    def _check_ground_object(self, scenario: Any, thing: Any) -> None:
        place, given = self._given(thing)
        word = f'a {type(thing).__name__}'
        flat = thing.kind in KINDS and not KINDS[thing.kind].solid
        own = self._made[id(thing)].given
        for name in (KIND, *(('height', 'behavior') if flat else ())):
            if name in own:
                why = 'lies on the ground' if name != KIND else 'is what its class says'
                raise ProgramError(f'with {name}: {word} {why}; leave it out', own[name])
        for name, where in given.items():
            if name in _OF_GROUND_OBJECTS and name in own:
                raise ProgramError(f'with {name}: {_OF_GROUND_OBJECTS[name]}', where)
            if name not in ('behavior', 'width', 'length', 'height'):
                self._check_property(scenario, thing, name, where)
        self._check_pose(thing, place, given)
        try:
            if thing.behavior is not None:
                behavior_arguments(thing.behavior)
            if not needsSampling(thing):
                line = runway_track(default_runway())
                typed_traffic(placed_objects(objects_document([thing]), line))
        except (ProgramError, UsageError) as error:
            text = str(error).removeprefix('traffic: objects[0].').removeprefix('path[0].')
            raise ProgramError(text, given.get('behavior', place)) from error

    def _given(self, thing: Any) -> tuple[Place, dict[str, Place]]:
        """Where an object is made, and where its properties are set."""
        made = self._made.get(id(thing))
        given = {**_of_classes(type(thing)), **(made.given if made else {})}
        return (made.place if made else (self._program, 0)), given

    def _check_ego(self, scenario: Any, ego: Any) -> None:
        place, given = self._given(ego)
        for name, where in given.items():
            self._check_property(scenario, ego, name, where)
        self._check_pose(ego, place, given)

    def _check_pose(self, ego: Any, place: Place, given: Mapping[str, Place]) -> None:
        """Refuse a mutation without effect, an altitude, a tilt, and what is no number."""
        if _mutated(ego) and not needsSampling(ego):
            raise ProgramError(
                'mutationScale: has no effect here; write "mutate ego by SCALE"',
                given.get('mutationScale', place),
            )
        if type(ego.position) is Vector:
            if needsSampling(ego.position.z):
                raise ProgramError(_sentence('a random altitude', _LEVEL), place)
            for axis, value in zip('xy', ego.position.coordinates, strict=False):
                for drawn in _drawn(value):
                    plain_value(axis, drawn, place)
        if not needsSampling(ego):
            check_level(ego, place)

    def _check_property(self, scenario: Any, ego: Any, name: str, place: Place) -> None:
        if name in _WITHOUT_EFFECT:
            neutral, why = _WITHOUT_EFFECT[name]
            value = getattr(ego, name)
            if needsSampling(value) or value != neutral:
                raise ProgramError(_sentence(name, why), place)
        elif name in _MATTERS_WITH:
            use, why = _MATTERS_WITH[name]
            uses = {*self._uses, *_uses_of(scenario, ego)}
            if use not in uses:
                raise ProgramError(f'{name} has no effect here: {why}', place)
        elif name not in {*type(ego)._defaults, *self._read, *_KEPT}:
            known = sorted({*Object._defaults, *type(ego)._defaults})
            raise ProgramError(
                f'with {name}: no property of {type(ego).__name__}, so it has no effect'
                f'{_meant(name, known)}', place,
            )


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
    """The monitor of Scenic's statements; one per process, as Scenic is global.

    Compiled code keeps the program's line numbers from then on.
    """
    constructs = Constructs()
    constructs._install()
    return constructs


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


def _refuse_here(statement: str, why: str, *_: Any, **__: Any) -> None:
    raise ProgramError(_sentence(statement, why), _place(sys._getframe(1)))


def _watching_require(require: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(require)
    def watched(number: int, condition: Any, *args: Any, **kwargs: Any) -> Any:
        for part in condition.flatten():
            if part.is_temporal:
                word = type(part).__name__.lower()
                raise ProgramError(
                    f'require {word} has no effect here: a scene says how a run begins; what a run '
                    'has to fulfil is a formula of --spec', _place(sys._getframe(1)),
                )
        return require(number, condition, *args, **kwargs)

    return watched


def _choosing(construct: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(construct)
    def chosen(namespace: Mapping[str, Any], scenario: str | None = None) -> Any:
        names = [kind.__name__ for kind in namespace['_scenarios']]
        if len(names) > 1 and 'Main' not in namespace:
            raise ProgramError(f'scenario {", ".join(names)}: call the one to be run Main')
        return construct(namespace, scenario)

    return chosen


def _watching_mutate(mutate: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(mutate)
    def watched(*things: Any, **kwargs: Any) -> Any:
        if not things and not veneer.currentScenario._objects:
            raise ProgramError(
                'mutate has no effect here: there is no object yet; write it below the ego',
                _place(sys._getframe(1)),
            )
        return mutate(*things, **kwargs)

    return watched


def _watching_with(make: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(make)
    def watched(name: str, value: Any) -> Any:
        specifier = make(name, value)
        specifier._taxinet_place = _place(sys._getframe(1))
        return specifier

    return watched


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


def _check_definitions(nodes: list[ast.AST], filename: str) -> None:
    for node in nodes:
        word, why = _DEFINITIONS.get(type(node), ('', ''))
        if isinstance(node, syntax.ScenarioDef) and node.compose:
            node, (word, why) = node.compose[0], _COMPOSE
        if word:
            raise ProgramError(_sentence(word, why), (filename, _line(node)))
    check_clocks(nodes, filename)
    _check_assignments(nodes, filename)


def _check_assignments(nodes: list[ast.AST], filename: str) -> None:
    """Refuse attribute assignments to an existing object through its variable."""
    holding = {'ego'}
    for node in nodes:
        if isinstance(node, ast.Assign) and _is_object(node.value, holding):
            holding |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    for node in nodes:
        if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load):
            root: ast.AST = node
            while isinstance(root, ast.Attribute):
                root = root.value
            if isinstance(root, ast.Name) and root.id in holding:
                raise ProgramError(_late(ast.unparse(node)), (filename, node.lineno))


def _is_object(value: ast.AST, holding: Collection[str]) -> bool:
    return isinstance(value, syntax.New) or (isinstance(value, ast.Name) and value.id in holding)


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


def _of_classes(kind: type) -> dict[str, Place]:
    """Places where a program's own classes set properties, not the model's or Scenic's."""
    found: dict[str, Place] = {}
    for base in reversed(kind.__mro__):
        for name, default in vars(base).get('_scenic_properties', {}).items():
            code = getattr(getattr(default, 'value', None), '__code__', None)
            if code is None or code.co_filename.startswith(_SCENIC):
                continue
            if Path(code.co_filename).stem != MODEL:
                found[name] = code.co_filename, code.co_firstlineno
    return found


def _uses_of(scenario: Any, ego: Any) -> Iterator[str]:
    if not isinstance(scenario.containerOfObject(ego), AllRegion):
        yield 'size'
    if _mutated(ego):
        yield 'mutate'


def _mutated(thing: Any) -> bool:
    return needsSampling(thing.mutationScale) or thing.mutationScale != 0
