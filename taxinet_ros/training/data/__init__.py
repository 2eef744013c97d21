"""Data sets: drawn, rendered, stored and read."""
