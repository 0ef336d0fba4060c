"""Figures of the direction finder against truth that does not come from this project."""
