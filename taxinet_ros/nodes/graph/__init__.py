"""Graphs of nodes in one process or many: start, supervise and shut down."""
