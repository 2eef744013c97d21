"""Timing of runs: lockstep, latencies and free runs."""
