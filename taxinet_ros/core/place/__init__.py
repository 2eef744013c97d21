"""The place: runway and coordinate frames."""
