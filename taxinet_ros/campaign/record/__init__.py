"""A campaign on disk: what was asked, the ledger, the rows and the table of its runs."""
