"""Processes of the program: children, pools, signals and ends."""
