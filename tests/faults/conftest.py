"""Helpers of the tests of faults lie here."""
