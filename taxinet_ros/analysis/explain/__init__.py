"""Explanation of a failed run: track and counterfactuals."""
