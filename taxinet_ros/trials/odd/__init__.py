"""Operational design domains (ODD): their files, cells and combinations of cells."""
