"""Contract checks for authors of extensions, and campaigns as tests.

Each check takes the registered name (:mod:`taxinet_ros.registry`); for perceptions and controllers
also any other accepted value, such as ``FILE.py:NAME``, or ``cmd:COMMAND`` for a node. It returns
None, or raises :class:`ContractError` that says what is broken. A test is one call::

    from taxinet_ros.testing import check_perception

    def test_contract() -> None:
        check_perception('my_name')

Every check also verifies that another process, with another hash seed, gives the same answers:
runs take place in worker processes and must be reproducible there. The fixture
``taxinet_campaign`` of :mod:`taxinet_ros.pytest_plugin` runs scenes and judges them.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import itertools
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.motion.controller import SteeringGains, make_controller
from taxinet_ros.core.motion.controller import check_controller as check_controller_word
from taxinet_ros.core.mtl import parse_formula, parse_spec, robustness, signal_names
from taxinet_ros.core.perception.perception import check_perception as check_perception_word
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.renderer import find_renderer
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.core.user_code import UserCodeError, command_of
from taxinet_ros.core.verdict.judge import check_specs
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.registry import KMWH
from taxinet_ros.samplers.registry import SAMPLERS, make_sampler
from taxinet_ros.samplers.space import Branch, Dimension, Point, Space
from taxinet_ros.testing.clauses import (
    CLAUSES,
    OF_FUNCTIONS,
    ROLES,
    SCENE,
    UNUSABLE,
    Answer,
    Finding,
    Question,
    Run,
    Seen,
    judge,
    poses,
)

MOST_AGAIN_CODES = 2.0
"""Mean difference of two pictures of one state that a camera which is not reproducible may have."""

_FRAMES = 8
_SPACES = (
    Space((Dimension(name='x'), Dimension(name='kind', weights=(2, 0, 1)),
           Dimension(name='y', buckets=3))),
    Space((
        Dimension(name='kind', weights=(3, 1)),
        Dimension(name='dry', weights=(1, 1), when=(Branch('kind', (0,)),)),
        Dimension(name='rain', buckets=4, when=(Branch('kind', (1,)),)),
        Dimension(name='x'),
    )),
)
_SCENE = Scenario(cross_track_m=2.0, heading_rad=0.1, duration_s=1.0)
_FUNCTION_S, _ELSEWHERE_S = 120.0, 600.0
"""Time limits of another process: for the runs of a function, and for others [s]."""


class ContractError(AssertionError):
    """An extension breaks its contract; the message names the extension and the violation."""


def check_perception(word: str) -> None:
    """Check that a perception is usable in runs, by :data:`.clauses.CLAUSES`.

    A function answers each (200, 360, 3) uint8 RGB frame with one estimate, or none.

    Raises:
        ContractError: it is not.
    """
    _check('perception', word)


def check_controller(word: str) -> None:
    """Check that a controller is usable in runs, by :data:`.clauses.CLAUSES`.

    A function answers every estimate, also unusable ones, with one finite command.

    Raises:
        ContractError: it is not.
    """
    _check('controller', word)


def _check(role: str, word: str) -> None:
    with _complaints(role, word) as unless:
        if command := command_of(word):
            from taxinet_ros.testing.stage import check_node

            with tempfile.NamedTemporaryFile(prefix='taxinet-', suffix='.log') as log:
                _, found = check_node(command, role, log=Path(log.name))
        else:
            found = check_function(role, word)
        broken = [f'{one.clause}: {one.words}' for one in found if one.broken]
        unless(not broken, '\n'.join(broken))


def check_function(role: str, word: str) -> list[Finding]:
    """What is found of each clause that a function or network can break.

    It is asked in another process first, which it may end, with the malformed input first.
    """
    (check_perception_word if role == 'perception' else check_controller_word)(word)
    seen = Seen(role=ROLES[role], frames=_FRAMES)
    runs: list[Any] = []
    try:
        later = _elsewhere(_answers, role, word, 'strange', 'later', within_s=_FUNCTION_S)[1]
        runs = [*_answers(role, word, 'first', 'strange', 'second', 'after'), later]
    except ChildProcessError as error:
        seen.died, seen.died_in = str(error), 'later'
    for kind, failure, values in runs:
        run = Run(kind=kind, error=failure)
        for (question, _), value in zip(_asked(role, kind), values, strict=False):
            said = (TrackingError if role == 'perception' else TaxiCommand)(**value)
            run.questions.append(dataclasses.replace(question, answers=[Answer(said)]))
        seen.runs.append(run)
        seen.silence = seen.silence or failure
    return judge(seen, [clause for clause in CLAUSES[role] if clause in OF_FUNCTIONS])


def check_sampler(name: str, runs: int = 24, **options: str | float) -> None:
    """Check that a sampler is usable in campaigns.

    In a space of three dimensions and in one with idle ones, its points must be quantiles in
    [0, 1) within the space that depend only on seed, options and results, in each process. The
    weight of a run must be positive or None, and learned values must be probabilities. A run
    without a result must be accepted, and a sampler that learns must be copyable
    (:func:`copy.deepcopy`). Points of one whose kind says that it does not learn must not depend
    on results.

    Args:
        name: name of the sampler.
        runs: number of points to request; more than it needs before it begins to learn.
        options: options of the sampler.

    Raises:
        ContractError: it does not.
    """
    with _complaints('sampler', name) as unless:
        kind = SAMPLERS.get(name)
        if kind is None or not kind.meaning:
            raise ValueError('is not installed, or does not say what it does (meaning)')
        for number, space in enumerate(_SPACES):
            points, again, other, against = (
                _sample(name, number, seed, runs, options, scale)
                for seed, scale in ((1, 1.0), (1, 1.0), (2, 1.0), (1, -1.0))
            )
            for index, point in enumerate(points):
                space.check(point)
                plain = all(one is None or type(one) is float for one in point)
                unless(plain, f'run {index}: {point}: quantiles have to be plain floats')
            unless(points == again, 'equal seeds give different points')
            unless(points != other, 'different seeds give equal points')
            unless(
                kind.learns or points == against,
                'its points depend on results, but its kind says that it does not learn',
            )
            _check_book(unless, name, space, runs, options)
        there = _elsewhere(_sample, name, number, 1, runs, options)
        unless([list(point) for point in points] == there, 'points differ in another process')


def check_world(name: str) -> None:
    """Check that a world is usable in runs.

    It must start at the scenario's pose, at control step 0. Observing must not change it. States
    must be finite. Each step has a picture and advances one control period, up to the scenario's
    last step. Equal scenarios and commands must give bit-identical states and images in each
    process.

    Raises:
        ContractError: it does not.
    """
    with _complaints('world', name) as unless:
        world = find_world(name).make(_SCENE)
        for seq in range(world.last_seq + 1):
            now = world.observe()
            state, error = dataclasses.astuple(now.state), now.state.tracking_error
            unless(all(map(math.isfinite, state)), f'step {seq}: state {state} is not finite')
            unless(now.image is not None, f'step {seq}: no picture')
            unless(
                _digest(now) == _digest(world.observe()),
                f'step {seq}: observing it twice gives two answers',
            )
            near = abs(error.cte_m - _SCENE.cross_track_m) < 0.05 \
                and abs(error.he_rad - _SCENE.heading_rad) < 0.01
            unless(seq > 0 or near, f'begins at {error}, not where the scenario says')
            world.advance(TaxiCommand(steering_rad=0.05, speed_mps=5.0))
        states = _drive(name)
        unless(states == _drive(name), 'two worlds of one scenario differ')
        unless(states == _elsewhere(_drive, name), 'states differ in another process')


def check_camera(name: str, scenario: Scenario | None = None) -> None:
    """Check that a camera is usable in runs; with ``scenario``, in this one instead of the default.

    Pictures must be uint8 RGB of the scenario's camera, and show its own state: two that are far
    apart differ, and the first again is the first, to the byte if ``reproducible`` (in each
    process), else within :data:`MOST_AGAIN_CODES` on average. Cameras of two runs must not disturb
    each other.

    Raises:
        ContractError: it does not.
    """
    scene = scenario or _SCENE
    with _complaints('camera', name) as unless:
        found = find_renderer(name)
        if found is None:
            return  # ours
        first = Aircraft(scene).state
        second = dataclasses.replace(
            first, x_m=first.x_m + 40.0 * math.cos(first.yaw_rad),
            y_m=first.y_m + 40.0 * math.sin(first.yaw_rad), yaw_rad=first.yaw_rad + 0.35,
        )
        one, other = found.make(scene), found.make(scene)
        here, there = one.render(first, 0), other.render(second, 100_000_000)
        unless(
            _mean_difference(here, there) > MOST_AGAIN_CODES,
            'takes the same picture 40 m and 20 degrees from its first one',
        )
        for camera, who in ((one, 'again'), (other, 'by another run')):
            away = _mean_difference(here, camera.render(first, 0))
            camera.close()  # the other one goes on
            unless(
                away <= (0.0 if found.reproducible else MOST_AGAIN_CODES),
                f'the same picture, taken {who}, differs by {away:.3g} codes on average',
            )
        if found.reproducible and scenario is None:
            world = f'{KMWH}+{name}'
            same = _drive(world) == _elsewhere(_drive, world)
            unless(same, 'pictures differ in another process')


def check_requirement(name: str) -> None:
    """Check that a requirement is usable for judging runs.

    It must be a formula over existing signals that survives printing and parsing unchanged, be
    decidable and free of lint warnings on runs of 30 s, and have a numeric robustness on any trace.

    Raises:
        ContractError: it does not.
    """
    with _complaints('requirement', name) as unless:
        spec = parse_spec(name)
        unless(parse_formula(spec.text) == spec.formula, 'is not read back as written')
        doubts = check_specs([spec], Scenario()).warnings
        unless(not doubts, f'may not say what is meant: {"; ".join(doubts)}')
        stamps_ns = [seq * CONTROL_PERIOD_NS for seq in range(301)]
        for level in (0.0, 1.0, -1.0):
            trace = {one: [level] * len(stamps_ns) for one in signal_names(spec.formula)}
            rho = robustness(spec.formula, stamps_ns, trace)
            unless(math.isfinite(rho), f'its robustness is {rho} where all signals are {level:g}')


@contextmanager
def _complaints(kind: str, name: str) -> Iterator[Callable[[bool, str], None]]:
    """Turn errors into a :class:`ContractError` about an extension; yields a check that raises."""
    def unless(fine: bool, what: str) -> None:
        if not fine:
            raise ValueError(what)

    try:
        if not isinstance(name, str):
            raise ValueError(f'expected its name, got {type(name).__name__}')
        yield unless
    except (UsageError, UserCodeError, InfraError, ValueError) as error:
        raise ContractError(f'{kind} {name}: {error}') from error
    except Exception as error:
        raise ContractError(f'{kind} {name}: {type(error).__name__}: {error}') from error


def _check_book(
    unless: Callable[[bool, str], None], name: str, space: Space, runs: int,
    options: dict[str, str | float],
) -> None:
    """Check weights and learned values of a sampler, with some runs that have no result."""
    sampler = make_sampler(name, space, 3, runs, **options)
    for number in range(runs // 2):
        index, point = sampler.next()
        later, another = sampler.next()
        sampler.tell(later, _bowl(another))
        learned = sampler.learned()  # from a copy that has seen more than the sampler
        sampler.tell(index, None if number % 3 == 0 else _bowl(point))
        weight = sampler.weight(index)
        unless(weight is None or 0 < weight < math.inf, f'run {index}: weight {weight}')
        unless(type(sampler.drawn(index)) is bool, f'run {index}: drawn is no bool')
    for dimension, shares in learned.items():
        known = any(dimension == one.name for one in space)
        unless(known, f'learned of {dimension!r}, which is no dimension')
        whole = math.isclose(sum(shares), 1.0, abs_tol=1e-6) and min(shares) >= 0
        unless(whole, f'learned {dimension}: {shares} are no probabilities')


def _bowl(point: Point) -> float:
    """Test robustness, negative near 0.2 in every dimension."""
    return sum((quantile - 0.2) ** 2 for quantile in point if quantile is not None) - 0.1


def _mean_difference(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> float:
    return float(np.abs(one.astype(np.int16) - other.astype(np.int16)).mean())


def _digest(now: Observation) -> list[Any]:
    image = '' if now.image is None else hashlib.sha256(now.image.tobytes()).hexdigest()
    return [now.seq, *dataclasses.astuple(now.state), image]


@functools.cache
def _asked(role: str, kind: str) -> list[tuple[Question, Any]]:
    """Questions of a run of a kind to a function, each with the frame or estimate that it gets."""
    states = poses(1 if kind == 'after' else _FRAMES)
    truths = [state.tracking_error for state in states]
    if kind == 'strange':
        strange: dict[str, Any] = dict(UNUSABLE)
        if role == 'perception':
            noise = np.random.default_rng(1).integers(0, 256, (200, 360, 3), np.uint8)
            strange = {'black': noise * 0, 'white': noise * 0 + 255, 'noise': noise}
        return [(Question(seq=0, truth=truths[0], kind=word), one)
                for word, one in strange.items()]
    frames = map(Camera(SCENE).render, states, itertools.repeat(0)) if role == 'perception' else ()
    return [
        (Question(seq=seq, truth=truth), given)
        for seq, (truth, given) in enumerate(zip(truths, frames or truths, strict=True))
    ]


# Functions that run both here and in another process; JSON preserves numbers exactly.


def _answers(role: str, word: str, *kinds: str) -> list[Any]:
    """Kind, error and answers of each run."""
    found: Any = make_perception(word) if role == 'perception' \
        else make_controller(word, SteeringGains())
    runs = []
    for kind in kinds:
        values: list[dict[str, Any]] = []
        error = ''
        try:
            found.begin(*([SCENE.rig] if role == 'perception' else []))
            for question, given in _asked(role, kind):
                answer = found.estimate(given, question.truth) if role == 'perception' \
                    else found.command(given)
                values.append(dataclasses.asdict(answer))
        except UserCodeError as failure:
            error = str(failure)
        runs.append([kind, error, values])
    return runs


def _sample(
    name: str, space: int, seed: int, runs: int, options: dict[str, str | float],
    scale: float = 1.0,
) -> list[Point]:
    sampler = make_sampler(name, _SPACES[space], seed, runs, **options)
    points = []
    for _ in range(runs):
        index, point = sampler.next()
        points.append(point)
        sampler.tell(index, scale * _bowl(point))
    return points


def _drive(name: str) -> list[Any]:
    world = find_world(name).make(_SCENE)
    seen = []
    for seq in range(world.last_seq):
        seen.append(_digest(world.observe(picture=seq % 5 == 0)))
        world.advance(TaxiCommand(steering_rad=0.1 * (-1) ** seq, speed_mps=5.0))
    return seen


_CHILD = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from taxinet_ros import testing
print(json.dumps(getattr(testing, sys.argv[2])(*json.loads(sys.argv[3]))))
"""


def _elsewhere(
    work: Callable[..., Sequence[Any]], *arguments: Any, within_s: float = _ELSEWHERE_S
) -> Any:
    """Result of a function of this module in another process.

    Raises:
        ChildProcessError: the function fails there, or ends the process.
    """
    try:
        done = subprocess.run(
            [sys.executable, '-c', _CHILD, json.dumps(sys.path), work.__name__,
             json.dumps(arguments)],
            capture_output=True, text=True, timeout=within_s, check=False,
            env={**os.environ, 'PYTHONHASHSEED': '17'},
        )
    except subprocess.TimeoutExpired as error:
        raise ChildProcessError(f'no end within {within_s:g} s') from error
    if done.returncode or not done.stdout:  # the code of an extension can end it in any way
        last = done.stderr.strip().splitlines()[-1:]
        raise ChildProcessError(': '.join([f'exit code {done.returncode}', *last]))
    return json.loads(done.stdout.splitlines()[-1])
