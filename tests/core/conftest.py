"""Helpers of the tests of the core lie here, also for those of other rooms."""
