"""Two systems of ARCH-COMP's falsification category, many simulations at once.

Written from the competition's model files ``cars.mdl`` and ``Autotrans_shift.mdl``, which are text
(github.com/MoonLightSuite/arch-comp-benchmarks keeps those of 2024). Units are those of the models.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int_]
Traces = tuple[npt.NDArray[np.int64], Mapping[str, Floats]]
"""Stamps [ns], shape (samples,), and values of each signal, shape (simulations, samples)."""

SEGMENT_S = 5
"""Inputs are constant for this long [s]: instance 2 of the competition."""

CARS_S = 100
"""Length of a simulation of the cars [s]."""
_CARS_STEP_S = 0.025
_CARS_KEPT = 2
"""Steps from one sample to the next."""
_KEEPING, _CHASING, _BRAKING = 0, 1, 2
_FAR, _NEAR = np.array([15.0, np.inf, 20.0]), np.array([5.0, 10.0, -np.inf])
"""Distances at which each mode ends, if they are as great or as small."""


def chasing_cars(inputs: Floats, length_s: float = CARS_S) -> Traces:
    """Five cars in a row (Hu, Lygeros and Sastry, HSCC 2000); the first is driven.

    The first obeys dv/dt = -throttle - brake v, dy/dt = v. Each other one keeps (dv/dt = 0,
    dy/dt = v), chases (dv/dt = 1, dy/dt = -v) or brakes (dv/dt = -v, dy/dt = -v), starts at v = 0
    by keeping, 10 behind, and changes by the distance to the car before it: keeping to chasing at
    15 or more and to braking at 5 or less, chasing to keeping at 10 or less, braking to chasing at
    20 or more. That who keeps moves away from who drives is so in the model. Solutions between
    changes are exact; the time of a change is interpolated within a step, as late changes would
    violate CC5 (at the ends of steps of 0.02 s, in most simulations).

    Args:
        inputs: throttle and brake of each 5 s, each 0..1, shape (simulations, 20, 2).
        length_s: length of the simulation.

    Returns:
        Positions ``y1`` to ``y5``, every 0.05 s.
    """
    leader = _leading_car(inputs)[:, :round(length_s / _CARS_STEP_S) + 1]
    count, steps = leader.shape
    kept = np.empty((5, count, (steps - 1) // _CARS_KEPT + 1))
    at = np.tile(np.arange(0.0, 50.0, 10.0), (count, 1))
    speed, mode = np.zeros((count, 4)), np.full((count, 4), _KEEPING)
    kept[:, :, 0] = at.T
    for step in range(1, steps):
        before = at
        moved, faster = _followed(mode, speed, np.array(_CARS_STEP_S))
        at = np.concatenate((leader[:, step, None], before[:, 1:] + moved), axis=1)
        apart, was = np.diff(at), np.diff(before)
        changed = np.nonzero((apart >= _FAR[mode]) | (apart <= _NEAR[mode]))
        if len(changed[0]):
            old, far = mode[changed], apart[changed] >= _FAR[mode[changed]]
            level = np.where(far, _FAR[old], _NEAR[old])
            way = apart[changed] - was[changed]
            share = np.clip((level - was[changed]) / np.where(way == 0, 1.0, way), 0.0, 1.0)
            new = np.where(far, _CHASING, np.where(old == _KEEPING, _BRAKING, _KEEPING))
            first, then = _followed(old, speed[changed], share * _CARS_STEP_S)
            second, faster[changed] = _followed(new, then, (1 - share) * _CARS_STEP_S)
            mode[changed] = new
            at[:, 1:][changed] = before[:, 1:][changed] + first + second
        speed = faster
        if step % _CARS_KEPT == 0:
            kept[:, :, step // _CARS_KEPT] = at.T
    stamps_ns = np.arange(kept.shape[2]) * round(_CARS_KEPT * _CARS_STEP_S * 1e9)
    return stamps_ns, {f'y{number + 1}': one for number, one in enumerate(kept)}


def _followed(mode: Integers, speed: Floats, since_s: Floats) -> tuple[Floats, Floats]:
    """Way and speed of followers after a time [s] in their modes."""
    chases, brakes = mode == _CHASING, mode == _BRAKING
    left = np.exp(-since_s)
    way = np.where(
        chases, -speed * since_s - since_s**2 / 2,
        np.where(brakes, speed * (left - 1), speed * since_s))
    return way, np.where(chases, speed + since_s, np.where(brakes, speed * left, speed))


def _leading_car(inputs: Floats) -> Floats:
    """Exact position of the driven car at each step, shape (simulations, steps)."""
    count, segments, _ = inputs.shape
    since_s = _CARS_STEP_S * np.arange(1, round(SEGMENT_S / _CARS_STEP_S) + 1)
    at, speed, parts = np.zeros((count, 1)), np.zeros((count, 1)), [np.zeros((count, 1))]
    for segment in range(segments):
        throttle, brake = inputs[:, segment, :1], inputs[:, segment, 1:]
        weak = brake < 1e-4
        safe = np.where(weak, 1.0, brake)
        # Integrals of exp(-brake t), once and twice; by their series where braking is weak.
        once = np.where(weak, since_s - brake * since_s**2 / 2, -np.expm1(-safe * since_s) / safe)
        twice = np.where(
            weak, since_s**2 / 2 - brake * since_s**3 / 6, (since_s - once) / safe)
        parts.append(at + speed * once - throttle * twice)
        speed = speed * (1 - brake * once[:, -1:]) - throttle * once[:, -1:]
        at = parts[-1][:, -1:]
    return np.concatenate(parts, axis=1)


TRANSMISSION_S = 33
"""Length of a simulation of the transmission, the least that its formulas need [s]."""
_STEP_S = 0.01
_SHIFTED = 4
"""Steps between two of the shift logic."""
_WAIT = 2
"""Steps of the shift logic that a speed has to stay beyond a threshold."""

_THROTTLES = np.array([0.0, *range(20, 101, 10)])
_SPEEDS = np.arange(800.0, 4801.0, 400.0)
_TORQUES = np.array([
    [-40, -44, -49, -53, -57, -61, -65, -70, -74, -78, -82],
    [215, 117, 85, 66, 44, 29, 10, -2, -13, -22, -32],
    [245, 208, 178, 148, 122, 104, 85, 66, 48, 33, 18],
    [264, 260, 241, 219, 193, 167, 152, 133, 119, 96, 85],
    [264, 279, 282, 275, 260, 238, 223, 208, 189, 171, 152],
    [267, 290, 293, 297, 290, 275, 260, 256, 234, 212, 193],
    [267, 297, 305, 305, 305, 301, 293, 282, 267, 249, 226],
    [267, 301, 308, 312, 319, 323, 319, 316, 297, 279, 253],
    [267, 301, 312, 319, 327, 327, 327, 327, 312, 293, 267],
    [267, 301, 312, 319, 327, 334, 334, 334, 319, 305, 275],
], dtype=float)
"""Torque of the engine by throttle and speed [lb ft]."""
_SPEED_RATIOS = np.array([
    *np.arange(0, 9) / 10, *np.arange(81, 91) / 100, 0.92, 0.94,
])
_CONVERTER = np.array([
    [137.4652089938063, 2.232], [137.06501915685197, 2.075], [135.86444964598905, 1.975],
    [135.6643547275119, 1.846], [137.56525645304487, 1.72], [140.3665853117251, 1.564],
    [145.2689108144154, 1.409], [152.87251771654735, 1.254], [162.97731109964374, 1.096],
    [164.2779280697452, 1.08], [166.17882979527823, 1.061], [167.97968406157264, 1.043],
    [170.08068070558275, 1.028], [172.78196210502438, 1.012], [175.3831960452274, 1.002],
    [179.58518933324765, 1.002], [183.58708770279083, 1.001], [189.8900776348212, 0.998],
    [197.69377945543027, 0.999], [215.90241703685155, 1.001], [244.51599037908485, 1.002],
])
"""K factor and torque ratio of the converter by its speed ratio."""
_UP = (
    np.array([0.0, 25, 35, 50, 90, 100]),
    np.array([
        [10.0, 30, 50, 1e6], [10, 30, 50, 1e6], [15, 30, 50, 1e6], [23, 41, 60, 1e6],
        [40, 70, 100, 1e6], [40, 70, 100, 1e6],
    ]),
)
_DOWN = (
    np.array([0.0, 5, 40, 50, 90, 100]),
    np.array([
        [0.0, 5, 20, 35], [0, 5, 20, 35], [0, 5, 25, 40], [0, 5, 30, 50], [0, 30, 50, 80],
        [0, 30, 50, 80],
    ]),
)
"""Speeds at which each gear is left, up or down, by throttle [mph]."""
_RATIOS = np.array([2.393, 1.45, 1.0, 0.677])
_ENGINE_INERTIA, _VEHICLE_INERTIA = 0.0219914882835559, 12.09414785731247
_FINAL_DRIVE, _DRAG, _AIR_DRAG = 3.23, 40.0, 0.02
_MPH = 2 * np.pi * 60 / 5280
"""Of a wheel with a radius of 1 ft, for each of its turns in a minute [mph]."""
_STAGES = (
    (), (1 / 5,), (3 / 40, 9 / 40), (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
"""Weights of Dormand and Prince's method of order 5 (Journal of Computational and Applied
Mathematics 6, 1980), the solver of the model; the last row gives the result."""


def automatic_transmission(inputs: Floats, length_s: float = TRANSMISSION_S) -> Traces:
    """A car with four gears (Hoxha, Abbas and Fainekos, ARCH 2014), a demonstration of Simulink's.

    States are the speeds of engine, 600 to 6,000 rpm, and wheels; the shift logic runs every
    0.04 s. Tables are linear, also beyond their ends.

    Args:
        inputs: throttle (0..100 %) and torque of the brake (0..325 lb ft) of each 5 s, shape
            (simulations, 7, 2).
        length_s: length of the simulation.

    Returns:
        ``speed`` [mph], ``rpm`` of the engine, and ``gear`` (1 to 4), every 0.01 s.
    """
    count, steps = len(inputs), round(length_s / _STEP_S)
    held = round(SEGMENT_S / _STEP_S)
    signals = {name: np.empty((count, steps + 1)) for name in ('speed', 'rpm', 'gear')}
    state = np.array([[1000.0], [0.0]]).repeat(count, axis=1)
    gear, towards, waited = (np.zeros(count, dtype=int) for _ in range(3))
    for step in range(steps + 1):
        if step % held == 0:
            throttle, brake = inputs[:, min(step // held, inputs.shape[1] - 1)].T
            engine = _lines(_SPEEDS, _between(_THROTTLES, _TORQUES, throttle))
            up, down = _between(*_UP, throttle), _between(*_DOWN, throttle)
        speed = _MPH * state[1]
        if step % _SHIFTED == 0:
            above, below = speed - _at(up, gear), _at(down, gear) - speed
            beyond = np.where(towards > 0, above, below)
            shifts = (towards != 0) & (beyond >= 0) & (waited + 1 >= _WAIT)
            waits = (towards != 0) & (beyond >= 0) & ~shifts
            starts = np.where(above > 0, 1, np.where(below > 0, -1, 0))
            gear = np.clip(gear + np.where(shifts, towards, 0), 0, 3)
            waited = np.where(waits, waited + 1, 0)
            towards = np.where(waits, towards, np.where(towards == 0, starts, 0))
            ratio = _RATIOS[gear]
        for name, value in (('speed', speed), ('rpm', state[0]), ('gear', gear + 1)):
            signals[name][:, step] = value
        slopes = np.empty((len(_STAGES) - 1, 2, count))
        for stage, weights in enumerate(_STAGES):
            reached = state + _STEP_S * np.einsum('i,ijk', np.array(weights), slopes[:stage])
            np.clip(reached[0], 600.0, 6000.0, out=reached[0])
            if stage < len(slopes):
                slopes[stage] = _slopes(*reached, ratio, engine, brake)
        state = reached
    return np.arange(steps + 1) * round(_STEP_S * 1e9), signals


def _slopes(
    rpm: Floats, wheel: Floats, ratio: Floats, engine: tuple[Floats, Floats], brake: Floats,
) -> tuple[Floats, Floats]:
    """Derivatives of the speeds of engine and wheels [rpm/s]."""
    column = np.searchsorted(_SPEEDS[1:-1], rpm, side='right')
    driving = _at(engine[0], column) + _at(engine[1], column) * rpm
    slip = wheel * (_FINAL_DRIVE * ratio) / rpm
    row = np.searchsorted(_SPEED_RATIOS[1:-1], slip, side='right')
    factor, gain = (low[row] + rise[row] * slip for low, rise in _CONVERTER_LINES)
    impeller = (rpm / factor) ** 2
    speed = _MPH * wheel
    load = np.sign(speed) * (brake + _DRAG + _AIR_DRAG * speed**2)
    pushing = _FINAL_DRIVE * ratio * gain * impeller
    return (driving - impeller) / _ENGINE_INERTIA, (pushing - load) / _VEHICLE_INERTIA


def _between(places: Floats, rows: Floats, at: Floats) -> Floats:
    """Rows of a table between its places, linear, also beyond its ends; shape (at, columns)."""
    first = np.searchsorted(places[1:-1], at, side='right')
    share = ((at - places[first]) / (places[first + 1] - places[first]))[:, None]
    return rows[first] + share * (rows[first + 1] - rows[first])


def _lines(places: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Value at 0 and slope of the line through each two neighbours, shape (…, places - 1)."""
    slopes = np.diff(values) / np.diff(places)
    return values[..., :-1] - slopes * places[:-1], slopes


def _at(table: Floats, columns: Integers) -> Floats:
    """A value of each row."""
    return table.ravel()[np.arange(0, table.size, table.shape[1]) + columns]


_CONVERTER_LINES = tuple(_lines(_SPEED_RATIOS, each) for each in _CONVERTER.T)
