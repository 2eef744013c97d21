"""Lower bounds on the final robustness of runs in progress, calibrated on a campaign."""
