"""Runs in bags: facts, samples, trace, tables and resimulation."""
