"""A campaign on disk: facts, rows and table of its runs."""
