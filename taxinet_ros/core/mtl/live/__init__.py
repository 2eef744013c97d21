"""Signals of running topics: sampled, held and joined for a monitor."""
