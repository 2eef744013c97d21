"""X-Plane 11 and 12, over their network interfaces. Never run against the real program."""
