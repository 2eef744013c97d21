"""Recordings of a real aircraft, or of any other source: scored, and put into our world."""
