"""Lower bounds of robustness during a run."""
