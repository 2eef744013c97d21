"""Graphs of nodes: in one process or many, started, looked after and ended."""
