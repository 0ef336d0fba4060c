"""Bearings of sight and sound to one track and a pointing command; launch files, configuration and evaluation."""
