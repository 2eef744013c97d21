"""A closed loop with few pictures: a cheap forecast of the run with all of them.

The world, the controller, the timing and the judgement are those of the run. A picture is taken
every so many control steps only; in between the perception's estimate is the truth plus its error
at the last picture. Pictures and inference are nine tenths of a run's time, and errors change
slowly along the runway, so this keeps most of ρ at a fraction of the cost.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.control_step import Observation
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NO_ESTIMATE, TaxiCommand, TrackingError
from taxinet_ros.core.world import World, WorldMaker, check_picture, close_world


class HeldError(Perception):
    """A perception whose error is kept from one picture to the next."""

    needs_image = False

    def __init__(self, perception: Perception) -> None:
        """Wrap a perception that needs pictures."""
        self._perception = perception
        self.word, self.fingerprint = perception.word, perception.fingerprint
        self._error: TrackingError | None = None

    def begin(self) -> None:
        """Reset; called before each run."""
        self._perception.begin()
        self._error = None

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """The estimate of this picture, or without one the truth plus the last error.

        An estimate that is not usable is held as such.
        """
        assert truth is not None
        if image is not None:
            found = self._perception.estimate(image, truth)
            self._error = TrackingError(
                cte_m=found.cte_m - truth.cte_m, he_rad=found.he_rad - truth.he_rad
            ) if found.usable else None
            return found
        if self._error is None:
            return NO_ESTIMATE
        return TrackingError(
            cte_m=truth.cte_m + self._error.cte_m, he_rad=truth.he_rad + self._error.he_rad
        )


class SparseWorld(World):
    """A world with a picture at every ``every``-th control step, from the first one on."""

    def __init__(self, make: WorldMaker, scenario: Scenario, every: int) -> None:
        """Make the world of a run.

        Args:
            make: makes the world that is observed.
            scenario: of the run.
            every: control steps from one picture to the next, 1 or more.
        """
        self._world = make(scenario, pictures=True)
        self.last_seq = self._world.last_seq
        self._every, self._seq = every, 0

    def observe(self, *, picture: bool = True) -> Observation:
        """Observe the current step.

        Raises:
            InfraError: the world failed, or has no picture where one is due.
        """
        due = self._seq % self._every == 0
        now = self._world.observe(picture=due)
        if due:
            check_picture(now, 'a look')
        return now

    def advance(self, command: TaxiCommand) -> None:
        """Advance by one control period."""
        self._world.advance(command)
        self._seq += 1

    def close(self) -> None:
        """Give back what the world took."""
        close_world(self._world)
