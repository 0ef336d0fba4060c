"""Errors, coverage and their intervals."""
