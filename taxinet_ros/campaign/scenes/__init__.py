"""Scenes: Scenic programs, what they draw, and their choices as a search space."""
