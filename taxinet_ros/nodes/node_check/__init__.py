"""Check of a user's node against the lockstep contract."""
