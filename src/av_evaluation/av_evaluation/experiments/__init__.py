"""Runs on scenarios and recordings, and the methods that are compared on them."""
