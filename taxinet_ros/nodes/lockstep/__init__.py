"""The lockstep of a run: participants, answers and errors."""
