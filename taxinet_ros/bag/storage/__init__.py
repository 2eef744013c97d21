"""Bytes of an MCAP file: records, chunks, indexes, and the scan of damaged ones."""
