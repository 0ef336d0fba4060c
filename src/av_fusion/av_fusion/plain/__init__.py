"""Plain trackers: the base for a tracker of one's own, and two baselines of the publication."""
