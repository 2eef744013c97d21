"""The report of a study, beside the paper's figures."""
