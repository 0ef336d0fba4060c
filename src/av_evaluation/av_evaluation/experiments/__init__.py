"""The publication's experiments."""
