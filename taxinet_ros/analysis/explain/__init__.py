"""Explanation of a failed run: track, counterfactuals, occlusion."""
