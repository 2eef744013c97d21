"""The monitor for arbitrary topics: options, inputs and outputs."""
