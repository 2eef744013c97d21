"""Campaigns: scenes drawn from Scenic programs, and the ledger, table and rates of their runs."""
