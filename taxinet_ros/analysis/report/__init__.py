"""Building blocks of reports: pages, tables, text, pictures and the viewer of a run."""
