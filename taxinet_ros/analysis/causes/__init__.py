"""Causes of failures: regions of the scenes, rules and rankings."""
