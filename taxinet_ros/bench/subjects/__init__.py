"""What the benchmark measures: the closed loop, the graph, components, campaigns."""
