"""Several rigs: simulated reports, peers and figures."""
