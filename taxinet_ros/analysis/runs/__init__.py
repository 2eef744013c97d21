"""The runs of a campaign as tables: features, groups, bins."""
