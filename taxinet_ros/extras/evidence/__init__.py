"""Evidence toward a requirement: what was run, bound by hash; figures, limits, argument, page."""
