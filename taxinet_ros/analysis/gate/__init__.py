"""The release gate: a campaign, or a network in the scenes of a baseline, against thresholds."""
