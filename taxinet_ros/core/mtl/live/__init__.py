"""Signals of live topics, sampled and held for a monitor."""
