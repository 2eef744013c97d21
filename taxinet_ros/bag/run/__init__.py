"""The run in a bag: its facts, samples, trace, tables and resimulation."""
