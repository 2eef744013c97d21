"""Shrinking: reduce a failed run to the scenario nearest to nominal that still fails."""
