"""Subjects of the benchmark: the closed loop, the graph, components, campaigns."""
