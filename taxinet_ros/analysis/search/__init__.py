"""Results of searches: learned distributions, and shrunk failures."""
