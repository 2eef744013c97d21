"""Paired comparison of the arms of an experiment."""
