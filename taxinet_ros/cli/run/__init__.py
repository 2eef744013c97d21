"""Commands that run the graph: run, falsify, shrink, experiment, demo, up, check-node."""
