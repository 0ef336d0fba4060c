"""Bags through the algorithms of the rig without middleware."""
