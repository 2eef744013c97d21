"""Taxi speed: a proportional-integral law on power lever and brakes, as the pilot's right hand."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class SpeedGains:
    """Tuning of one aircraft model.

    Attributes:
        lever_per_mps: power lever, 0..1, per m/s of missing speed.
        lever_per_m: growth of the lever per second and per m/s of missing speed.
        brake_per_lever: brake, 0..1, per unit of lever below its stop.
        rolling_lever: lever that holds the taxi speed straight ahead; where the integral starts.
    """

    lever_per_mps: float
    lever_per_m: float
    brake_per_lever: float
    rolling_lever: float


class SpeedHold:
    """Holds a ground speed; a wanted speed of 0 closes the lever and stands on the brakes."""

    def __init__(self, gains: SpeedGains) -> None:
        """Start in balance: the lever holds a steady roll."""
        self._gains = gains
        self._integral = gains.rolling_lever

    def update(self, wanted_mps: float, actual_mps: float, dt_s: float) -> tuple[float, float]:
        """Lever and brake, each 0..1, for the next ``dt_s`` seconds.

        Args:
            wanted_mps: speed to hold [m/s]; 0 stops the aircraft.
            actual_mps: ground speed along the body x axis [m/s].
            dt_s: time until the next update [s].
        """
        if wanted_mps == 0:
            self._integral = self._gains.rolling_lever
            return 0.0, 1.0
        missing_mps = wanted_mps - actual_mps
        # The integral may not wind up past what the lever can give.
        integral = self._integral + self._gains.lever_per_m * missing_mps * dt_s
        self._integral = min(max(integral, 0.0), 1.0)
        lever = self._integral + self._gains.lever_per_mps * missing_mps
        brake = -lever * self._gains.brake_per_lever
        return min(max(lever, 0.0), 1.0), min(max(brake, 0.0), 1.0)
