"""Retraining on counterexamples in rounds, with acceptance tests."""
