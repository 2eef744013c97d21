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

from geometry_msgs.msg import Accel, Point, Pose, Quaternion, Twist, Vector3
from rclpy.action import ActionServer, CancelResponse
from rclpy.service import Service
from rclpy.task import Future

from taxinet_ros.core.control_step import Observation
from taxinet_ros.core.traffic.traffic import Traffic
from taxinet_ros.core.types import quaternion
from taxinet_ros.nodes.interface import RUN_SCENARIO
from taxinet_ros.nodes.messages.convert import header, one_line

PACKAGE = 'simulation_interfaces'
_RESULT_KEPT_S = 10
_MOMENT_NS, _MOMENT_S = 1_000_000, 0.001
_UNKNOWN = Vector3(x=math.nan, y=math.nan, z=math.nan)
_BEGINS = f'a run begins with a scenario: send a goal to the action {RUN_SCENARIO}'


class Entity(NamedTuple):
    """The aircraft under test, or one of the others on the ground.

    Attributes:
        name: unique in its run: ``ego``, or kind and number, from 0, as in the scenario.
        category: constant of EntityCategory, without ``CATEGORY_``.
        about: what it is.
        state: message EntityState.
    """

    name: str
    category: str
    about: str
    state: Any


def serve(simulator: Any) -> list[ActionServer]:
    """Serve the interfaces on the simulator's node, if their package is installed.

    Returns:
        Action servers that have to be destroyed before the node.
    """
    if importlib.util.find_spec(PACKAGE) is None:
        return []
    try:
        return SimulationInterfaces(simulator).actions
    except Exception as error:  # of any kind: the simulator runs without them
        why = f'version 2.1 is needed, this one does not load: {one_line(error)}'
        simulator.get_logger().warning(f'{PACKAGE} is not served: {why}')
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
            (srv.GetCurrentWorld, 'get_current_world', self._get_world, ('WORLD_INFO_GETTING',)),
        ]
        if self._pauses:
            rows.append((srv.StepSimulation, 'step_simulation', self._later(self._take_steps), (
                'STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE', 'STEP_SIMULATION_ACTION',
            )))
        self._codes = srv.SetSimulationState.Response
        self._features = [name for *_, features in rows for name in features]
        for kind, name, answer, _ in rows:
            _answer_later(simulator.create_service(kind, name, answer))
        self.actions = [ActionServer(
            simulator, self._steps, 'simulate_steps', self._simulate_steps,
            cancel_callback=lambda goal: CancelResponse.ACCEPT, result_timeout=_RESULT_KEPT_S,
        )] if self._pauses else []
        simulator.get_logger().info(f'serves {PACKAGE}: {len(rows)} services')

    def _later(self, work: Callable[..., Any]) -> Callable[..., Any]:
        """Callback that starts a coroutine with the request, whose return is the result."""
        async def answer(request: Any, response: Any) -> Any:
            response.result = await work(request)
            return response

        return lambda *request: self._simulator.executor.create_task(answer, *request)

    def _ok(self) -> Any:
        return self._result(result=self._result.RESULT_OK)

    def _refused(self, code: int, why: str) -> Any:
        return self._result(result=code, error_message=why)

    def _unsupported(self, why: str) -> Any:
        return self._refused(self._result.RESULT_FEATURE_UNSUPPORTED, why)

    # The simulation ----------------------------------------------------------------------------

    def _get_features(self, _: Any, response: Any) -> Any:
        known = self._msg.SimulatorFeatures
        response.features.features = [getattr(known, name) for name in self._features]
        response.features.custom_info = f'taxinet_ros: {_BEGINS}'
        return response

    def _state(self) -> int:
        run, known = self._simulator.run, self._msg.SimulationState
        if run is None:
            return int(known.STATE_STOPPED)
        playing = run.steps.allowed is None or self._stepper is not None
        return int(known.STATE_PLAYING if playing else known.STATE_PAUSED)

    def _get_state(self, _: Any, response: Any) -> Any:
        response.state.state, response.result = self._state(), self._ok()
        return response

    async def _set_state(self, request: Any) -> Any:
        wanted, run = request.state.state, self._simulator.run
        known, codes = self._msg.SimulationState, self._codes
        if wanted not in {known.STATE_STOPPED, known.STATE_PLAYING, known.STATE_PAUSED}:
            return self._unsupported(f'state {wanted}: only STOPPED, PLAYING and PAUSED can be set')
        if wanted == known.STATE_PAUSED and not self._pauses:
            return self._unsupported('a free run (lockstep false) cannot pause: its timing counts')
        if wanted == self._state():
            return self._refused(codes.ALREADY_IN_TARGET_STATE, 'it is in this state')
        if wanted == known.STATE_STOPPED:
            return await self._end()
        pause = wanted == known.STATE_PAUSED
        if run is None or run.steps.ending is not None:
            code = codes.INCORRECT_TRANSITION if pause else codes.STATE_TRANSITION_ERROR
            return self._refused(code, _BEGINS if run is None else 'the run is just ending')
        self._stepper = None
        self._simulator.attempt(lambda run: run.steps.allow(0 if pause else None))
        run.held()  # whoever takes steps need not wait for the current one
        return self._ok()

    async def _end(self) -> Any:
        """End the run as INTERRUPTED."""
        run, self._stepper = self._simulator.run, None
        if run is not None:
            run.steps.cancel()
            while self._simulator.run is run:
                await run.rest()
        return self._ok()

    async def _reset(self, request: Any) -> Any:
        if request.scope in {request.SCOPE_DEFAULT, request.SCOPE_ALL}:
            return await self._end()
        return self._unsupported(f'scope {request.scope}: only SCOPE_ALL, which ends the run')

    async def _simulate_steps(self, goal: Any) -> Any:
        result = await self._take_steps(goal.request, goal)
        if goal.is_cancel_requested:
            goal.canceled()
        elif result.result == result.RESULT_OK:
            goal.succeed()
        else:
            goal.abort()
        return self._steps.Result(result=result)

    async def _take_steps(self, request: Any, goal: Any = None) -> Any:
        """Take a number of steps; each ends when the next one could begin, or with the run."""
        run, failed = self._simulator.run, self._result.RESULT_OPERATION_FAILED
        if self._state() != self._msg.SimulationState.STATE_PAUSED:
            return self._refused(failed, 'it is not paused')
        begun, taken, count = run.seq, 0, request.steps
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
        return self._refused(failed, f'{taken} of {count} steps taken: {why}')

    # Entities and the world --------------------------------------------------------------------

    def _entities(self) -> list[Entity]:
        """All there are in the newest frame."""
        run = self._simulator.run
        if run is None or run.frame is None:
            return []
        at, stamp_ns = run.frame.state, run.frame.stamp_ns
        state = self._entity_state(
            stamp_ns, (at.x_m, at.y_m, at.z_m), (at.roll_rad, at.pitch_rad, at.yaw_rad),
            (at.speed_mps * math.cos(at.yaw_rad), at.speed_mps * math.sin(at.yaw_rad)),
            at.yaw_rate_radps,
        )
        about = f'the aircraft under test: {run.scenario.aircraft_model.title}'
        others = run.scenario.others
        return [
            Entity('ego', 'ROBOT', about, state),
            *(self._other(others, k, run.frame) for k in range(len(others.objects))),
        ]

    def _other(self, others: Traffic, number: int, frame: Observation) -> Entity:
        one, stamp_ns, held = others.objects[number], frame.stamp_ns, frame.held
        now = soon = others.pose(number, stamp_ns, held)
        if number not in held or not held[number].stands:
            soon = others.pose(number, stamp_ns + _MOMENT_NS, held)
        turned_rad = math.remainder(soon.heading_rad - now.heading_rad, math.tau)
        category = 'DYNAMIC_OBJECT' if one.path else 'STATIC_OBJECT'
        state = self._entity_state(
            stamp_ns, (now.x_m, now.y_m, 0.0), (0.0, 0.0, now.heading_rad),
            ((soon.x_m - now.x_m) / _MOMENT_S, (soon.y_m - now.y_m) / _MOMENT_S),
            turned_rad / _MOMENT_S,
        )
        return Entity(
            f'{one.kind}_{number}', 'HUMAN' if one.kind == 'person' else category,
            f'{one.colour} {one.kind}', state,
        )

    def _entity_state(
        self, stamp_ns: int, place: tuple[float, float, float], angles: tuple[float, float, float],
        velocity: tuple[float, float], yaw_rate_radps: float,
    ) -> Any:
        """State in ``map``, the twist too; its acceleration is unknown."""
        x, y, z, w = quaternion(*angles)
        return self._msg.EntityState(
            header=header(stamp_ns),
            pose=Pose(
                position=Point(x=place[0], y=place[1], z=place[2]),
                orientation=Quaternion(x=x, y=y, z=z, w=w),
            ),
            twist=Twist(
                linear=Vector3(x=velocity[0], y=velocity[1]), angular=Vector3(z=yaw_rate_radps),
            ),
            acceleration=Accel(linear=_UNKNOWN, angular=_UNKNOWN),
        )

    def _get_entities(self, request: Any, response: Any) -> Any:
        """Answer GetEntities and GetEntitiesStates; names as :func:`re.search` finds them."""
        asked = request.filters
        if asked.tags.tags or asked.bounds.type != asked.bounds.TYPE_EMPTY:
            response.result = self._unsupported('filters: there are no tags and no bounds')
            return response
        try:
            named = re.compile(asked.filter)
        except re.error as error:
            failed = self._result.RESULT_OPERATION_FAILED
            response.result = self._refused(failed, f'filters.filter: {error}')
            return response
        categories = {one.category for one in asked.categories}
        found = [
            one for one in self._entities() if named.search(one.name)
            and (not categories or self._category(one).category in categories)
        ]
        response.result, response.entities = self._ok(), [one.name for one in found]
        if hasattr(response, 'states'):
            response.states = [one.state for one in found]
        return response

    def _get_entity(self, request: Any, response: Any) -> Any:
        """Answer GetEntityState and GetEntityInfo."""
        entities = {one.name: one for one in self._entities()}
        one = entities.get(request.entity)
        if one is None:
            why = f'{request.entity!r} is unknown; entities: {", ".join(entities) or "none"}'
            response.result = self._refused(self._result.RESULT_NOT_FOUND, why)
            return response
        response.result = self._ok()
        if hasattr(response, 'state'):
            response.state = one.state
        else:
            response.info.category, response.info.description = self._category(one), one.about
        return response

    def _category(self, one: Entity) -> Any:
        known = self._msg.EntityCategory
        return known(category=getattr(known, f'CATEGORY_{one.category}'))

    def _get_world(self, _: Any, response: Any) -> Any:
        world = self._simulator.world
        response.world.name = response.world.world_resource.uri = world.name
        response.world.description, response.result = world.origin, self._ok()
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
