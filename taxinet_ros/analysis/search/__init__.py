"""What a search has learned, and how a failure was shrunk."""
