"""The Gaussian-sum filter on the circle."""
