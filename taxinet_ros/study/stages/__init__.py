"""Stages of a study: planned, run, and repeated if no longer valid."""
