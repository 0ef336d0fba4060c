"""Several rigs: their tracks to targets with positions."""
