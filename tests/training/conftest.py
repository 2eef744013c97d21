"""Helpers of the tests of training lie here."""
