"""Contract checks for authors of extensions.

Each check takes the registered name (:mod:`taxinet_ros.registry`); for perceptions and controllers
also any other accepted value, such as ``FILE.py:NAME``. It returns None, or raises
:class:`ContractError` with a one-line message if the contract is broken. A test is one call::

    from taxinet_ros.testing import check_perception

    def test_contract() -> None:
        check_perception('my_name')

Every check also verifies that another process, with another hash seed, gives the same answers:
runs take place in worker processes and must be reproducible there.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.motion.controller import Controller, SteeringGains, make_controller
from taxinet_ros.core.mtl import parse_formula, parse_spec, robustness, signal_names
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.renderer import find_renderer
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState, TaxiCommand, TrackingError
from taxinet_ros.core.user_code import UserCodeError
from taxinet_ros.core.verdict.judge import check_specs
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.registry import KMWH
from taxinet_ros.samplers.registry import SAMPLERS, make_sampler
from taxinet_ros.samplers.space import Branch, Dimension, Point, Space

MOST_CTE_M = 100.0
"""Cross-track error [m] above which an estimate is assumed to be in a wrong unit."""

MOST_AGAIN_CODES = 2.0
"""Mean difference of two pictures of one state that a camera which is not reproducible may have."""

MOST_SPEED_MPS = 60.0
"""Commanded speed [m/s] above which it is assumed to be in a wrong unit; no aircraft taxis so."""

_TRUTHS = tuple(
    TrackingError(cte_m=cte_m, he_rad=math.radians(he_deg))
    for cte_m, he_deg in ((0.0, 0.0), (-8.0, 20.0), (3.5, -30.0), (0.4, 1.0))
)
_UNUSABLE = (
    TrackingError(cte_m=0.0, he_rad=0.0, valid=False),
    TrackingError(cte_m=math.nan, he_rad=0.0),
    TrackingError(cte_m=0.0, he_rad=math.inf),
)
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
_ELSEWHERE_S = 600.0


class ContractError(AssertionError):
    """An extension breaks its contract; the message names the extension and the violation."""


def check_perception(word: str) -> None:
    """Check that a perception is usable in runs.

    It must answer each (200, 360, 3) uint8 RGB frame, of a runway or of nothing, with one estimate
    in metres and radians, or none; give no estimate without an input; and give the same answers in
    each run, whatever the previous runs, and in each process.

    Raises:
        ContractError: it does not.
    """
    with _Complaints('perception', word) as complain:
        found = make_perception(word)
        complain.unless(type(found.needs_image) is bool, 'needs_image is no bool')
        for number, (frame, truth) in enumerate(_sights()):
            found.begin(_SCENE.rig)
            estimate = found.estimate(frame, truth)
            complain.unless(
                not estimate.usable
                or (abs(estimate.cte_m) <= MOST_CTE_M and abs(estimate.he_rad) <= math.pi),
                f'answers frame {number} with {estimate}: in metres and radians?',
            )
        found.begin(_SCENE.rig)
        complain.unless(
            not found.estimate(None, None).usable, 'has an estimate without frame and truth'
        )
        complain.unless_alike(_perceive, word)


def check_controller(word: str) -> None:
    """Check that a controller is usable in runs.

    It must answer every estimate, also unusable ones, with one :class:`.TaxiCommand` of finite
    numbers: a nose-wheel angle in radians, left positive, and a speed of 0 m/s or more; not steer
    away from the centreline or increase the heading error, from either side; and give the same
    answers in each run, whatever the previous runs, and in each process.

    Raises:
        ContractError: it does not.
    """
    with _Complaints('controller', word) as complain:
        found = make_controller(word, SteeringGains())
        found.begin()
        for estimate in (*_TRUTHS, *_UNUSABLE):
            command = found.command(estimate)
            complain.unless(
                abs(command.steering_rad) <= math.pi / 2 and command.speed_mps <= MOST_SPEED_MPS,
                f'answers {estimate} with {command}: in radians and m/s?',
            )
        _check_signs(complain, found)
        complain.unless_alike(_steer, word)


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
    with _Complaints('sampler', name) as complain:
        kind = SAMPLERS.get(name)
        complain.unless(kind is not None, 'is not installed')
        complain.unless(bool(kind and kind.meaning), 'does not say what it does (meaning)')
        for number, space in enumerate(_SPACES):
            points = _sample(name, number, 1, runs, options)
            for index, point in enumerate(points):
                _check_point(complain, space, index, point)
            again = _sample(name, number, 1, runs, options)
            complain.unless(points == again, 'equal seeds give different points')
            other = _sample(name, number, 2, runs, options)
            complain.unless(points != other, 'different seeds give equal points')
            against = _sample(name, number, 1, runs, options, -1.0)
            free = kind is None or kind.learns or points == against
            complain.unless(
                free, 'its points depend on results, but its kind says that it does not learn'
            )
            _check_book(complain, name, space, runs, options)
        told = _elsewhere(_sample, name, 0, 1, runs, options)
        here = _sample(name, 0, 1, runs, options)
        complain.unless(json.loads(json.dumps(here)) == told, 'points differ in a worker')


def check_world(name: str) -> None:
    """Check that a world is usable in runs.

    It must start at the scenario's pose, at control step 0. Observing must not change it. States
    must be finite and images (200, 360, 3) uint8 RGB. Each step advances one control period, up to
    the scenario's last step. Equal scenarios and commands must give bit-identical states and
    images in each process.

    Raises:
        ContractError: it does not.
    """
    with _Complaints('world', name) as complain:
        world = find_world(name).make(_SCENE)
        for seq in range(world.last_seq + 1):
            now = world.observe()
            _check_observation(complain, seq, now)
            equal = _plain(now) == _plain(world.observe())
            complain.unless(equal, f'step {seq}: observing it twice gives two answers')
            blank = world.observe(picture=False).image is None
            complain.unless(blank, f'step {seq}: picture=False gives a picture')
            if seq == 0:
                here, there = now.state.tracking_error, _SCENE
                near = math.isclose(here.cte_m, there.cross_track_m, abs_tol=0.05)
                near &= math.isclose(here.he_rad, there.heading_rad, abs_tol=0.01)
                complain.unless(near, f'begins at {here}, not where the scenario says')
            world.advance(TaxiCommand(steering_rad=0.05, speed_mps=5.0))
        blind = find_world(name).make(_SCENE, pictures=False)
        complain.unless(blind.observe().image is None, 'pictures=False gives a picture')
        states = _drive(name)
        complain.unless(states == _drive(name), 'two worlds of one scenario differ')
        complain.unless(states == _elsewhere(_drive, name), 'states differ in a worker')


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
    with _Complaints('camera', name) as complain:
        found = find_renderer(name)
        if found is None:
            return  # ours
        first, second = _camera_states(scene)
        cameras = [found.make(scene), found.make(scene)]
        here, there = cameras[0].render(first, 0), cameras[1].render(second, 100_000_000)
        away = _mean_difference(here, there)
        complain.unless(
            away > MOST_AGAIN_CODES,
            f'takes the same picture 40 m and 20 degrees from its first one ({away:.2f} codes)',
        )
        again = cameras[0].render(first, 0)
        cameras[0].close()
        after = cameras[1].render(first, 0)
        cameras[1].close()
        for image, when in ((again, 'after another'), (after, 'by another run')):
            away = _mean_difference(here, image)
            complain.unless(
                away <= (0.0 if found.reproducible else MOST_AGAIN_CODES),
                f'the same picture, taken {when}, differs by {away:.3g} codes on average',
            )
        if found.reproducible and scenario is None:
            seen = _take(name)
            complain.unless(seen == _elsewhere(_take, name), 'pictures differ in a worker')


def check_requirement(name: str) -> None:
    """Check that a requirement is usable for judging runs.

    It must be a formula over existing signals that survives printing and parsing unchanged, be
    decidable and free of lint warnings on runs of 30 s, and have a numeric robustness on any trace.

    Raises:
        ContractError: it does not.
    """
    with _Complaints('requirement', name) as complain:
        spec = parse_spec(name)
        complain.unless(spec.name == name, f'is named {spec.name}')
        complain.unless(parse_formula(spec.text) == spec.formula, 'is not read back as written')
        doubts = check_specs([spec], Scenario()).warnings
        complain.unless(not doubts, f'may not say what is meant: {"; ".join(doubts)}')
        stamps_ns = [seq * CONTROL_PERIOD_NS for seq in range(301)]
        for level in (0.0, 1.0, -1.0):
            trace = {one: [level] * len(stamps_ns) for one in signal_names(spec.formula)}
            rho = robustness(spec.formula, stamps_ns, trace)
            complain.unless(math.isfinite(rho), f'its robustness is {rho} where all signals are '
                            f'{level:g}')


class _Complaints:
    """Context manager that turns errors into a :class:`ContractError` about one extension."""

    def __init__(self, kind: str, name: str) -> None:
        self._who = f'{kind} {name}'
        if not isinstance(name, str):
            raise ContractError(f'{self._who}: expected its name, got {type(name).__name__}')

    def __enter__(self) -> _Complaints:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, UsageError | UserCodeError | InfraError | ValueError):
            raise ContractError(f'{self._who}: {error}') from error
        if isinstance(error, Exception) and not isinstance(error, ContractError):
            raise ContractError(f'{self._who}: {type(error).__name__}: {error}') from error

    def unless(self, fine: bool, what: str) -> None:
        """Raise unless ``fine``."""
        if not fine:
            raise ContractError(f'{self._who}: {what}')

    def unless_alike(self, work: Callable[..., list[Any]], word: str) -> None:
        """Raise unless answers are the same for repeated instances and in another process."""
        answers = work(word)
        self.unless(answers == work(word), 'answers differ from one making to the next')
        after_others = work(word, True)
        self.unless(
            answers == after_others,
            'answers depend on earlier runs: keep what it remembers in what is made for each run, '
            'or forget it in reset()',
        )
        self.unless(
            answers == _elsewhere(work, word, True), 'answers differ in a worker, after other runs'
        )


@functools.cache
def _sights() -> list[tuple[NDArray[np.uint8], TrackingError]]:
    """Frames with their true errors: a runway, black, white, and noise."""
    sights, camera = [], Camera(_SCENE)
    for truth in _TRUTHS:
        scene = dataclasses.replace(
            _SCENE, cross_track_m=truth.cte_m, heading_rad=truth.he_rad
        )
        sights.append((camera.render(Aircraft(scene).state, 0), truth))
    shape = (200, 360, 3)
    noise = np.random.default_rng(1).integers(0, 256, shape, np.uint8)
    for image in (np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8), noise):
        sights.append((image, _TRUTHS[0]))
    return sights


def _check_signs(complain: _Complaints, found: Controller) -> None:
    """Check the signs: with swapped ones, every run leaves the runway without any error."""
    for cte_m, he_rad, where in (
        (5.0, 0.0, 'left of the centreline'), (0.0, 0.35, 'with its nose to the left'),
    ):
        angles_rad = []
        for side in (1.0, -1.0):
            found.begin()
            estimate = TrackingError(cte_m=side * cte_m, he_rad=side * he_rad)
            angles_rad.append(found.command(estimate).steering_rad)
        complain.unless(
            not angles_rad[0] > 0 > angles_rad[1],
            f'steers by {angles_rad[0]:+.3g} rad, to the left, where it is {where}: positive is '
            'left, for errors and for the nose wheel',
        )


def _check_point(complain: _Complaints, space: Space, index: int, point: Point) -> None:
    try:
        space.check(point)
    except ValueError as error:
        complain.unless(False, f'run {index}: {error}')
    complain.unless(
        all(quantile is None or type(quantile) is float for quantile in point),
        f'run {index}: {point}: quantiles have to be plain floats',
    )


def _check_book(
    complain: _Complaints, name: str, space: Space, runs: int, options: Mapping[str, str | float]
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
        complain.unless(weight is None or 0 < weight < math.inf, f'run {index}: weight {weight}')
        complain.unless(type(sampler.drawn(index)) is bool, f'run {index}: drawn is no bool')
    for dimension, shares in learned.items():
        known = any(dimension == one.name for one in space)
        complain.unless(known, f'learned of {dimension!r}, which is no dimension')
        whole = math.isclose(sum(shares), 1.0, abs_tol=1e-6) and min(shares) >= 0
        complain.unless(whole, f'learned {dimension}: {shares} are no probabilities')


def _check_observation(complain: _Complaints, seq: int, now: Observation) -> None:
    state = now.state
    complain.unless(
        all(type(value) is float and math.isfinite(value) for value in dataclasses.astuple(state)),
        f'step {seq}: state {state} is not of finite floats',
    )
    image = now.image
    complain.unless(
        image is not None and image.shape == (200, 360, 3) and image.dtype == np.uint8,
        f'step {seq}: no picture of (200, 360, 3) uint8',
    )


def _bowl(point: Point) -> float:
    """Test robustness, negative near 0.2 in every dimension."""
    return sum((quantile - 0.2) ** 2 for quantile in point if quantile is not None) - 0.1


def _plain(now: Observation) -> list[Any]:
    image = '' if now.image is None else hashlib.sha256(now.image.tobytes()).hexdigest()
    return [now.seq, *dataclasses.astuple(now.state), image]


# Functions that run both here and in a worker; JSON preserves numbers exactly.


def _perceive(word: str, after_others: bool = False) -> list[Any]:
    found = make_perception(word)
    if after_others:
        found.begin(_SCENE.rig)
        for frame, truth in reversed(_sights()):
            found.estimate(frame, truth)
    found.begin(_SCENE.rig)
    answers = [found.estimate(frame, truth) for frame, truth in _sights()]
    return [[repr(value) for value in dataclasses.astuple(answer)] for answer in answers]


def _steer(word: str, after_others: bool = False) -> list[Any]:
    found, estimates = make_controller(word, SteeringGains()), (*_TRUTHS, *_UNUSABLE, *_TRUTHS)
    if after_others:
        found.begin()
        for estimate in reversed(estimates):
            found.command(estimate)
    found.begin()
    answers = [found.command(estimate) for estimate in estimates]
    return [list(dataclasses.astuple(answer)) for answer in answers]


def _sample(
    name: str, space: int, seed: int, runs: int, options: Mapping[str, str | float],
    scale: float = 1.0,
) -> list[Point]:
    sampler = make_sampler(name, _SPACES[space], seed, runs, **options)
    points = []
    for _ in range(runs):
        index, point = sampler.next()
        points.append(point)
        sampler.tell(index, scale * _bowl(point))
    return points


def _camera_states(scene: Scenario) -> tuple[AircraftState, AircraftState]:
    """The start of a scene, and a state 40 m on and 20 degrees aside."""
    first = Aircraft(scene).state
    return first, dataclasses.replace(
        first, x_m=first.x_m + 40.0 * math.cos(first.yaw_rad),
        y_m=first.y_m + 40.0 * math.sin(first.yaw_rad), yaw_rad=first.yaw_rad + 0.35,
    )


def _mean_difference(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> float:
    return float(np.abs(one.astype(np.int16) - other.astype(np.int16)).mean())


def _take(name: str) -> list[str]:
    camera = find_world(f'{KMWH}+{name}').make(_SCENE)
    return [hashlib.sha256(np.asarray(camera.observe().image).tobytes()).hexdigest()]


def _drive(name: str) -> list[Any]:
    world = find_world(name).make(_SCENE)
    seen = []
    for seq in range(world.last_seq):
        seen.append(_plain(world.observe(picture=seq % 5 == 0)))
        world.advance(TaxiCommand(steering_rad=0.1 * (-1) ** seq, speed_mps=5.0))
    return seen


_CHILD = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from taxinet_ros import testing
print(json.dumps(getattr(testing, sys.argv[2])(*json.loads(sys.argv[3]))))
"""


def _elsewhere(work: Callable[..., Sequence[Any]], *arguments: Any) -> Any:
    """Result of a function of this module in another process.

    Raises:
        ValueError: the function fails there.
    """
    done = subprocess.run(
        [sys.executable, '-c', _CHILD, json.dumps(sys.path), work.__name__, json.dumps(arguments)],
        capture_output=True, text=True, timeout=_ELSEWHERE_S, check=False,
        env={**os.environ, 'PYTHONHASHSEED': '17'},
    )
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or [f'exit code {done.returncode}']
        raise ValueError(f'in a worker: {last[0]}')
    return json.loads(done.stdout.splitlines()[-1])
