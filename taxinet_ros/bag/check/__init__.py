"""Checks of bags: storage, lockstep, verdicts, and comparison of two bags."""
