"""Why one run failed: track, counterfactuals, occlusion and nearest training images."""
