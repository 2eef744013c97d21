"""MCAP storage: records, chunks, indexes, and scanning of damaged files."""
