"""Retraining on counterexamples, round by round, and whether a round is kept."""
