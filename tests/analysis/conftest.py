"""Helpers of the tests of analyses lie here."""
