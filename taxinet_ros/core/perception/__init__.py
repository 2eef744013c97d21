"""Perceptions: ground truth, networks and user functions."""
