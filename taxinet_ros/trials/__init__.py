"""Campaigns: scenes drawn from Scenic programs, and the record, table and rates of their runs."""
