"""A client of simulation_interfaces as anybody may write one: of ours it knows nothing.

It does what its first argument says, and prints one line of JSON. Runs may begin when it has made
the file of its second argument.
"""

import json
import math
import sys
import time
from pathlib import Path

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from simulation_interfaces import srv
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import (
    Bounds,
    EntityCategory,
    EntityFilters,
    Result,
    SimulationState,
    SimulatorFeatures,
    TagsFilter,
)

STOPPED, PLAYING, PAUSED = (
    SimulationState.STATE_STOPPED, SimulationState.STATE_PLAYING, SimulationState.STATE_PAUSED,
)
WAIT_S = 60.0


class Client(Node):
    """Asks a simulator and waits for its answers."""

    def __init__(self) -> None:
        super().__init__('somebody')
        self.asking = {}
        self.steps = ActionClient(self, SimulateSteps, 'simulate_steps')

    def wait(self, future):
        rclpy.spin_until_future_complete(self, future, timeout_sec=WAIT_S)
        assert future.done(), 'no answer'
        return future.result()

    def ask(self, kind, **request):
        name = ''.join(f'_{c.lower()}' if c.isupper() else c for c in kind).lstrip('_')
        if kind not in self.asking:
            self.asking[kind] = self.create_client(getattr(srv, kind), name)
            assert self.asking[kind].wait_for_service(timeout_sec=WAIT_S), name
        return self.wait(self.asking[kind].call_async(getattr(srv, kind).Request(**request)))

    def state(self):
        return self.ask('GetSimulationState').state.state

    def set(self, state):
        return self.ask('SetSimulationState', state=SimulationState(state=state)).result.result

    def until(self, state):
        deadline = time.monotonic() + WAIT_S
        while self.state() != state:
            assert time.monotonic() < deadline, state
            time.sleep(0.01)

    def pause_next(self):
        deadline = time.monotonic() + WAIT_S
        while self.set(PAUSED) != Result.RESULT_OK:
            assert time.monotonic() < deadline
            time.sleep(0.005)

    def simulate(self, steps, cancel=False):
        assert self.steps.wait_for_server(timeout_sec=WAIT_S)
        seen = []
        goal = self.wait(self.steps.send_goal_async(
            SimulateSteps.Goal(steps=steps), feedback_callback=lambda one: seen.append(
                (one.feedback.completed_steps, one.feedback.remaining_steps))))
        if cancel:
            self.wait(goal.cancel_goal_async())
        ended = self.wait(goal.get_result_async())
        return ended.status, ended.result.result.result, seen

    def entities(self, **filters):
        answer = self.ask('GetEntities', filters=EntityFilters(**filters))
        return answer.result.result if answer.result.result != 1 else list(answer.entities)

    def at_s(self):
        stamp = self.ask('GetEntityState', entity='ego').state.header.stamp
        return stamp.sec + stamp.nanosec / 1e9


def features(client):
    known = {
        getattr(SimulatorFeatures, name): name for name in dir(type(SimulatorFeatures))
        if name.isupper()
    }
    return [known[number] for number in client.ask('GetSimulatorFeatures').features.features]


def offered(client):
    return sorted(
        name.lstrip('/') for name, kinds in client.get_service_names_and_types()
        if kinds[0].startswith('simulation_interfaces/srv')
    )


def look(client):
    """What there is in a run that is paused."""
    one = client.ask('GetEntityState', entity='ego').state
    both = client.ask('GetEntitiesStates', filters=EntityFilters(filter='^(ego|vehicle_0)$'))
    van = both.states[1]
    info = client.ask('GetEntityInfo', entity='ego').info
    there = one.pose.position
    return {
        'entities': client.entities(),
        'vehicles': client.entities(filter='^vehicle'),
        'robots': client.entities(
            categories=[EntityCategory(category=EntityCategory.CATEGORY_ROBOT)]),
        'tags': client.entities(tags=TagsFilter(tags=['a'])),
        'box': client.entities(bounds=Bounds(type=Bounds.TYPE_BOX)),
        'nonsense': client.entities(filter='('),
        'unknown': client.ask('GetEntityState', entity='nobody').result.result,
        'frame': one.header.frame_id,
        'pose': [there.x, there.y, there.z],
        'speed': math.hypot(one.twist.linear.x, one.twist.linear.y),
        'accelerates': repr(one.acceleration.linear.x),
        'both': [list(both.entities), both.states[0] == one or repr(both.states[0]) == repr(one)],
        'van': [van.pose.position.x, van.pose.position.y, van.twist.linear.y],
        'category': info.category.category, 'about': info.description,
    }


def lockstep(client):
    """Three runs: one is paused and stepped, one is stopped, and one is reset."""
    said = {
        'features': features(client), 'offered': offered(client), 'idle': client.state(),
        'refused': [client.set(state) for state in (STOPPED, PLAYING, PAUSED, 3)],
        'nobody': client.entities(),
        'unpaused': client.ask('StepSimulation', steps=1).result.result,
        'world': client.ask('GetCurrentWorld').world.name,
    }
    begin()
    client.pause_next()
    said['paused'] = [client.state(), client.set(PAUSED)]
    said['stepped'] = [client.ask('StepSimulation', steps=3).result.result, client.at_s()]
    time.sleep(2.5)  # longer than a node may be silent
    said['held'] = [client.state(), client.at_s()]
    said['look'] = look(client)
    said['simulated'] = [*client.simulate(4), client.at_s(), client.state()]
    said['cancelled'] = client.simulate(10_000, cancel=True)[:2]
    said['again'] = client.state()
    said['played'] = [client.set(PLAYING), client.set(PLAYING)]
    client.until(STOPPED)
    client.pause_next()
    said['stopped'] = [client.set(STOPPED), client.state()]
    client.pause_next()
    scopes = srv.ResetSimulation.Request
    said['reset'] = [
        client.ask('ResetSimulation', scope=scope).result.result
        for scope in (scopes.SCOPE_TIME, scopes.SCOPE_STATE, scopes.SCOPE_ALL)
    ]
    client.pause_next()
    said['too many'] = client.ask('StepSimulation', steps=1000).result.error_message
    return said


def free(client):
    """A run whose frames come by the clock."""
    said = {'features': features(client), 'offered': offered(client)}
    begin()
    client.until(PLAYING)
    said['paused'] = client.set(PAUSED)
    said['stopped'] = [client.set(STOPPED), client.state()]
    return said


def begin():
    Path(sys.argv[2]).touch()


def main():
    rclpy.init()
    print(json.dumps({'lockstep': lockstep, 'free': free}[sys.argv[1]](Client())))


if __name__ == '__main__':
    main()
