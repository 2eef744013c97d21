"""Leaf rooms that nothing imports: they arrive by entry points, as a user's package does."""
