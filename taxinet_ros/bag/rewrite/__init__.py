"""New bags out of old ones: recovered, split, with frames rendered."""
