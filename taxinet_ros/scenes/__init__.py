"""Scenes: Scenic programs, their draws, and their random choices as a search space."""
