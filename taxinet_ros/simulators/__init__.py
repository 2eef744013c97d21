"""Simulators of others: as cameras behind our loop, or as whole worlds."""
