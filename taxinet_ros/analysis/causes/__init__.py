"""Causes of failures: regions of the scenes, rules, clusters and rankings."""
