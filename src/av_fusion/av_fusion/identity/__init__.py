"""The Gaussian-sum filter on the sphere."""
