"""The simulated world of one run: the aircraft on its runway, and what its wing camera sees."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS, Aircraft
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState, TaxiCommand
from taxinet_ros.errors import UsageError


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Observation:
    """What there is to know at one control step, before it is answered.

    Attributes:
        seq: control step, from 0.
        stamp_ns: simulated time since the start of the run [ns].
        state: true state of the aircraft.
        image: camera frame, (200, 360, 3) uint8 RGB; None where no one asked for pictures.
    """

    seq: int
    stamp_ns: int
    state: AircraftState
    image: NDArray[np.uint8] | None


def last_step(scenario: Scenario, period_ns: int = CONTROL_PERIOD_NS) -> int:
    """Number of the last control step of a run: steps 0..N cover the duration, both ends included.

    Raises:
        UsageError: the duration is not a whole number of control periods.
    """
    steps, rest = divmod(scenario.duration_ns, period_ns)
    if rest:
        raise UsageError(
            f'scenario: duration {scenario.duration_s:g} s is not a multiple of the '
            f'control period {period_ns / 1e9:g} s'
        )
    return steps


class World:
    """One run's world, stepped from outside. A fresh one per run keeps runs bit-identical."""

    def __init__(self, scenario: Scenario, *, pictures: bool = True) -> None:
        """Set the aircraft on the runway; ``pictures`` False leaves the camera out."""
        self.last_seq = last_step(scenario)
        self._aircraft = Aircraft(scenario)
        self._scenario, self._pictures = scenario, pictures
        self._seq = 0

    @cached_property
    def _camera(self) -> Camera:
        # Made for the first picture: its ground takes longer than all else here, and 63 MB.
        return Camera(self._scenario)

    def observe(self, *, picture: bool = True) -> Observation:
        """Photograph the present moment; ``picture`` False saves the picture."""
        stamp_ns = self._seq * CONTROL_PERIOD_NS
        state = self._aircraft.state
        image = self._camera.render(state, stamp_ns) if picture and self._pictures else None
        return Observation(seq=self._seq, stamp_ns=stamp_ns, state=state, image=image)

    def advance(self, command: TaxiCommand) -> None:
        """Integrate one control period under ``command``."""
        self._aircraft.advance(command)
        self._seq += 1
