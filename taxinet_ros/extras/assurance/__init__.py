"""Run-time monitors: calibrated on satisfied runs, and judged in the loop."""
