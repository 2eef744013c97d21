"""Explanation of a failed run: track, counterfactuals, occlusion, nearest training images."""
