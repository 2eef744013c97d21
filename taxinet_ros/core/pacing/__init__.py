"""Timing of answers: latencies, late frames, free runs."""
