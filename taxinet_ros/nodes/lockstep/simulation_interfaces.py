"""The simulator's services of the ROS 2 package simulation_interfaces, where it is installed.

They look at the run that takes place, hold it, take single steps of it, and end it; a run begins by
the action ``run_scenario``. What is not served is not offered, and missing among the features.
Written for version 2.1, https://github.com/ros-simulation/simulation_interfaces.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Accel, Point, Pose, Quaternion, Twist, Vector3
from numpy.typing import NDArray
from rclpy.action import ActionServer, CancelResponse
from rclpy.service import Service
from rclpy.task import Future
from rosidl_generator_py.import_type_support_impl import UnsupportedTypeSupport

from taxinet_ros.core.control_step import Observation
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.camera_model import rotation
from taxinet_ros.core.traffic.traffic import GroundObject
from taxinet_ros.core.types import quaternion
from taxinet_ros.nodes.interface import RUN_SCENARIO
from taxinet_ros.nodes.messages.convert import header, one_line
from taxinet_ros.registry import WORLDS, names, origin_words

PACKAGE = 'simulation_interfaces'
EGO = 'ego'
"""Name of the aircraft under test."""
_RESULT_KEPT_S = 10
_MOMENT_NS = 1_000_000
_NO_CHANGE = Vector3(x=math.nan, y=math.nan, z=math.nan)
_BEGINS = f'a run begins with a scenario: send a goal to the action {RUN_SCENARIO}'


class Entity(NamedTuple):
    """The aircraft under test, or one of the others on the ground.

    Attributes:
        name: unique in its run: :data:`EGO`, or kind and number, from 0, as in the scenario.
        category: constant of EntityCategory, without ``CATEGORY_``.
        about: what it is.
        place: of its reference point in ``map`` [m].
        angles: roll, pitch, yaw [rad].
        velocity: in ``map`` [m/s].
        yaw_rate_radps: counter-clockwise [rad/s].
        low, high: corners of its box, in its own frame [m]; None: it has no outline.
    """

    name: str
    category: str
    about: str
    place: tuple[float, float, float]
    angles: tuple[float, float, float]
    velocity: tuple[float, float]
    yaw_rate_radps: float
    low: NDArray[np.float64] | None
    high: NDArray[np.float64] | None

    def within(self, centre: NDArray[np.float64], radius_m: float) -> bool:
        """Whether its box, or its reference point if it has none, overlaps a sphere in ``map``."""
        away = (centre - self.place) @ rotation(*self.angles)
        low, high = (np.zeros(3) if one is None else one for one in (self.low, self.high))
        return bool(np.linalg.norm(away - np.clip(away, low, high)) <= radius_m)


def ego(frame: Observation, model: AircraftModel) -> Entity:
    """The aircraft under test at a control step."""
    at = frame.state
    corners = [part.points for part in model.outline if part.shades]
    points = np.concatenate(corners) if corners else None
    return Entity(
        name=EGO, category='ROBOT', about=f'the aircraft under test: {model.title}',
        place=(at.x_m, at.y_m, at.z_m), angles=(at.roll_rad, at.pitch_rad, at.yaw_rad),
        velocity=(at.speed_mps * math.cos(at.yaw_rad), at.speed_mps * math.sin(at.yaw_rad)),
        yaw_rate_radps=at.yaw_rate_radps,
        low=None if points is None else points.min(axis=0),
        high=None if points is None else points.max(axis=0),
    )


def other(number: int, one: GroundObject, stamp_ns: int) -> Entity:
    """One of the others on the ground at a simulated time [ns]."""
    now, soon = one.pose_at(stamp_ns), one.pose_at(stamp_ns + _MOMENT_NS)
    turned_rad = math.remainder(soon.heading_rad - now.heading_rad, math.tau)
    moment_s, (length_m, width_m, height_m) = _MOMENT_NS / 1e9, one.size
    still = 'HUMAN' if one.kind == 'person' else 'STATIC_OBJECT'
    return Entity(
        name=f'{one.kind}_{number}', about=f'{one.colour} {one.kind}',
        category='DYNAMIC_OBJECT' if one.path and one.kind != 'person' else still,
        place=(now.x_m, now.y_m, 0.0), angles=(0.0, 0.0, now.heading_rad),
        velocity=((soon.x_m - now.x_m) / moment_s, (soon.y_m - now.y_m) / moment_s),
        yaw_rate_radps=turned_rad / moment_s,
        low=np.array([-length_m / 2, -width_m / 2, 0.0]),
        high=np.array([length_m / 2, width_m / 2, height_m]),
    )


def serve(simulator: Any) -> list[ActionServer]:
    """Serve the interfaces on the simulator's node, if their package is installed.

    Returns:
        Action servers that have to be destroyed before the node.
    """
    if importlib.util.find_spec(PACKAGE) is None:
        return []
    try:
        return SimulationInterfaces(simulator).actions
    except (ImportError, AttributeError, UnsupportedTypeSupport) as error:
        simulator.get_logger().warning(
            f'{PACKAGE} is not served, as version 2.1 is needed and cannot be loaded: '
            f'{one_line(error)}'
        )
        return []


class SimulationInterfaces:
    """Services and action on a simulator's node, by relative names.

    Attributes:
        actions: its action servers.
    """

    def __init__(self, simulator: Any) -> None:
        """Offer what is served; ``simulator`` is the :class:`.Simulator`."""
        self._simulator = simulator
        self._stepper: object | None = None
        action, self._msg, srv = (
            importlib.import_module(f'{PACKAGE}.{kind}') for kind in ('action', 'msg', 'srv')
        )
        self._result, self._steps = self._msg.Result, action.SimulateSteps
        self._pauses = not simulator.timing.free
        rows: list[tuple[Any, str, Callable[..., Any], tuple[str, ...]]] = [
            (srv.GetSimulatorFeatures, 'get_simulator_features', self._get_features, ()),
            (srv.GetSimulationState, 'get_simulation_state', self._get_state,
             ('SIMULATION_STATE_GETTING',)),
            (srv.SetSimulationState, 'set_simulation_state', self._later(self._set_state),
             ('SIMULATION_STATE_SETTING', *(('SIMULATION_STATE_PAUSE',) * self._pauses))),
            (srv.ResetSimulation, 'reset_simulation', self._later(self._reset),
             ('SIMULATION_RESET',)),
            (srv.GetEntities, 'get_entities', self._get_entities, ('ENTITY_CATEGORIES',)),
            (srv.GetEntitiesStates, 'get_entities_states', self._get_entities,
             ('ENTITY_STATE_GETTING',)),
            (srv.GetEntityState, 'get_entity_state', self._get_entity, ()),
            (srv.GetEntityInfo, 'get_entity_info', self._get_entity, ('ENTITY_INFO_GETTING',)),
            (srv.GetEntityBounds, 'get_entity_bounds', self._get_entity, ('ENTITY_BOUNDS',)),
            (srv.GetCurrentWorld, 'get_current_world', self._get_world, ('WORLD_INFO_GETTING',)),
            (srv.GetAvailableWorlds, 'get_available_worlds', self._get_worlds,
             ('AVAILABLE_WORLDS',)),
        ]
        if self._pauses:
            rows.append((srv.StepSimulation, 'step_simulation', self._later(self._step), (
                'STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE', 'STEP_SIMULATION_ACTION',
            )))
        self._set_state_codes = srv.SetSimulationState.Response
        self._features = [name for *_, features in rows for name in features]
        for kind, name, answer, _ in rows:
            _answer_later(simulator.create_service(kind, name, answer))
        self.actions = [ActionServer(
            simulator, self._steps, 'simulate_steps', self._simulate_steps,
            cancel_callback=lambda goal: CancelResponse.ACCEPT, result_timeout=_RESULT_KEPT_S,
        )] if self._pauses else []
        simulator.get_logger().info(f'serves {PACKAGE}: {len(rows)} services')

    def _later(self, answer: Callable[..., Any]) -> Callable[..., Any]:
        """Start a coroutine as the answer to a request."""
        return lambda *request: self._simulator.executor.create_task(answer, *request)

    def _ok(self) -> Any:
        return self._result(result=self._result.RESULT_OK)

    def _unsupported(self, why: str) -> Any:
        return self._result(result=self._result.RESULT_FEATURE_UNSUPPORTED, error_message=why)

    # The simulation ----------------------------------------------------------------------------

    def _get_features(self, _: Any, response: Any) -> Any:
        known = self._msg.SimulatorFeatures
        response.features.features = [getattr(known, name) for name in self._features]
        response.features.custom_info = (
            f'taxinet_ros: {_BEGINS}; what is served: docs/ros.md; accelerations are NaN, unknown'
        )
        return response

    def _state(self) -> int:
        run, known = self._simulator.run, self._msg.SimulationState
        if run is None:
            return int(known.STATE_STOPPED)
        paused = run.steps.allowed is not None and self._stepper is None
        return int(known.STATE_PAUSED if paused else known.STATE_PLAYING)

    def _get_state(self, _: Any, response: Any) -> Any:
        response.state.state, response.result = self._state(), self._ok()
        return response

    async def _set_state(self, request: Any, response: Any) -> Any:
        response.result = await self._state_set(request.state.state)
        return response

    async def _state_set(self, wanted: int) -> Any:
        known, codes, run = self._msg.SimulationState, self._set_state_codes, self._simulator.run
        if wanted not in {known.STATE_STOPPED, known.STATE_PLAYING, known.STATE_PAUSED}:
            return self._unsupported(f'state {wanted}: only STOPPED, PLAYING and PAUSED can be set')
        if wanted == known.STATE_PAUSED and not self._pauses:
            return self._unsupported('a free run (lockstep false) cannot pause: its timing counts')
        if wanted == self._state():
            return self._result(
                result=codes.ALREADY_IN_TARGET_STATE, error_message='it is in this state')
        if wanted == known.STATE_STOPPED:
            return await self._end()
        if run is None:
            pause = wanted == known.STATE_PAUSED
            code = codes.INCORRECT_TRANSITION if pause else codes.STATE_TRANSITION_ERROR
            return self._result(result=code, error_message=_BEGINS)
        if run.steps.ending is not None:
            return self._result(
                result=codes.STATE_TRANSITION_ERROR, error_message='the run is just ending')
        self._stepper = None
        steps = 0 if wanted == known.STATE_PAUSED else None
        self._simulator.attempt(lambda run: run.steps.allow(steps))
        return self._ok()

    async def _end(self) -> Any:
        """End the run as INTERRUPTED."""
        run, self._stepper = self._simulator.run, None
        if run is not None:
            run.steps.cancel()
            while self._simulator.run is run:
                await run.rest()
        return self._ok()

    async def _reset(self, request: Any, response: Any) -> Any:
        whole = {request.SCOPE_DEFAULT, request.SCOPE_ALL}
        response.result = await self._end() if request.scope in whole else self._unsupported(
            f'scope {request.scope}: only everything can be reset, SCOPE_DEFAULT or SCOPE_ALL, '
            f'which ends the run; {_BEGINS}'
        )
        return response

    async def _step(self, request: Any, response: Any) -> Any:
        response.result = await self._take_steps(request.steps)
        return response

    async def _simulate_steps(self, goal: Any) -> Any:
        result = await self._take_steps(goal.request.steps, goal)
        if goal.is_cancel_requested:
            goal.canceled()
        elif result.result == result.RESULT_OK:
            goal.succeed()
        else:
            goal.abort()
        return self._steps.Result(result=result)

    async def _take_steps(self, count: int, goal: Any = None) -> Any:
        """Take a number of steps; each ends when the next one could begin, or with the run."""
        run, failed = self._simulator.run, self._result.RESULT_OPERATION_FAILED
        if self._state() != self._msg.SimulationState.STATE_PAUSED:
            return self._result(result=failed, error_message='it is not paused')
        begun, taken = run.seq, 0
        mine = self._stepper = object()
        while taken < count and self._stepper is mine and self._simulator.run is run:
            rest = run.rest()
            self._simulator.attempt(lambda run: run.steps.allow(1))
            await rest
            taken = run.seq - begun
            if goal is not None:
                goal.publish_feedback(self._steps.Feedback(
                    completed_steps=taken, remaining_steps=count - taken))
                if goal.is_cancel_requested:
                    break
        if self._stepper is mine:
            self._stepper = None
        ending = run.steps.ending
        if taken == count and (ending is None or ending.outcome.judged):
            return self._ok()
        why = 'it was told to stop' if ending is None else f'the run ended as {ending.outcome}'
        return self._result(
            result=failed, error_message=f'{taken} of {count} steps taken: {why}')

    # Entities and worlds -----------------------------------------------------------------------

    def _entities(self) -> tuple[int, list[Entity]]:
        """Time of the newest frame [ns], and all there are in it."""
        run = self._simulator.run
        if run is None or run.frame is None:
            return 0, []
        stamp_ns, objects = run.frame.stamp_ns, run.scenario.others.objects
        return stamp_ns, [
            ego(run.frame, run.scenario.aircraft_model),
            *(other(number, one, stamp_ns) for number, one in enumerate(objects)),
        ]

    def _get_entities(self, request: Any, response: Any) -> Any:
        asked, bounds = request.filters, request.filters.bounds
        if asked.tags.tags:
            response.result = self._unsupported('filters.tags: entities have no tags')
        elif bounds.type not in {bounds.TYPE_EMPTY, bounds.TYPE_SPHERE}:
            response.result = self._unsupported('filters.bounds: only TYPE_SPHERE')
        else:
            try:
                stamp_ns, found = self._filtered(asked)
            except (re.error, IndexError) as error:
                failed = self._result.RESULT_OPERATION_FAILED
                response.result = self._result(
                    result=failed, error_message=f'filters: {one_line(error)}')
                return response
            response.result = self._ok()
            response.entities = [one.name for one in found]
            if hasattr(response, 'states'):
                response.states = [self._state_of(one, stamp_ns) for one in found]
        return response

    def _filtered(self, asked: Any) -> tuple[int, list[Entity]]:
        """Entities that filters take; names as :func:`re.search` finds them."""
        named, bounds = re.compile(asked.filter), asked.bounds
        categories = {one.category for one in asked.categories}
        stamp_ns, found = self._entities()
        found = [
            one for one in found if named.search(one.name)
            and (not categories or self._category(one).category in categories)
        ]
        if bounds.type == bounds.TYPE_SPHERE:
            centre, radius_m = bounds.points[0], bounds.points[1].x
            place = np.array([centre.x, centre.y, centre.z])
            found = [one for one in found if one.within(place, radius_m)]
        return stamp_ns, found

    def _get_entity(self, request: Any, response: Any) -> Any:
        stamp_ns, entities = self._entities()
        found = next((one for one in entities if one.name == request.entity), None)
        if found is None:
            known = ', '.join(one.name for one in entities) or 'none, as nothing runs'
            response.result = self._result(
                result=self._result.RESULT_NOT_FOUND,
                error_message=f'{request.entity!r} is unknown; entities: {known}')
            return response
        response.result = self._ok()
        if hasattr(response, 'state'):
            response.state = self._state_of(found, stamp_ns)
        elif hasattr(response, 'info'):
            response.info.category, response.info.description = self._category(found), found.about
        elif found.low is not None and found.high is not None:
            response.bounds.type = response.bounds.TYPE_BOX
            response.bounds.points = [
                Vector3(**dict(zip('xyz', corner.tolist(), strict=True)))
                for corner in (found.high, found.low)
            ]
        return response

    def _category(self, one: Entity) -> Any:
        known = self._msg.EntityCategory
        return known(category=getattr(known, f'CATEGORY_{one.category}'))

    def _state_of(self, one: Entity, stamp_ns: int) -> Any:
        x, y, z, w = quaternion(*one.angles)
        return self._msg.EntityState(
            header=header(stamp_ns),
            pose=Pose(
                position=Point(**dict(zip('xyz', one.place, strict=True))),
                orientation=Quaternion(x=x, y=y, z=z, w=w),
            ),
            twist=Twist(
                linear=Vector3(x=one.velocity[0], y=one.velocity[1]),
                angular=Vector3(z=one.yaw_rate_radps),
            ),
            acceleration=Accel(linear=_NO_CHANGE, angular=_NO_CHANGE),
        )

    def _world(self, name: str, origin: str) -> Any:
        resource = self._msg.Resource(uri=name)
        return self._msg.WorldResource(name=name, world_resource=resource, description=origin)

    def _get_world(self, _: Any, response: Any) -> Any:
        chosen = self._simulator.world
        response.world, response.result = self._world(chosen.name, chosen.origin), self._ok()
        return response

    def _get_worlds(self, request: Any, response: Any) -> Any:
        if request.additional_sources or request.filter.tags:
            response.result = self._unsupported(
                'additional_sources, filter.tags: worlds are those that packages add')
            return response
        response.worlds = [self._world(name, origin_words(WORLDS, name)) for name in names(WORLDS)]
        response.result = self._ok()
        return response


def _answer_later(service: Service) -> None:
    """Let a callback return a future of its response: rclpy's executor of events awaits none."""
    send: Callable[..., None] = service.send_response

    def respond(response: Any, to: Any) -> None:
        if isinstance(response, Future):
            response.add_done_callback(lambda done: send(done.result(), to))
        else:
            send(response, to)

    setattr(service, 'send_response', respond)  # noqa: B010 - a method, to a type checker
