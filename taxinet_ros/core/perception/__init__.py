"""Perceptions: ground truth, networks, and functions of the user."""
