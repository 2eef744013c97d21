"""Sample package with one extension of each kind; see docs/extending.md.

After installation (``pip install examples/plugin``), the names in pyproject.toml can be used like
the shipped ones: ``taxinet run nominal --perception bright-paint --controller damped --spec
gentle``, ``taxinet falsify s_falsif --sampler corners``, ``taxinet turns BAG``.
"""

import dataclasses
import math
from typing import Annotated

import numpy as np
import typer

import taxinet_ros as tx
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import Observation, last_step
from taxinet_ros.core.types import AircraftState
from taxinet_ros.samplers.registry import proposer_kind
from taxinet_ros.samplers.sampler import Option, Proposer

STEP_S, STEP_NS = 0.1, 100_000_000
METRES_PER_PIXEL, RAD_PER_PIXEL = 0.04, 0.004
WHEELBASE_M = 3.5


def bright_paint(image):
    """Return (cte_m, he_rad) from the columns of near and far paint in a frame, or None."""
    columns = []
    for rows in (slice(60, 90), slice(120, 180)):
        paint = image[rows, :, :].min(axis=(0, 2)) > 150
        if not paint.any():
            return None
        columns.append(float(np.flatnonzero(paint).mean()))
    far, near = columns
    return METRES_PER_PIXEL * (near - 180), RAD_PER_PIXEL * (near - far)


class Damped:
    """A controller with state: it is created anew for each run, so runs are independent."""

    def __init__(self):
        self.before_m = None

    def __call__(self, estimate):
        """Return (steering_rad, speed_mps) for an estimate."""
        if not estimate.usable:
            return 0.0, 0.0
        rate_mps = 0.0 if self.before_m is None else (estimate.cte_m - self.before_m) / STEP_S
        self.before_m = estimate.cte_m
        steering_rad = -0.04 * estimate.cte_m - 0.1 * rate_mps - 0.8 * estimate.he_rad
        return min(max(steering_rad, -0.2), 0.2), 5.0


class Corners(Proposer):
    """Proposes points near random ends of all dimensions."""

    def __init__(self, space, seed, width):
        self.space, self.width = space, width
        self.chance = np.random.default_rng(seed)

    def ask(self):
        ends = self.chance.integers(0, 2, len(self.space)) * (1 - self.width)
        return self.space.point(ends + self.width * self.chance.random(len(self.space)))

    again = ask


CORNERS = proposer_kind(
    'near the ends of all dimensions',
    lambda space, seed, runs, values: Corners(space, seed, values['width']),
    floor=0.2,
    options={'width': Option(meaning='of an end [quantiles]', default=0.1, low=0.001, high=0.5)},
)

GENTLE = 'always(abs(steering) <= 12 deg)'


class Bicycle:
    """A world without flight dynamics: a bicycle model with the shipped runway and camera.

    Nose wheel and speed follow commands immediately.
    """

    def __init__(self, scenario, *, pictures=True):
        self.last_seq, self.seq = last_step(scenario), 0
        self.camera = Camera(scenario) if pictures else None
        x_m, y_m, yaw_rad = scenario.line.pose(
            scenario.distance_m, scenario.cross_track_m, scenario.heading_rad
        )
        self.state = AircraftState(
            x_m=x_m, y_m=y_m, z_m=1.55, roll_rad=0.0, pitch_rad=0.0, yaw_rad=yaw_rad,
            speed_mps=5.0, yaw_rate_radps=0.0,
        )

    def observe(self, *, picture=True):
        stamp_ns = self.seq * STEP_NS
        image = self.camera.render(self.state, stamp_ns) if picture and self.camera else None
        return Observation(seq=self.seq, stamp_ns=stamp_ns, state=self.state, image=image)

    def advance(self, command):
        now, self.seq = self.state, self.seq + 1
        rate_radps = command.speed_mps / WHEELBASE_M * math.tan(command.steering_rad)
        self.state = dataclasses.replace(
            now, yaw_rad=now.yaw_rad + rate_radps * STEP_S, yaw_rate_radps=rate_radps,
            speed_mps=command.speed_mps,
            x_m=now.x_m + command.speed_mps * math.cos(now.yaw_rad) * STEP_S,
            y_m=now.y_m + command.speed_mps * math.sin(now.yaw_rad) * STEP_S,
        )


class NightVision:
    """A camera that sees the runway in shades of green, through the shipped renderer."""

    reproducible = True
    shows = ('clouds', 'rain_percent', 'time_of_day_h', 'date', 'place', 'camera')

    def __init__(self, scenario):
        self.camera = Camera(scenario)

    def render(self, state, stamp_ns):
        """Return the frame (200, 360, 3) uint8 RGB of a state."""
        light = self.camera.render(state, stamp_ns).max(axis=2)
        return np.stack([light // 4, light, light // 4], axis=2)

    def close(self):
        """Nothing to give back: no other program is asked for pictures."""


def turns(bag: Annotated[str, typer.Argument(metavar='BAG', help='a recorded run')]) -> None:
    """Print how far the nose wheel was turned in the runs of a bag."""
    for run in tx.open_recording(bag):
        most_rad = run.table('taxi_command')['steering_angle'].abs().max()
        print(f'{run.run_id}: {math.degrees(most_rad):.1f} deg')
