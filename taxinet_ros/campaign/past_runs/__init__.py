"""Recorded runs of campaigns: found, checked, judged by more requirements, and run again."""
