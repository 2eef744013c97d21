"""``taxinet tune``: steering gains that are best in their worst scene."""
