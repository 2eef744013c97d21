"""Live monitoring: signals read from topics, sampled and held."""
