"""The monitor of any topics: its options, inputs and outputs."""
