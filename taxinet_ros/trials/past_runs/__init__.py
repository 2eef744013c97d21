"""Recorded runs of campaigns: find, check, evaluate further requirements, and rerun."""
