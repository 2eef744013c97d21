"""Stages of a study: planned, run, repeated where they are no longer valid."""
