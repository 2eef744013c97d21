"""The check of a user's node against the contract of the graph."""
