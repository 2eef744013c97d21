"""Tables of the runs of a campaign: features, groups, bins."""
