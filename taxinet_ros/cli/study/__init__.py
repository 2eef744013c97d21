"""Commands of studies: case-study and improve."""
