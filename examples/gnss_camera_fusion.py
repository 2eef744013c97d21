"""A perception that fuses camera, GNSS, IMU and wheel speed, and rides out drop-outs of either.

A Kalman filter of cross-track and heading error: IMU and wheels carry the estimate from frame to
frame, the network's answers and the fixes correct it. With and without, on the same scenes:

    taxinet compare taxinet examples/gnss_camera_fusion.py:Fused s_falsif --set sensors=standard \
        --set gnss_dropout_start_s=4 --set gnss_dropout_s=12 --set camera_dropout_percent=35
"""

import math

import numpy as np

import taxinet_ros as tx

CAMERA_SIGMA = 0.5, math.radians(2.0)
"""Errors of the network's answers, which last for several frames [m, rad]."""


class Fused:
    """The filter; its covariance is what it claims for its estimates."""

    def __init__(self):
        self.network = tx.load_perception('taxinet')
        self.mean = np.zeros(2)
        self.covariance = np.diag([15.0 ** 2, 0.5 ** 2])
        self.speed_mps = 5.0

    def __call__(self, image, rig, sensors):
        """Estimate the errors at a frame.

        Args:
            image: (200, 360, 3) uint8 RGB; black where it is lost.
            rig: camera and aircraft.
            sensors: what has arrived since the frame before; nothing in a drop-out.
        """
        self.speed_mps = sensors.wheel[-1].speed_mps if sensors.wheel else self.speed_mps
        turned = [one.yaw_rate_radps for one in sensors.imu]
        self.predict(0.1, float(np.mean(turned)) if turned else 0.0)
        if image.any():
            self.network.begin(rig)
            seen = self.network.estimate(image, None)
            self.correct(np.array([1.0, 0.0]), seen.cte_m, CAMERA_SIGMA[0])
            self.correct(np.array([0.0, 1.0]), seen.he_rad, CAMERA_SIGMA[1])
        for fix in sensors.gnss:  # its noise lasts for many fixes, so each counts for little
            self.correct(np.array([1.0, 0.0]), fix.cte_m, 5 * fix.sigma_m)
        return self.mean[0], self.mean[1], self.covariance

    def predict(self, dt_s, yaw_rate_radps):
        """Roll on for a time."""
        step_m = self.speed_mps * dt_s
        self.mean += step_m * math.sin(self.mean[1]), yaw_rate_radps * dt_s
        moved = np.array([[1.0, step_m * math.cos(self.mean[1])], [0.0, 1.0]])
        self.covariance = moved @ self.covariance @ moved.T + np.diag([0.02, 0.005]) ** 2

    def correct(self, row, measured, sigma):
        """Take in a measurement of one component."""
        gain = self.covariance @ row / (row @ self.covariance @ row + sigma ** 2)
        self.mean = self.mean + gain * (measured - row @ self.mean)
        kept = np.eye(2) - np.outer(gain, row)
        spread = kept @ self.covariance @ kept.T + np.outer(gain, gain) * sigma ** 2
        self.covariance = (spread + spread.T) / 2
