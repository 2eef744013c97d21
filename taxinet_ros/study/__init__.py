"""The paper's case study as one command: stages, resumption and report."""
