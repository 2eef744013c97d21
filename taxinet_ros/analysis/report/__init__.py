"""The kit of every report: pages, tables, text, pictures and the viewer of a run."""
