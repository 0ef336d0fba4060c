"""The publication's experiments and sweeps."""
