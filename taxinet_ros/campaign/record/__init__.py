"""A campaign on disk: options, ledger, rows and table of its runs."""
