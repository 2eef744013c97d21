"""The lockstep of a run: who takes part, who answers, and what is wrong."""
