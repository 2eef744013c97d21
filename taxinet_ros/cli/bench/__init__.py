"""``taxinet bench``."""
