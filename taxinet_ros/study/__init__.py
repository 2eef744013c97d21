"""The paper's case study as one command: its stages, how they are resumed, and what they say."""
